"""Campaigns: trials a second with one worker and with two, cost and bytes of a trial, and what large ones would need.

Both campaigns are the same study, each from nothing, worked out by fresh processes; the rate counts from when every
worker has delivered once, so that starting processes and compiling is left out. Runs alternate, and all of each count
together: the best of each would pick the moments in which the machine's host had least else to do. The cost of a trial
is processor time, in which what a worker compiles for its first trial is counted.

    python -m benchmarks.campaign --json FILE [--page docs/campaigns.md] [--trials 80] [--rounds 2]
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from pathlib import Path
from statistics import harmonic_mean, mean
from typing import Any

from benchmarks.__main__ import replace_table
from service.campaign import Campaign, read_campaign, run_campaign
from service.campaign.report import summary

STUDY = """
[campaign]
study = "grid"
repeats = {repeats}
seed = 3
chunk = 2

[vary]
method = ["optimal", "paper"]
storage_months = [6.0, 36.0]
"""
"""The nominal run: 285 s at 100 Hz, noise identified from its data."""
SIZES, CORES = (10**6, 10**9), (100, 10_000)
HOUR_S, DAY_S, YEAR_S = 3600.0, 86_400.0, 365.25 * 86_400.0


def one(spec: Campaign, workers: int, folder: Path) -> dict[str, Any]:
    """Run a campaign from nothing."""
    out = folder / f"{workers}.parquet"
    out.unlink(missing_ok=True)
    done = run_campaign(spec, out, workers=workers)
    return {
        "rate": done.rate,
        "bytes_per_trial": done.bytes_moved / done.trials,
        "file_bytes_per_trial": out.stat().st_size / done.trials,
        "core_s_per_trial": summary(spec, out)["wall_per_trial_s"]["wall_cpu_s"],
    }


def together(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of campaigns of the same size as if they were one."""
    return {key: (harmonic_mean if key == "rate" else mean)([run[key] for run in runs]) for key in runs[0]}


def needs(cost_s: float, moved: float, kept: float) -> list[dict[str, Any]]:
    """Return what campaigns of several sizes need on several numbers of cores, from one trial's cost and bytes."""
    return [
        {
            "trials": trials,
            "cores": cores,
            "wall_s": trials * cost_s / cores,
            "core_hours": trials * cost_s / HOUR_S,
            "result_bytes": trials * kept,
            "line_bytes_per_s": moved * cores / cost_s,
        }
        for trials in SIZES
        for cores in CORES
    ]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.campaign", description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--page", type=Path, help="rewrite the table between <!-- bench:campaign --> in this page")
    parser.add_argument("--trials", type=int, default=80, help="of each campaign (default 80)")
    parser.add_argument("--rounds", type=int, default=2, help="campaigns of each kind (default 2)")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = folder / "study.toml"
        path.write_text(STUDY.format(repeats=-(-arguments.trials // 4)))
        spec = read_campaign(path)
        runs = {workers: [] for workers in (1, 2)}
        for _ in range(arguments.rounds):
            for workers, found in runs.items():
                found.append(one(spec, workers, folder))
                print(workers, json.dumps(found[-1]), flush=True)
    whole = {workers: together(found) for workers, found in runs.items()}
    single = whole[1]
    figures = {
        "cores_of_this_machine": os.cpu_count(),
        "load_average": os.getloadavg()[0],
        "trials_per_s": {str(workers): run["rate"] for workers, run in whole.items()},
        "speed_up": whole[2]["rate"] / single["rate"],
        **{key: single[key] for key in ("core_s_per_trial", "bytes_per_trial", "file_bytes_per_trial")},
        "runs": {str(workers): found for workers, found in runs.items()},
        "needs": needs(single["core_s_per_trial"], single["bytes_per_trial"], single["file_bytes_per_trial"]),
    }
    figures["table"] = table(figures["needs"])
    print(json.dumps(figures, indent=2))
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")
    if arguments.page:
        arguments.page.write_text(replace_table(arguments.page.read_text(), "campaign", facing(figures)))


def table(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the needs for documents."""
    header = ["trials", "cores", "time", "core hours", "results kept", "scheduler's line"]
    cells = [
        [
            f"{row['trials']:.0e}".replace("e+0", "e"),
            f"{row['cores']:,}",
            duration(row["wall_s"]),
            f"{row['core_hours']:,.0f}",
            size(row["result_bytes"]),
            f"{size(row['line_bytes_per_s'])}/s",
        ]
        for row in rows
    ]
    return {"header": header, "rows": cells}


def facing(figures: dict[str, Any]) -> dict[str, Any]:
    """Return the table with the measured figures that it was made from in a last row."""
    made = [
        "measured",
        f"{figures['core_s_per_trial']:.2f} core s a trial",
        f"1 → 2 workers: {figures['speed_up']:.2f} ×",
        f"{figures['bytes_per_trial']:.0f} B moved a trial",
        f"{figures['file_bytes_per_trial']:.0f} B kept",
        f"load {figures['load_average']:.1f} on {figures['cores_of_this_machine']} cores",
    ]
    return {**figures["table"], "rows": [*figures["table"]["rows"], made]}


def duration(seconds: float) -> str:
    """Return a time in the unit that suits it."""
    for unit, length in (("years", YEAR_S), ("days", DAY_S), ("h", HOUR_S), ("min", 60.0)):
        if seconds >= 2.0 * length:
            return f"{seconds / length:.1f} {unit}"
    return f"{seconds:.0f} s"


def size(count: float) -> str:
    """Return a number of bytes in the unit that suits it."""
    for unit, factor in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= factor:
            return f"{count / factor:.1f} {unit}"
    return f"{count:.0f} B"


if __name__ == "__main__":
    main()
