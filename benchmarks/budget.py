"""Coverage of the error budget: how often strapdown navigation ends inside the predicted 50 % and 95 % bands.

Each run draws shifts, level and azimuth errors, simulates 180 s of rest and 300 s of rest, turning or vibration of the
same block in one go (so that slow flicker runs through both), estimates from the first part and navigates the second
from the estimated attitude with the terms in. The error is against navigation of the ideal increments.

    python -m benchmarks.budget --runs 1000 --json FILE [--seed S]
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import time
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from benchmarks.estimator import (
    AZIMUTH_RAD,
    AZIMUTH_SIGMA_RAD,
    LEVEL_SIGMA_RAD,
    SHIFT_SIGMA,
    known_noise,
    site,
)
from drivers.recording_meta import BlockMeta, MotionMeta, TurnMeta, VibrationMeta
from drivers.samples import SampleArray, intervals_s
from inertial.budget import Budget, Errors, Profile, predict
from inertial.error_model import Coefficients, true_from_readings
from inertial.optimal import (
    LauncherReference,
    OptimalEstimate,
    Priors,
    Segment,
    Weights,
    estimate_nodes,
    node_weights,
    nodes_of,
)
from inertial.strapdown import Navigation, navigate
from simulators.block import SimulatedBlock
from simulators.scenarios import demo_model, demo_scenario, effect, make_block

Array = NDArray[np.float64]

REST_S, FLIGHT_S, RATE_HZ = 180.0, 300.0, 50.0
ASKED_S = (60.0, 150.0, 300.0)
LEVELS = (0.5, 0.95)
MOTIONS: dict[str, list[MotionMeta]] = {
    "rest": [],
    "turning": [
        TurnMeta(kind="turn", start_s=200.0, end_s=290.0, rate_dps=1.0, axis=[0.0, 0.0, 1.0], frame="body"),
        TurnMeta(kind="turn", start_s=300.0, end_s=345.0, rate_dps=-2.0, axis=[0.0, 1.0, 0.0], frame="tangent"),
    ],
    "vibration": [
        VibrationMeta(kind="vibration", start_s=190.0, end_s=400.0, axis=[1.0, 0.0, 0.0], grms=1.0, band_hz=[5.0, 20.0])
    ],
}


def make(motion: str, seed: int) -> SimulatedBlock:
    """Return the demo's block with shifts and reference errors drawn from their priors."""
    normal = np.random.default_rng([seed, 11]).standard_normal(9)
    shift = normal[:6] * SHIFT_SIGMA
    tilt, turn = normal[6:8] * LEVEL_SIGMA_RAD, normal[8] * AZIMUTH_SIGMA_RAD
    entries = [
        effect("bias_shift", f"{kind}_{axis}", shift=(shift[3 * k + i], unit))
        for k, (kind, unit) in enumerate((("accel", "m/s^2"), ("gyro", "rad/s")))
        for i, axis in enumerate("xyz")
    ]
    entries.append(effect("level_error", "all", tilt_1=(tilt[0], "rad"), tilt_2=(tilt[1], "rad"), rides=(0.0, "1")))
    entries.append(effect("azimuth_error", "all", error=(turn, "rad")))
    demo = demo_scenario().warmed_up()
    changed = {"effect": entries, "motion": MOTIONS[motion], "block": BlockMeta(sample_rate_hz=RATE_HZ)}
    return make_block(demo.model_copy(update=changed).with_seed(seed), demo_model())


@lru_cache(maxsize=1)
def _coefficients() -> Coefficients:
    return Coefficients.from_document(demo_model().calibration)


@lru_cache(maxsize=1)
def _weights() -> Weights:
    samples = make("rest", 0).generate(int(REST_S * RATE_HZ))
    return node_weights(nodes_of([_segment(samples)], _coefficients()), known_noise(demo_model()))


def _segment(samples: SampleArray) -> Segment:
    return Segment(samples["time"], samples["dv"], samples["dtheta"], intervals_s(samples))


def estimated(samples: SampleArray) -> OptimalEstimate:
    """Return the optimal estimate from 180 s at rest, the noise known."""
    nodes = nodes_of([_segment(samples)], _coefficients())
    reference = LauncherReference(np.eye(3), AZIMUTH_RAD, LEVEL_SIGMA_RAD, AZIMUTH_SIGMA_RAD)
    priors = Priors(SHIFT_SIGMA[:3], SHIFT_SIGMA[3:])
    return estimate_nodes(nodes, _weights(), site(), reference, known_noise(demo_model()), _coefficients(), priors)


def run(task: tuple[str, int]) -> Array:
    """Return the position and velocity error (m, 6) of one run at the times asked for."""
    motion, seed = task
    block = make(motion, seed)
    samples = block.generate(int((REST_S + FLIGHT_S) * RATE_HZ))
    rest = int(REST_S * RATE_HZ)
    found = estimated(samples[:rest])
    interval = 1.0 / RATE_HZ
    flight = samples[rest:]
    force, rate = true_from_readings(flight["dv"] / interval, flight["dtheta"] / interval, _coefficients(), found.terms)
    used = navigate(force * interval, rate * interval, interval, found.C_tb[-1], site(), found.azimuth_rad)
    true = ideal(block)
    rows = np.rint(np.array(ASKED_S) * RATE_HZ).astype(int)
    return np.hstack([(used.position_m - true.position_m)[rows], (used.velocity_mps - true.velocity_mps)[rows]])


def ideal(block: SimulatedBlock) -> Navigation:
    """Return the navigation of what ideal sensors of this block would integrate."""
    truth = block.true_setup
    rest = int(REST_S * RATE_HZ)
    dv, dtheta = block.trajectory.increments(rest, int(FLIGHT_S * RATE_HZ), RATE_HZ)
    C_tb0 = block.trajectory.attitude(np.array([REST_S]))[0]
    return navigate(dv, dtheta, 1.0 / RATE_HZ, C_tb0, truth.site, truth.azimuth_rad)


def predicted(motion: str) -> Budget:
    """Return the budget along the motion as it is believed."""
    block = make(motion, 0)
    found = estimated(block.generate(int(REST_S * RATE_HZ)))
    profile = Profile.of(ideal(block), site(), AZIMUTH_RAD)
    return predict(Errors.of_estimate(found), profile, site(), AZIMUTH_RAD, known_noise(demo_model()), ASKED_S)


def coverage(motion: str, runs: int, seed: int) -> dict[str, Any]:
    """Return how many runs end inside each band, and whether that is what the prediction says."""
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    tasks = [(motion, seed + k) for k in range(runs)]
    errors = []
    with multiprocessing.get_context("spawn").Pool() as pool:
        for done, error in enumerate(pool.imap_unordered(run, tasks, chunksize=10), 1):
            errors.append(error)
            if done % 50 == 0 or done == runs:
                print(f"\r{motion}: {done} of {runs} runs", end="" if done < runs else "\n", flush=True)
    error = np.array(errors)
    budget = predicted(motion)
    sizes = {
        "radial_m": (np.linalg.norm(error[:, :, :3], axis=2), budget.radial_m),
        "horizontal_m": (np.linalg.norm(error[:, :, :2], axis=2), budget.horizontal_m),
        "speed_mps": (np.linalg.norm(error[:, :, 3:], axis=2), budget.speed_mps),
    }
    checks = []
    for name, (size, band) in sizes.items():
        for level in LEVELS:
            low, high = (int(binom.ppf(p, runs, level)) for p in (0.0005, 0.9995))
            for k, (at, limit) in enumerate(zip(ASKED_S, band(level), strict=True)):
                inside = int(np.sum(size[:, k] <= limit))
                found = {"quantity": name, "time_s": at, "level": level, "predicted": float(limit), "inside": inside}
                checks.append({**found, "allowed": [low, high], "in_band": low <= inside <= high})
    causes = [[{"cause": name, "share": share} for name, share in row] for row in budget.contributors()]
    return {"runs": runs, "checks": checks, "contributors": causes}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.budget", description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    if arguments.runs < 1:
        parser.error("give 1 run or more")
    started = time.perf_counter()
    motions = {
        motion: coverage(motion, arguments.runs, arguments.seed + k * arguments.runs)
        for k, motion in enumerate(MOTIONS)
    }
    checks = [check for found in motions.values() for check in found["checks"]]
    figures: dict[str, Any] = {
        "runs": arguments.runs,
        "motions": motions,
        "all_in_band": all(check["in_band"] for check in checks),
        "seconds": time.perf_counter() - started,
        "table": _table(motions, arguments.runs),
    }
    for row in (figures["table"]["header"], *figures["table"]["rows"]):
        print(" | ".join(row))
    print("all in band:", figures["all_in_band"])
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")


def _table(motions: dict[str, Any], runs: int) -> dict[str, Any]:
    rows = []
    for motion, found in motions.items():
        last = [c for c in found["checks"] if c["quantity"] == "radial_m" and math.isclose(c["time_s"], ASKED_S[-1])]
        cells = [f"{check['predicted']:.1f} m: {100.0 * check['inside'] / runs:.1f} % inside" for check in last]
        first = found["contributors"][-1][0]
        rows.append([motion, *cells, f"{first['cause']} ({100.0 * first['share']:.0f} %)"])
    header = [f"radial error after 300 s (N = {runs})", "50 % band", "95 % band", "largest contributor"]
    return {"header": header, "rows": rows}


if __name__ == "__main__":
    main()
