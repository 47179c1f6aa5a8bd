"""The whole three-stage estimate of 180 s, from a recording on disk to the result: against reading the file alone.

The recording holds alignment and verification besides (280 s); alignment, noise, stages, observability, budget and
verification are all in the time.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from benchmarks._timing import take_turns
from drivers.recording import read_recording
from service.compensate import compensate
from service.trials import record
from simulators.scenarios import demo_model, demo_scenario

RATES_HZ = (100.0, 2000.0)
LENGTH_S, STAGES_S = 280.0, 180.0


def contenders(folder: Path, rate_hz: float) -> dict[str, Any]:
    """Return what is timed on one recording."""
    scenario = demo_scenario(1).warmed_up().with_motion([], LENGTH_S)
    block = scenario.block.model_copy(update={"sample_rate_hz": rate_hz})
    path = record(scenario.model_copy(update={"block": block}), demo_model(1), folder / f"{rate_hz:.0f}").path
    return {
        f"optimal, {rate_hz:g} Hz": lambda: compensate(read_recording(path), method="optimal"),
        f"paper, {rate_hz:g} Hz": lambda: compensate(read_recording(path), method="paper"),
        f"the file alone (pyarrow), {rate_hz:g} Hz": lambda: pq.read_table(path.with_suffix(".parquet")),
    }


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.three_stages", description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        times: dict[str, dict[str, float]] = {}
        for rate_hz in RATES_HZ:
            times |= take_turns(contenders(Path(folder), rate_hz), arguments.rounds)
    rows = []
    for name, found in times.items():
        alone = times[f"the file alone (pyarrow), {name.rpartition(', ')[2]}"]["median_s"]
        seconds = found["median_s"]
        rows.append([name, f"{seconds * 1e3:.0f} ms", f"{STAGES_S / seconds:,.0f} ×", f"{seconds / alone:.0f} ×"])
    figures = {
        "times": times,
        "table": {
            "header": ["three stages of 60 s", "processor time", "180 s over it", "of reading the file alone"],
            "rows": rows,
        },
    }
    print(json.dumps(figures, indent=2, ensure_ascii=False))
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
