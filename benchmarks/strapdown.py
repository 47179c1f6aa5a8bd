"""Strapdown integration, 300 s at 2 kHz: ours, pyins, and a compiled loop that only reads the data."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._timing import millions, take_turns
from inertial.attitude import body_to_tangent
from inertial.compiled import compiled
from inertial.earth import Site
from inertial.strapdown import navigate

RATE_HZ = 2000.0
STEPS = 600_000


@compiled
def _read(dv: np.ndarray, dtheta: np.ndarray, interval: np.ndarray, out: np.ndarray) -> None:
    total = 0.0
    for k in range(dv.shape[0]):
        total += interval[k]
        for i in range(3):
            total += dv[k, i] + dtheta[k, i]
        out[k + 1, 0] = total


def increments() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return dv, dtheta, interval of a block that sways about level with sensor noise."""
    rng = np.random.default_rng(1)
    time_s = np.arange(STEPS) / RATE_HZ
    dtheta = 1e-3 * np.sin(2 * math.pi * np.outer(time_s, [0.5, 0.7, 0.9])) / RATE_HZ + 1e-8 * rng.normal(
        size=(STEPS, 3)
    )
    dv = np.array([0.0, 0.0, 9.80]) / RATE_HZ + 1e-6 * rng.normal(size=(STEPS, 3))
    return dv, dtheta, np.full(STEPS, 1.0 / RATE_HZ)


def pyins_contenders(dv: np.ndarray, dtheta: np.ndarray) -> dict[str, Any]:
    """Return pyins end to end and its kernel alone; empty where it is not installed."""
    try:
        import pandas as pd
        from pyins import strapdown, transform
        from pyins._numba_integrate import integrate
        from pyins.util import ACCEL_COLS, GYRO_COLS, LLA_COLS, RPH_COLS, VEL_COLS
    except ImportError:
        return {}
    start = pd.Series([35.7, 51.4, 1200.0, 0, 0, 0, 0, 0, 40.0], index=LLA_COLS + VEL_COLS + RPH_COLS)
    time_s = np.arange(STEPS + 1) / RATE_HZ
    down = np.array([1.0, -1.0, -1.0])  # their body axes are forward, right, down
    imu = pd.DataFrame(
        np.hstack([np.vstack([dtheta[:1], dtheta]) * down, np.vstack([dv[:1], dv]) * down]),
        index=time_s,
        columns=GYRO_COLS + ACCEL_COLS,
    )

    def whole() -> None:
        strapdown.Integrator(start).integrate(strapdown.compute_increments_from_imu(imu, "increment"))

    table = strapdown.compute_increments_from_imu(imu, "increment")
    dt, theta, gained = (np.ascontiguousarray(table.values[:, part]) for part in ([0], [1, 2, 3], [4, 5, 6]))
    lla, velocity, attitude = np.empty((STEPS + 1, 3)), np.zeros((STEPS + 1, 3)), np.empty((STEPS + 1, 3, 3))
    lla[0], attitude[0] = start[LLA_COLS], transform.mat_from_rph(start[RPH_COLS])

    def kernel() -> None:
        integrate(dt.ravel(), lla, velocity, attitude, theta, gained, 0, True)

    return {"pyins": whole, "pyins kernel": kernel}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--rounds", type=int, default=7)
    arguments = parser.parse_args()
    dv, dtheta, interval = increments()
    site, attitude = Site.at(math.radians(35.7), 1200.0), body_to_tangent(0.0, 0.0, 0.0)
    out = np.zeros((STEPS + 1, 10))
    contenders: dict[str, Any] = {
        "inertrim": lambda: navigate(dv, dtheta, interval, attitude, site, math.radians(40.0)),
        "reading only": lambda: _read(dv, dtheta, interval, out),
        **pyins_contenders(dv, dtheta),
    }
    times = take_turns(contenders, arguments.rounds)
    ours = times["inertrim"]["median_s"]
    rows = [["inertrim.strapdown.navigate", millions(STEPS, ours), "1"]]
    for name, found in times.items():
        if name != "inertrim":
            rows.append([name, millions(STEPS, found["median_s"]), f"{found['median_s'] / ours:.2f} × our time"])
    if "pyins" not in times:
        rows.append(["pyins", "not installed", ""])
    found = {
        "steps": STEPS,
        "times": times,
        "ratio": {name: value["median_s"] / ours for name, value in times.items()},
        "table": {"header": ["strapdown, 300 s at 2 kHz", "steps/s", "ratio in the same run"], "rows": rows},
    }
    print(json.dumps(found, indent=2))
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
