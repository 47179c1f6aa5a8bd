"""A dead band's half-width is read off its samples, right within its own σ, rounding, heavy tails and all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from closed_form import RATE_HZ, WHITE, model, recording
from hidden_case import hidden_case
from scipy.stats import chi2

from inertial.documents import ChannelNoise, Noise
from simulators.discrepancy.compare import Scene, compare
from simulators.discrepancy.dead_band_width import half_width
from simulators.discrepancy.report import discrepancy

SIGMA = WHITE["gyro"] * np.sqrt(RATE_HZ)
RUNS = 12


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A record on a table, six attitudes."""
    return compare(recording(None, 1), model())


def silenced(
    scene: Scene, seed: int, width: float, step: float, noise: Noise, jolts: np.ndarray | None = None
) -> Scene:
    """Return a gyro that feels nothing below ``width`` and then rounds its integral to steps [rad/s a sample]."""
    rng = np.random.default_rng(seed)
    rate = scene.predicted[:, 5] + SIGMA * (rng.standard_normal(len(scene.predicted)) if jolts is None else jolts)
    rate = np.where(np.abs(rate) < width, 0.0, rate)
    if step:
        total = rng.random() + np.cumsum(rate) / step
        rate = np.diff(np.rint(total), prepend=np.rint(total[0] - rate[0] / step)) * step
    measured = scene.measured.copy()
    measured[:, 5] = rate
    return replace(scene, measured=measured, model=scene.model.model_copy(update={"noise": noise}))


@pytest.mark.parametrize(("width", "step", "wider"), [(1.5, 0.25, 1.0), (4.0, 1.5, 1.0), (6.0, 3.0, 4.0)])
def test_the_width_lies_where_its_sigma_says(scene: Scene, width: float, step: float, wider: float) -> None:
    """χ² of RUNS widths over their σ, 99.9 %; Earth's rate is up to 5 σ.

    Of steps as wide as three σ of the noise a reading takes back what the one before it rounded, which is not reckoned
    with: the σ may be up to four times too wide there.
    """
    channels = {f"{kind}_{axis}": ChannelNoise(white=WHITE[kind]) for kind in WHITE for axis in "xyz"}
    channels["gyro_z"] = channels["gyro_z"].model_copy(update={"quantisation": step * SIGMA / RATE_HZ})
    off = []
    for seed in range(RUNS):
        one = silenced(scene, seed, width * SIGMA, step * SIGMA, Noise(**channels))
        found = half_width([one], "gyro_z", 1.2 * width * SIGMA)
        assert found is not None
        off.append((found.value - width * SIGMA) / found.sigma)
    low, high = chi2.interval(0.999, RUNS)
    assert low / wider**2 < np.sum(np.square(off)) < high, off


@pytest.mark.parametrize("tails", ["outliers", "student"])
def test_heavy_tails_are_no_narrower_noise(scene: Scene, tails: str) -> None:
    """Where a step hides the band, the width hangs on how large the noise is: within a tenth all the same."""
    rng = np.random.default_rng(9)
    count = len(scene.predicted)
    noise = rng.standard_t(4, count) / np.sqrt(2.0)
    if tails == "outliers":
        noise = rng.standard_normal(count) * np.where(rng.random(count) < 0.02, 5.0, 1.0)
    channels = scene.model.noise.gyro_z.model_copy(update={"quantisation": 2.0 * SIGMA / RATE_HZ})
    one = silenced(scene, 9, 2.0 * SIGMA, 2.0 * SIGMA, scene.model.noise.model_copy(update={"gyro_z": channels}), noise)
    found = half_width([one], "gyro_z", 2.4 * SIGMA)
    assert found is not None
    assert abs(found.value / (2.0 * SIGMA) - 1.0) < 0.1


def test_where_nothing_is_silent_nothing_is_read_off(scene: Scene) -> None:
    assert half_width([silenced(scene, 1, 0.0, 0.0, scene.model.noise)], "gyro_z", SIGMA) is None


@pytest.mark.parametrize(("seed", "number"), [(90616, 12), (90609, 370), (90631, 22), (90639, 482), (90625, 30)])
def test_a_band_of_the_noise_s_own_width_has_no_step_beside_it(seed: int, number: int, tmp_path: Path) -> None:
    """What it takes away in the mean hangs on the noise, with heavy tails or of another size than all of it shows."""
    case = hidden_case(seed, number, tmp_path)
    report = discrepancy([case.recording], case.model)
    (true,) = case.truth["effects"]
    assert [(one["effect"], one["channel"]) for one in report.findings] == [("dead_band", true["channel"])]
    found = report.findings[0]["parameters"]["half_width"]
    assert abs(found["value"] - true["parameters"]["half_width"]) < 3.3 * found["sigma"]


def test_a_band_that_silences_most_of_a_record_leaves_the_noise_as_large_as_it_is(tmp_path: Path) -> None:
    """What is left of it was taken for all: the band came out seven σ too narrow, and two good samples were wild."""
    case = hidden_case(90618, 417, tmp_path)
    report = discrepancy([case.recording], case.model)
    found = next(one for one in report.findings if one["effect"] == "dead_band")["parameters"]["half_width"]
    (true,) = case.truth["effects"]
    assert abs(found["value"] - true["parameters"]["half_width"]) < 3.3 * found["sigma"]
    assert report.document["outliers"] == []
