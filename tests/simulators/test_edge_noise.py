"""A dead band at rest is told from a shift by the noise of an input near its edge, and from nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from closed_form import RATE_HZ, WHITE, model, recording
from hidden_case import hidden_case
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from drivers.recording import Recording
from inertial.documents import BlockModel
from simulators.discrepancy.edge_noise import read_sigma
from simulators.discrepancy.report import discrepancy

DRAWS = 4000
STEP = 10.0  # σ of a sample


@given(
    st.floats(-5.0, 5.0),
    st.floats(0.0, 5.0),
    st.floats(1e-6, 1e3),
    st.integers(0, 2**32 - 1),
)
def test_the_noise_of_readings_is_that_of_samples_drawn(level: float, width: float, sigma: float, seed: int) -> None:
    """The mean square of DRAWS readings about their mean, within six of its own σ, as their fourth moment has it."""
    drawn = level + np.random.default_rng(seed).standard_normal(DRAWS)
    read = np.where(np.abs(drawn) < width, 0.0, drawn)
    square = (read - read.mean()) ** 2
    # Rare readings beyond the band, of which there may be none, are as uncertain as Poisson's law has them.
    off = 6.0 * np.sqrt(square.var() / DRAWS) + 10.0 * (abs(width) + 3.0) ** 2 / DRAWS
    found = read_sigma(np.array([level]) * sigma, sigma, width * sigma) / sigma
    assert abs(found**2 - square.mean()) < off


def at_rest(seed: int, shift: float, noisier: float, half_width: float) -> tuple[Recording, BlockModel]:
    """Return a recording at rest of a gyro that rounds, shifted, noisier or silenced; sizes in σ of a sample."""
    sigma = WHITE["gyro"] * np.sqrt(RATE_HZ)
    quiet = recording(None, seed, moving=False)
    rate = quiet.samples["dtheta"][:, 0] * RATE_HZ
    rate = rate.mean() + shift * sigma + noisier * (rate - rate.mean())
    rate = np.where(np.abs(rate) < half_width * sigma, 0.0, rate)
    step = STEP * sigma / RATE_HZ
    total = np.rint(0.3 + np.concatenate([[0.0], np.cumsum(rate) / RATE_HZ / step]))
    samples = quiet.samples.copy()
    samples["dtheta"][:, 0] = np.diff(total) * step
    stated = model()
    channel = stated.noise.gyro_x.model_copy(update={"quantisation": step})
    noise = stated.noise.model_copy(update={"gyro_x": channel})
    return replace(quiet, samples=samples), stated.model_copy(update={"noise": noise})


@pytest.mark.parametrize("half_width", [2.5, 3.2, 3.6])
def test_a_dead_band_near_whose_edge_the_input_is_explains_shift_and_noise(half_width: float) -> None:
    """Earth's rate is 3.2 σ of a sample here; the width is right within what 99.9 % are."""
    one, stated = at_rest(5, 0.0, 1.0, half_width)
    (found,) = discrepancy([one], stated).findings
    assert (found["effect"], found["channel"]) == ("dead_band", "gyro_x")
    width = found["parameters"]["half_width"]
    off = width["value"] - half_width * WHITE["gyro"] * np.sqrt(RATE_HZ)
    assert off**2 < chi2.ppf(0.999, 1) * width["sigma"] ** 2


def test_noise_that_is_larger_by_another_measure_is_no_band() -> None:
    """A shift beside larger white noise stays what it is."""
    one, stated = at_rest(6, -1.0, 1.4, 0.0)
    report = discrepancy([one], stated)
    found = {(f["effect"], f["channel"]) for f in report.findings}
    assert found == {("bias_shift", "gyro_x"), ("random_walk", "gyro_x")}


@pytest.mark.parametrize("number", [7, 392])
def test_readouts_that_hold_back_at_rest_are_named_or_tied(number: int, tmp_path: Path) -> None:
    """A limit far below the noise, and a dead band: two of the blind generator's cases that had wrong names."""
    case = hidden_case(90633, number, tmp_path)
    (truth,) = case.truth["effects"]
    (found,) = discrepancy([case.recording], case.model).findings
    names = {(found["effect"], found["channel"])} | {(a["effect"], a["channel"]) for a in found["alternatives"]}
    assert (truth["effect"], truth["channel"]) in names
