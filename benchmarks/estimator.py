"""Efficiency of the estimators: σ of their errors over many simulated runs, against the Bayesian Cramér–Rao bound.

Each run draws shifts of all sensors, level and azimuth errors from their priors, simulates the demo block at rest for
180 s at 100 Hz (``simulators``: coefficients, white noise, flicker, rounding to the frame) and estimates. The bound is
J⁻¹, J = HᵀR⁻¹H + P₀⁻¹, computed here from the model file by code of its own: H by differences of the rest equations, R
by the Gauss–Markov sum that defines flicker.

    python -m benchmarks.estimator --runs 5000 --json FILE [--seed S] [--noise-from-data]
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from drivers.protocols.native import DTHETA_LSB_RAD, DV_LSB_MPS
from drivers.samples import SampleArray, intervals_s
from inertial.alignment import Alignment
from inertial.compensation import paper_stage
from inertial.documents import BlockModel, ChannelNoise, Noise
from inertial.earth import Site
from inertial.error_model import Coefficients
from inertial.increments import Increments
from inertial.noise import noise_of_block
from inertial.optimal import (
    LauncherReference,
    Nodes,
    Priors,
    Segment,
    Weights,
    estimate_nodes,
    node_weights,
    nodes_of,
    supported_noise,
)
from simulators.scenarios import DEG, DEG_PER_H, MG, Scenario, demo_model, demo_scenario, effect, make_block

Array = NDArray[np.float64]

STAGES, STAGE_S, RATE_HZ = 3, 60.0, 100.0
SHIFT_SIGMA = np.array([0.3 * MG] * 3 + [2.4 * DEG_PER_H] * 3)
LEVEL_SIGMA_RAD, AZIMUTH_SIGMA_RAD = 0.003 * DEG, 0.1 * DEG
AZIMUTH_RAD = 40.0 * DEG
NAMES = ("f_x", "f_y", "f_z", "g_x", "g_y", "g_z", "level_1", "level_2", "azimuth")
NOISE_PARTS = ("f_z", "g_x", "g_y", "g_z")
"""Terms whose error is noise and not reference: where the paper's chain is expected at 1.86 with white noise."""


@dataclass(frozen=True)
class Case:
    """What is drawn: with ``ideal`` the noise is white and the reference exact, the case of the paper's 1.86."""

    ideal: bool = False

    @property
    def model(self) -> BlockModel:
        """The demo's block."""
        model = demo_model()
        if not self.ideal:
            return model
        channels = {name: ChannelNoise(white=channel.white) for name, channel in _channels(model.noise).items()}
        return model.model_copy(update={"noise": Noise.model_validate(channels)})

    @property
    def prior_sigma(self) -> Array:
        """1σ (9,) of everything drawn."""
        reference = np.array([LEVEL_SIGMA_RAD, LEVEL_SIGMA_RAD, AZIMUTH_SIGMA_RAD])
        return np.concatenate([SHIFT_SIGMA, np.full(3, 1e-9) if self.ideal else reference])


def _channels(noise: Noise) -> dict[str, ChannelNoise]:
    names = [f"{kind}_{axis}" for kind in ("accel", "gyro") for axis in "xyz"]
    return {name: getattr(noise, name) for name in names}


def simulate(case: Case, seed: int) -> tuple[Array, SampleArray]:
    """Draw the truth (9,) from its priors and return it with 180 s of samples."""
    truth = np.random.default_rng([seed, 7]).standard_normal(9) * case.prior_sigma
    entries = [
        effect("bias_shift", f"{kind}_{axis}", shift=(-truth[3 * k + i], unit))
        for k, (kind, unit) in enumerate((("accel", "m/s^2"), ("gyro", "rad/s")))
        for i, axis in enumerate("xyz")
    ]
    entries.append(effect("level_error", "all", tilt_1=(truth[6], "rad"), tilt_2=(truth[7], "rad"), rides=(0.0, "1")))
    entries.append(effect("azimuth_error", "all", error=(truth[8], "rad")))
    demo = demo_scenario().warmed_up()
    scenario: Scenario = demo.model_copy(update={"effect": entries}).with_seed(seed)
    block = make_block(scenario, case.model)
    return truth, block.generate(int(STAGES * STAGE_S * RATE_HZ))


def site() -> Site:
    """Return the demo's site."""
    demo = demo_scenario().site
    return Site.at((demo.latitude_deg or 0.0) * DEG, demo.height_m or 0.0)


def known_noise(model: BlockModel) -> Noise:
    """Return the model's noise with the rounding of the native frame, which the model leaves to the frame."""
    steps = {"accel": DV_LSB_MPS, "gyro": DTHETA_LSB_RAD}
    channels = {
        name: channel.model_copy(update={"quantisation": steps[name.partition("_")[0]]})
        for name, channel in _channels(model.noise).items()
    }
    return Noise.model_validate(channels)


# ---- the bound, by code that shares nothing with the estimator ----------------------------------------------------


def bound(case: Case) -> Array:
    """Return the covariance (9, 9) that no estimator can beat on average over the priors."""
    place = site()
    steps = np.array([1e-3] * 3 + [1e-6] * 3 + [1e-5] * 3)
    sensitivity = np.column_stack([(_rest(place, h) - _rest(place, -h)) / 2.0 for h in np.diag(steps)]) / steps
    noise = _channels(known_noise(case.model)).values()
    information = np.array([_mean_information(channel) for channel in noise])
    whole = sensitivity.T @ (information[:, None] * sensitivity) + np.diag(case.prior_sigma**-2.0)
    return np.asarray(np.linalg.inv(whole))


def _rest(place: Site, unknowns: Array) -> Array:
    """Return the mean of the six channels, calibrated, for an upright block on the azimuth with these unknowns."""
    azimuth = AZIMUTH_RAD + unknowns[8]
    earth = place.earth_rate_radps(azimuth)
    tilt = Rotation.from_rotvec([unknowns[6], unknowns[7], 0.0])
    gravity = np.array([0.0, 0.0, place.gravity_mps2])
    return np.concatenate([tilt.inv().apply(gravity), tilt.inv().apply(earth)]) - unknowns[:6]


def _mean_information(noise: ChannelNoise) -> float:
    """Return 1ᵀR⁻¹1 of one constant seen through the channel's noise, R over half-second means."""
    bins, width = int(STAGES * STAGE_S * 2), 0.5
    start = width * np.arange(bins)
    covariance = np.diag(np.full(bins, noise.white**2 / width + noise.quantisation**2 / 6.0 / width**2))
    covariance -= noise.quantisation**2 / 12.0 / width**2 * (np.eye(bins, k=1) + np.eye(bins, k=-1))
    lag = np.abs(start[:, None] - start[None, :])
    ratio = math.sqrt(2.0)
    times = 2e4 * ratio ** -np.arange(0.0, 60.0)
    for tau in times:
        averaged = (tau / width * 2.0 * math.sinh(width / (2.0 * tau))) ** 2 if width < 200.0 * tau else 0.0
        own = 2.0 * tau / width * (1.0 - tau / width * -math.expm1(-width / tau))
        gauss_markov = np.where(lag > 0.0, averaged * np.exp(-lag / tau), own)
        covariance += noise.flicker**2 * math.log(ratio) / math.pi * gauss_markov
    one = np.ones(bins)
    return float(one @ np.linalg.solve(covariance, one))


# ---- the runs -----------------------------------------------------------------------------------------------------


@lru_cache(maxsize=4)
def _known_weights(case: Case) -> Weights:
    _, samples = simulate(case, 0)
    return node_weights(_nodes(case, samples), known_noise(case.model))


def _nodes(case: Case, samples: SampleArray) -> list[Nodes]:
    return nodes_of(_segments(samples), _coefficients(case))


@lru_cache(maxsize=4)
def _coefficients(case: Case) -> Coefficients:
    return Coefficients.from_document(case.model.calibration)


def _segments(samples: SampleArray) -> list[Segment]:
    interval = intervals_s(samples)
    parts = [slice(k * len(samples) // STAGES, (k + 1) * len(samples) // STAGES) for k in range(STAGES)]
    return [Segment(samples["time"][k], samples["dv"][k], samples["dtheta"][k], interval[k]) for k in parts]


@dataclass(frozen=True)
class Outcome:
    """Errors of one run: estimated less true."""

    optimal: Array
    nees: float
    from_data: Array | None
    from_data_nees: float
    paper: Array


def run(task: tuple[Case, int, bool]) -> Outcome:
    """Simulate and estimate once."""
    case, seed, from_data = task
    truth, samples = simulate(case, seed)
    place, coefficients = site(), _coefficients(case)
    sigma = case.prior_sigma
    reference = LauncherReference(np.eye(3), AZIMUTH_RAD, float(sigma[6]), float(sigma[8]))
    priors = Priors(sigma[:3], sigma[3:6])
    nodes = _nodes(case, samples)
    known = known_noise(case.model)
    found = estimate_nodes(nodes, _known_weights(case), place, reference, known, coefficients, priors)
    error = found.value - truth
    own, own_nees = None, 0.0
    if from_data:
        interval = 1.0 / RATE_HZ
        noise = noise_of_block(samples["dv"] / interval, samples["dtheta"] / interval, interval)
        noise = supported_noise(nodes, noise)
        fitted = estimate_nodes(nodes, node_weights(nodes, noise), place, reference, noise, coefficients, priors)
        own = fitted.value - truth
        own_nees = float(own @ np.linalg.solve(fitted.covariance, own))
    nees = float(error @ np.linalg.solve(found.covariance, error))
    return Outcome(error, nees, own, own_nees, _paper(samples, place, coefficients) - truth[:6])


def _paper(samples: SampleArray, place: Site, coefficients: Coefficients) -> Array:
    alignment = Alignment(np.eye(3), AZIMUTH_RAD, LEVEL_SIGMA_RAD, AZIMUTH_SIGMA_RAD, "given", "given")
    terms = None
    for segment in _segments(samples):
        start = float(segment.time_s[0] - segment.interval_s[0])
        window = Increments(start, segment.dv_mps, segment.dtheta_rad, segment.interval_s)
        terms = paper_stage(window, alignment, place, coefficients, terms).terms
    assert terms is not None
    return np.concatenate([terms.f_mps2, terms.g_radps])


def study(case: Case, runs: int, runs_from_data: int, seed: int) -> dict[str, Any]:
    """Run one case on all cores and return its table."""
    tasks = [(case, seed + k, k < runs_from_data) for k in range(runs)]
    # The runs share the cores, so linear algebra within each must not.
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    began = time.perf_counter()
    with multiprocessing.get_context("spawn").Pool() as pool:
        outcomes = list(_progress(pool.imap_unordered(run, tasks, chunksize=10), runs))
    elapsed_s = time.perf_counter() - began
    limit = np.sqrt(np.diag(bound(case)))
    error = np.array([outcome.optimal for outcome in outcomes])
    paper = np.array([outcome.paper for outcome in outcomes])
    nees = np.array([outcome.nees for outcome in outcomes])
    found = {
        "runs": runs,
        "bound": dict(zip(NAMES, limit.tolist(), strict=True)),
        "efficiency": {
            "optimal": _ratios(error, limit),
            "paper": _ratios(paper, limit[:6]),
        },
        "allowed": 1.05 + 2.0 / math.sqrt(2.0 * runs),
        "nees": _nees(nees),
        "trials_per_s": runs / elapsed_s,
    }
    own = np.array([outcome.from_data for outcome in outcomes if outcome.from_data is not None])
    if len(own):
        found["noise_from_data"] = {
            "runs": len(own),
            "efficiency": _ratios(own, limit),
            "allowed": 1.15,
            "nees": _nees(np.array([outcome.from_data_nees for outcome in outcomes if outcome.from_data is not None])),
        }
    return found


def _ratios(errors: Array, limit: Array) -> dict[str, float]:
    """Return σ about the truth, so that a bias counts, over the bound."""
    ratio = np.sqrt(np.mean(errors**2, axis=0)) / limit
    return dict(zip(NAMES, ratio.tolist(), strict=False))


def _nees(values: Array) -> dict[str, Any]:
    """Return the mean normalised squared error of the whole vector with its 99.9 % band."""
    freedom = len(NAMES) * len(values)
    low, high = (float(chi2.ppf(p, freedom)) / len(values) for p in (0.0005, 0.9995))
    mean = float(values.mean())
    return {"mean": mean, "band": [low, high], "in_band": low <= mean <= high}


def _progress(outcomes: Iterator[Outcome], total: int) -> Iterator[Outcome]:
    for done, outcome in enumerate(outcomes, 1):
        if done % 50 == 0 or done == total:
            print(f"\r{done} of {total} runs", end="" if done < total else "\n", flush=True)
        yield outcome


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.estimator", description=__doc__)
    parser.add_argument("--runs", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument(
        "--noise-from-data", action="store_true", help="fit the noise in every run (default: in a tenth of them)"
    )
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    if arguments.runs < 2:
        parser.error("a spread needs 2 runs or more")
    started = time.perf_counter()
    tenth = max(arguments.runs // 10, 2)
    found = study(Case(), arguments.runs, arguments.runs if arguments.noise_from_data else tenth, arguments.seed)
    white = study(Case(ideal=True), tenth, 0, arguments.seed)
    figures = {
        **found,
        "nees_in_band": found["nees"]["in_band"],
        "white_noise_exact_reference": white,
        "seconds": time.perf_counter() - started,
        "table": _table(found, white),
    }
    print(json.dumps({key: value for key, value in figures.items() if key != "table"}, indent=2))
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")


def _table(found: dict[str, Any], white: dict[str, Any]) -> dict[str, Any]:
    rows = []
    for name in NAMES[:6]:
        level = name in ("f_x", "f_y")
        rows.append(
            [
                name,
                f"{found['efficiency']['optimal'][name]:.3f}",
                f"{found['noise_from_data']['efficiency'][name]:.3f}",
                f"{found['efficiency']['paper'][name]:.2f}",
                f"{white['efficiency']['paper'][name]:.2f}" + (" (level)" if level else ""),
            ]
        )
    speeds = [f"{one['trials_per_s']:.1f}" for one in (found, white)]
    rows.append([f"trials/s (simulated, estimated) on {os.cpu_count()} cores", speeds[0], "", "", speeds[1]])
    header = [
        "σ ÷ Cramér–Rao bound",
        f"optimal (N = {found['runs']})",
        f"optimal, noise from its own data (N = {found['noise_from_data']['runs']})",
        "paper's chain, same runs",
        f"paper's chain, white noise and exact reference (N = {white['runs']})",
    ]
    return {"header": header, "rows": rows}


if __name__ == "__main__":
    main()
