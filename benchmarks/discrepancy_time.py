"""How long ``inertrim discrepancy`` takes and how much memory it holds, against what was promised.

Recordings of the demo's block with its temperature, two turns and a drift that the model lacks, of 300 s at 100 Hz and
at 2 kHz and of six hours at 100 Hz; each searched with the whole library by the command line, start-up, report and all.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from drivers.recording_meta import MotionMeta, TurnMeta
from inertial.documents import EffectEntry, ParameterValue
from service.trials import record
from simulators.scenarios import demo_model, demo_scenario

LIMITS = ((300.0, 100.0, 30.0), (300.0, 2000.0, 180.0), (21_600.0, 100.0, None))
"""Length [s], rate [Hz], and the seconds promised on two cores; of six hours only that memory is bounded."""


def make(folder: Path, length_s: float, rate_hz: float) -> Path:
    """Write a recording and return its name; the drift is as plain in a long one as in a short one."""
    turns: list[MotionMeta] = [
        TurnMeta(kind="turn", start_s=100.0, end_s=118.0, rate_dps=5.0, axis=[0, 0, 1], frame="body"),
        TurnMeta(kind="turn", start_s=200.0, end_s=209.0, rate_dps=10.0, axis=[0, 1, 0], frame="body"),
    ]
    scenario = demo_scenario(1).with_motion(turns, length_s)
    block = scenario.block.model_copy(update={"sample_rate_hz": rate_hz})
    rate = ParameterValue(value=3e-4 / length_s**1.5, unit="rad/s/s")
    drift = EffectEntry(effect="drift", channel="gyro_x", parameters={"rate": rate})
    scenario = scenario.model_copy(update={"block": block, "effect": [drift]})
    return record(scenario, demo_model(1), folder / f"{length_s:.0f}-{rate_hz:.0f}").path


def measure(recording: Path, model: Path) -> dict[str, Any]:
    """Run the command in a process of its own."""
    command = [sys.executable, "-m", "service.cli", "discrepancy", str(recording), "--model", str(model)]
    began = time.perf_counter()
    with subprocess.Popen([*command, "--json", str(recording) + ".json"], stdout=subprocess.DEVNULL) as process:
        _, code, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(code)
    if process.returncode not in (0, 1):
        raise SystemExit(f"the command ended with {process.returncode}")
    verdict = json.loads(Path(str(recording) + ".json").read_text())["verdict"]
    return {"wall_s": time.perf_counter() - began, "largest_mb": used.ru_maxrss / 1024.0, "verdict": verdict}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.discrepancy_time", description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    found, rows = {}, []
    # What makes the recordings holds much memory, which a process forked from it would be charged with.
    workshop = ProcessPoolExecutor(1, mp_context=get_context("spawn"))
    with tempfile.TemporaryDirectory() as folder, workshop:
        model = Path(folder, "block.json")
        model.write_text(demo_model(1).canonical_json())
        for length_s, rate_hz, limit_s in LIMITS:
            name = f"{length_s:g} s at {rate_hz:g} Hz"
            recording = workshop.submit(make, Path(folder), length_s, rate_hz).result()
            one = found[name] = measure(recording, model)
            share = f"{limit_s / one['wall_s']:.1f} ×" if limit_s else "–"
            rows.append([name, f"{one['wall_s']:.0f} s", share, f"{one['largest_mb']:,.0f} MB", one["verdict"]])
    header = ["`inertrim discrepancy`", "from start to report", "promised over it", "memory at most", "verdict"]
    figures = {"runs": found, "table": {"header": header, "rows": rows}}
    print(json.dumps(figures, indent=2, ensure_ascii=False))
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
