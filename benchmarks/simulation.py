"""Six-axis error simulation of 600,000 samples: ours against pyins on the same truth, and the whole simulated block.

Ours streams pieces that fit the processor's cache, as the simulated block does; pyins works on whole arrays.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._timing import millions, take_turns
from inertial.error_model import Coefficients, readings_from_true
from simulators.noise import RateRandomWalk, White, generator
from simulators.scenarios import demo_model, demo_scenario, make_block

RATE_HZ = 2000.0
SAMPLES = 600_000
PIECE = 4096
ARW, RATE_WALK = 2.9e-6, 1e-9
VRW, FORCE_WALK = 2e-4, 1e-7


def errors_only(accel: np.ndarray, gyro: np.ndarray) -> np.ndarray:
    """Return increments with ± scale, misalignment, bias, g-sensitivity, white noise and rate random walk."""
    interval_s = 1.0 / RATE_HZ
    coefficients = Coefficients.from_document(demo_model(1).calibration)
    white = White([VRW] * 3 + [ARW] * 3, interval_s, generator(1, 1))
    walk = RateRandomWalk([FORCE_WALK] * 3 + [RATE_WALK] * 3, interval_s, generator(1, 2))
    increments = np.empty((SAMPLES, 6))
    for low in range(0, SAMPLES, PIECE):
        piece = increments[low : low + PIECE]
        piece[:, :3], piece[:, 3:] = readings_from_true(accel[low : low + PIECE], gyro[low : low + PIECE], coefficients)
        piece *= interval_s
        piece += white.increments(len(piece))
        piece += walk.increments(len(piece))
    return increments


def pyins_contender(accel: np.ndarray, gyro: np.ndarray) -> dict[str, Any]:
    """Return pyins' error simulation with scale, misalignment, bias, white noise and rate random walk."""
    try:
        import pandas as pd
        from pyins.inertial_sensor import Parameters, apply_imu_parameters
        from pyins.util import ACCEL_COLS, GYRO_COLS
    except ImportError:
        return {}
    imu = pd.DataFrame(
        np.hstack([gyro, accel]) / RATE_HZ, index=np.arange(SAMPLES) / RATE_HZ, columns=GYRO_COLS + ACCEL_COLS
    )
    transform = np.eye(3) + 1e-4

    def run() -> None:
        gyros = Parameters(transform, np.full(3, 1e-5), ARW, RATE_WALK, 1)
        accels = Parameters(transform, np.full(3, 1e-2), VRW, FORCE_WALK, 2)
        apply_imu_parameters(imu, "increment", gyros, accels)

    return {"pyins": run}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--rounds", type=int, default=7)
    arguments = parser.parse_args()
    rng = np.random.default_rng(1)
    accel, gyro = rng.normal(0.0, 1.0, (SAMPLES, 3)), rng.normal(0.0, 0.1, (SAMPLES, 3))
    scenario, model = demo_scenario(1), demo_model(1)
    contenders: dict[str, Any] = {
        "errors and noise on a given truth": lambda: errors_only(accel, gyro),
        "whole block (truth, flicker, thermometers, readout)": lambda: make_block(scenario, model).generate(SAMPLES),
        **pyins_contender(accel, gyro),
    }
    times = take_turns(contenders, arguments.rounds)
    peer = times.get("pyins", {}).get("median_s")
    rows = [
        [name, millions(SAMPLES, found["median_s"]), f"{peer / found['median_s']:.2f} ×" if peer else "pyins absent"]
        for name, found in times.items()
    ]
    found = {
        "samples": SAMPLES,
        "times": times,
        "ratio_to_pyins": {name: peer / value["median_s"] for name, value in times.items()} if peer else {},
        "table": {"header": ["six-axis error simulation", "samples/s", "pyins' time over it"], "rows": rows},
    }
    print(json.dumps(found, indent=2))
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
