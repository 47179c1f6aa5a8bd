"""Blind test of the discrepancy workflow: hidden effects, nothing hidden, effects no library has; sealed truth.

Cases come from a process of its own (:mod:`benchmarks._blind`) that writes recordings and truth into two folders; the
workflow is given a recording and a model. With ``--peers`` PySINDy's STLSQ and stepwise BIC read the same files.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks import _scoring

CHUNK = 4
LIMIT_S = 300
BARS = {
    "named_or_tied": ("inside the library, d ≥ 10: named or tied", "≥ 0.99"),
    "named_or_tied_got": ("… d ≥ 10 as an oracle gets it of that recording", "≥ 0.99"),
    "wrong_name": ("… with a wrong name", "≤ 0.005"),
    "named_or_tied_d7": ("inside, d = 7: named or tied", "≥ 0.95"),
    "named_or_tied_d7_got": ("… d = 7 as an oracle gets it of that recording", "≥ 0.95"),
    "several_recall": ("two or three at once: recall", "≥ 0.97"),
    "several_precision": ("… precision", "≥ 0.98"),
    "false_alarm": ("nothing hidden: any false name", "≤ 0.01"),
    "null_called_unknown": ("… called unknown", ""),
    "unknown_flagged": ("outside the library, d ≥ 30: unknown", "≥ 0.90"),
    "unknown_flagged_d60": ("… d ≥ 60", "≥ 0.97"),
    "outside_false_deterministic": ("… d ≥ 30: a false deterministic name", "≤ 0.02"),
    "heldout_gap_closed": ("held-out gap ≤ 1.1 × floor after adoption", "≥ 0.95"),
    "mean_tie_size": ("names in an answer", ""),
}


def warm_up() -> None:
    """Run a case that does not count: what is compiled once, on first use, is the time of no case."""
    with tempfile.TemporaryDirectory() as passing:
        _outcome(passing, 0).parent.mkdir()
        run_chunk(0, [0], passing, peers=False)


def run_chunk(seed: int, numbers: list[int], work: str, peers: bool) -> None:
    """Have cases made, run the workflow on each and write down what it reported, one file a case."""
    cases, truth = Path(work, "cases"), Path(work, "truth")
    span = ["--first", str(numbers[0]), "--count", str(len(numbers))]
    command = [sys.executable, "-m", "benchmarks._blind", "--seed", str(seed), *span]
    subprocess.run([*command, "--cases", str(cases), "--truth", str(truth)], check=True)
    for number in numbers:
        if not _outcome(work, number).exists():
            outcome = _run_case(cases / f"{number:05d}", number, peers)
            part = _outcome(work, number).with_suffix(".part")
            part.write_text(json.dumps(outcome))
            part.rename(_outcome(work, number))
        shutil.rmtree(cases / f"{number:05d}")


def _outcome(work: str | Path, number: int) -> Path:
    return Path(work, "outcomes", f"{number:05d}.json")


def _run_case(folder: Path, number: int, peers: bool) -> dict[str, Any]:
    """Run the workflow, and the peers if asked, on one case; an error is an outcome too."""
    from benchmarks import _peers
    from drivers.recording import read_recording
    from inertial.documents import BlockModel, parse_document
    from simulators.discrepancy.report import discrepancy

    outcome: dict[str, Any] = {"number": number}
    signal.signal(signal.SIGALRM, _too_long)
    signal.alarm(LIMIT_S)
    began = time.process_time()
    try:
        model = parse_document(BlockModel, (folder / "block.json").read_text(), "block.json")
        outcome["report"] = discrepancy([read_recording(folder / "recording")], model).document
    except Exception as error:
        outcome["error"] = f"{type(error).__name__}: {error}"
        outcome["traceback"] = traceback.format_exc(limit=-4)
    finally:
        signal.alarm(0)
    outcome["seconds"] = time.process_time() - began
    if peers:
        outcome["peers"] = _peers.names(folder)
    return outcome


def _too_long(*_: object) -> None:
    raise TimeoutError(f"still at work after {LIMIT_S} s")


def run(seed: int, cases: int, peers: bool, workers: int, work: Path) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Return (truth, outcome) of all cases in order; those that ``work`` already holds are not run again."""
    chunks = [list(range(first, min(first + CHUNK, cases))) for first in range(0, cases, CHUNK)]
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"  # both cores are busy with a case each; read when a worker, begun anew, imports numpy
    _outcome(work, 0).parent.mkdir(parents=True, exist_ok=True)
    missing = [chunk for chunk in chunks if not all(_outcome(work, number).exists() for number in chunk)]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=warm_up) as pool:
        jobs = [pool.submit(run_chunk, seed, chunk, str(work), peers) for chunk in missing]
        for job in as_completed(jobs):
            job.result()
            print(f"{len(list(work.glob('outcomes/*.json')))} of {cases}", file=sys.stderr, flush=True)
    truths = [json.loads(Path(work, "truth", f"{number:05d}.json").read_text()) for number in range(cases)]
    return [(truth, json.loads(_outcome(work, truth["number"]).read_text())) for truth in truths]


def summary(pairs: list[tuple[dict[str, Any], dict[str, Any]]], peers: bool) -> dict[str, Any]:
    """Everything that is counted."""
    rows = [_scoring.score(truth, outcome) for truth, outcome in pairs]
    families = sorted({row["family"] for row in rows})
    found = _scoring.figures(rows)
    by_family = {family: _scoring.figures([r for r in rows if r["family"] == family]) for family in families}
    seconds = sorted(row["seconds"] for row in rows)
    result: dict[str, Any] = {
        **found,
        "counts": {
            **{c: sum(r["category"] == c for r in rows) for c in ("inside", "null", "outside")},
            "families": {family: sum(r["family"] == family for r in rows) for family in families},
        },
        "bands": _scoring.bands(rows),
        "coverage_95": _scoring.coverage(rows),
        "seconds_per_case": {"median": seconds[len(seconds) // 2], "largest": seconds[-1]},
        "by_family": by_family,
        "by_motion": {
            m: _scoring.figures([r for r in rows if r["motion"] == m]) for m in sorted({r["motion"] for r in rows})
        },
        "by_effect": _scoring.by_effect(rows),
        "confusion": _scoring.confusion(rows),
        "rows": rows,
        "table": _table(found, by_family.get("plain", {}), _scoring.bands(rows)),
    }
    if peers:
        result["peers"] = _peer_summary(pairs)
    return result


def _peer_summary(pairs: list[tuple[dict[str, Any], dict[str, Any]]]) -> dict[str, Any]:
    """The peers and the workflow by the peers' questions, on the same cases."""
    from benchmarks._peers import PEERS

    truths = [truth for truth, _ in pairs]
    found = {name: _scoring.peer_figures(truths, [o["peers"][name] for _, o in pairs]) for name in PEERS}
    own = [[names for f in o.get("report", {"findings": []})["findings"] for names in _best(f, t)] for t, o in pairs]
    return {**found, "inertrim": _scoring.peer_figures(truths, own)}


def _best(finding: dict[str, Any], truth: dict[str, Any]) -> list[_scoring.Name]:
    """A tie counts as its true name where it holds it."""
    names = _scoring.names_of(finding)
    hidden = {_scoring.normal(e["effect"], e["channel"]) for e in truth["effects"]}
    return [next((name for name in names if name in hidden), names[0])]


def _table(found: dict[str, Any], plain: dict[str, Any], bands: dict[str, Any]) -> dict[str, Any]:
    def cell(value: float | None) -> str:
        return "–" if value is None else f"{value:.3f}"

    def counted(key: str) -> str:
        if key not in bands or not bands[key]["of"]:
            return ""
        low, high = bands[key]["interval_95"]
        return f"{bands[key]['counted']} of {bands[key]['of']}, {low:.3f} to {high:.3f}"

    rows = [[text, cell(found[key]), counted(key), cell(plain.get(key)), bar] for key, (text, bar) in BARS.items()]
    return {"header": ["", "all cases", "counted, 95 % interval", "without the hard families", "wanted"], "rows": rows}


def report_text(result: dict[str, Any]) -> str:
    """What is printed: the table, the families, the effects by size, the peers."""
    lines = [f"{row[0]:46s}{row[1]:>7s}  {row[2]:30s}{row[3]:>7s}  {row[4]}" for row in result["table"]["rows"]]
    lines += ["", "outcomes by effect and d (named, tied, missed)"]
    for effect, sizes in result["by_effect"].items():
        cells = [f"{s}: {c.get('named', 0)},{c.get('tied', 0)},{c.get('missed', 0)}" for s, c in sizes.items()]
        lines.append(f"  {effect:26s}" + "   ".join(cells))
    lines += ["", "what was hidden, its d, and what it was called"]
    for truth, sizes in result["confusion"].items():
        for size, names in sizes.items():
            lines.append(f"  {truth:26s}{size:8s}" + ", ".join(f"{n} {c}" for n, c in names.items()))
    lines += [
        "",
        f"parameters inside their 95 % interval: {result['coverage_95']}",
        f"{result['seconds_per_case']} s a case",
    ]
    if "peers" in result:
        lines += ["", *[f"  {name:20s}{json.dumps(values)}" for name, values in result["peers"].items()]]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.discrepancy", description=__doc__)
    parser.add_argument("--cases", type=int, default=60, help="of every five three inside, one null, one outside (60)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--peers", action="store_true", help="also run PySINDy's STLSQ and stepwise BIC")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--work", type=Path, help="keep truths and outcomes here, so that a run can be taken up again")
    arguments = parser.parse_args()
    if arguments.cases < 1:
        parser.error("--cases counts from 1")
    with tempfile.TemporaryDirectory() as passing:
        work = arguments.work or Path(passing)
        pairs = run(arguments.seed, arguments.cases, arguments.peers, arguments.workers, work)
    result = summary(pairs, arguments.peers)
    result = {"seed": arguments.seed, "cases": arguments.cases, **result}
    print(report_text(result))
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
