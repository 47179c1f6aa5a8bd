"""The table of faults tried and outcomes, as ``docs/reliability.md`` shows it."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks._soak.faults import FAULTS

MARKS = ("<!-- soak -->\n", "<!-- /soak -->")


def write_page(path: Path, found: dict[str, Any], seed: int) -> None:
    """Renew what stands between the page's marks."""
    page = path.read_text()
    pattern = re.compile(re.escape(MARKS[0]) + ".*?" + re.escape(MARKS[1]), re.DOTALL)
    path.write_text(pattern.sub(lambda _: MARKS[0] + render(found, seed) + MARKS[1], page))


def render(found: dict[str, Any], seed: int) -> str:
    """Return the outcome in Markdown."""
    return "\n".join([*_summary(found, seed), "", *_table(found), "", *_faults_not_tried(found), ""])


def _summary(found: dict[str, Any], seed: int) -> list[str]:
    kept = found["kept"]
    lines = [
        f"Run: {found['hours']:.1f} simulated hours at {found['speed']:g} times real time, seed {seed}, "
        f"{found['lives']} lives of the service, {len(found['troubles'])} times trouble.",
        "",
        f"- stuck: {len(found['stuck'])}" + "".join(f"\n  - {text}" for text in found["stuck"]),
        f"- called fit while turned by 10° and more: {len(found['false_fit'])} times",
        f"- ends by SIGTERM that were not clean: {len(found['bad_ends'])}",
        f"- records lost: {len(found['lost'])} of {kept['runs']} runs, {kept['changes']} changes of state, "
        f"{kept['results']} results, {kept['commands']} commands, {kept['recordings']} recordings"
        + "".join(f"\n  - {text}" for text in found["lost"]),
    ]
    growth = found["growth"]
    if growth is None:
        lines.append("- memory: too short to tell whether it grows")
    else:
        lines.append(
            f"- memory: {found['largest_resident_mb']:.0f} MB at most; without pages of files, slope "
            f"{growth['mb_per_day']:+.2f} ± {growth['sigma_mb_per_day']:.2f} MB a day (1σ; neighbouring five minutes "
            f"correlate by {growth['correlation']:.2f}; p = {growth['p_value']:.2g} with {growth['freedom']} degrees "
            f"of freedom; 95 %: below {growth['upper_95_mb_per_day']:.1f} MB a day)"
        )
    lines.append(f"- open files: {found['largest_open_files']} at most")
    return lines


def _table(found: dict[str, Any]) -> list[str]:
    lines = [
        "| fault | what happens | tried | what the service did | same run to READY | READY after, median (largest) |",
        "|---|---|---|---|---|---|",
    ]
    for fault in FAULTS:
        troubles = [one for one in found["troubles"] if fault.name in one["faults"]]
        if not troubles:
            continue
        reactions = Counter(one["reaction"] for one in troubles)
        said = ", ".join(f"{name} {count}" for name, count in reactions.most_common())
        taken_s = [one["recovered_s"] for one in troubles if one["recovered_s"] is not None]
        after = f"{median(taken_s):.0f} s ({max(taken_s):.0f} s)" if taken_s else "never"
        same = sum(one["same_run"] for one in troubles)
        lines.append(f"| `{fault.name}` | {fault.text} | {len(troubles)} | {said} | {same} | {after} |")
    return lines


def _faults_not_tried(found: dict[str, Any]) -> list[str]:
    if not found["not_possible"]:
        return []
    return [f"Not possible on the machine of this run: {', '.join(f'`{name}`' for name in found['not_possible'])}."]
