"""Six-axis error simulation of 600,000 samples: ours against pyins on the same truth, and the whole simulated block.

Ours streams pieces that fit the processor's cache, and draws the noise of accelerometers and gyros, which have random
numbers of their own as in the simulated block, in a thread each; pyins works on whole arrays in one.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._timing import millions, take_turns
from inertial.error_model import Coefficients, readings_from_true
from simulators.noise import RateRandomWalk, White, generator
from simulators.scenarios import demo_model, demo_scenario, make_block

RATE_HZ = 2000.0
SAMPLES = 600_000
PIECE = 16_384
ARW, RATE_WALK = 2.9e-6, 1e-9
VRW, FORCE_WALK = 2e-4, 1e-7


def errors_only(accel: np.ndarray, gyro: np.ndarray) -> np.ndarray:
    """Return increments with ± scale, misalignment, bias, g-sensitivity, white noise and rate random walk."""
    coefficients = Coefficients.from_document(demo_model(1).calibration)
    increments = np.empty((SAMPLES, 6))
    pieces = [slice(low, min(low + PIECE, SAMPLES)) for low in range(0, SAMPLES, PIECE)]

    def triad_noise(seed: int, white: float, walk: float) -> Iterator[np.ndarray]:
        processes = (
            White([white] * 3, 1.0 / RATE_HZ, generator(seed, 1)),
            RateRandomWalk([walk] * 3, 1.0 / RATE_HZ, generator(seed, 2)),
        )
        for piece in pieces:
            yield processes[0].increments(len(accel[piece])) + processes[1].increments(len(accel[piece]))

    noises = triad_noise(1, VRW, FORCE_WALK), triad_noise(2, ARW, RATE_WALK)
    with ThreadPoolExecutor(2) as pool:
        for piece in pieces:
            drawn = [pool.submit(next, noise) for noise in noises]
            readings = readings_from_true(accel[piece], gyro[piece], coefficients)
            for triad, (reading, noise) in enumerate(zip(readings, drawn, strict=True)):
                np.multiply(reading, 1.0 / RATE_HZ, out=increments[piece, 3 * triad : 3 * triad + 3])
                increments[piece, 3 * triad : 3 * triad + 3] += noise.result()
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
