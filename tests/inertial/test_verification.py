"""Verification: its statistic is χ² when the terms are right, and fails when they are not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, kstest

from inertial.alignment import Alignment
from inertial.attitude import body_to_tangent, rotation_matrix
from inertial.compensation import ChainResult, paper_chain
from inertial.documents import ChannelNoise, Noise
from inertial.earth import Site
from inertial.error_model import Coefficients
from inertial.increments import Increments
from inertial.verification import Verification, consistency, verify

Array = NDArray[np.float64]
SITE = Site.at(math.radians(35.7), 1200.0)
AZIMUTH = math.radians(40.0)
C_TB = body_to_tangent(0.02, 0.1, 0.5)
IDEAL = Coefficients.ideal()
DEG_H = math.radians(1.0) / 3600.0
VRW, ARW = 20e-6 * 9.80665, math.radians(0.01) / 60.0
NOISE = Noise(
    **{f"accel_{a}": ChannelNoise(white=VRW) for a in "xyz"},
    **{f"gyro_{a}": ChannelNoise(white=ARW) for a in "xyz"},
)
INTERVAL = 0.5


def rest(start_s: float, rng: np.random.Generator, shift: Array, duration_s: float = 60.0) -> Increments:
    count = round(duration_s / INTERVAL)
    true = np.concatenate([C_TB.T @ [0.0, 0.0, SITE.gravity_mps2], C_TB.T @ SITE.earth_rate_radps(AZIMUTH)]) + shift
    rows = np.tile(true * INTERVAL, (count, 1))
    rows += rng.normal(size=(count, 6)) * np.repeat([VRW, ARW], 3) * math.sqrt(INTERVAL)
    return Increments(start_s, rows[:, :3], rows[:, 3:], np.full(count, INTERVAL))


def chain(rng: np.random.Generator, shift: Array, C_tb: Array = C_TB) -> ChainResult:
    alignment = Alignment(C_tb, AZIMUTH, 1e-4, 2e-3, "given", "given")
    return paper_chain([rest(60.0 * k, rng, shift) for k in range(3)], alignment, SITE, IDEAL, NOISE)


def shift_of(rng: np.random.Generator) -> Array:
    return rng.normal(size=6) * np.repeat([0.3 * 9.8e-3, 2.4 * DEG_H], 3)


def verified(seed: int, later: Array | None = None) -> Verification:
    rng = np.random.default_rng(seed)
    shift = shift_of(rng)
    # The reference is wrong as well: that is inside the terms and must not show.
    wrong = rotation_matrix(rng.normal(size=3) * [1e-4, 1e-4, 2e-3]) @ C_TB
    result = chain(rng, shift, wrong)
    return verify(rest(200.0, rng, shift + (0 if later is None else later)), result.at_rest, SITE, IDEAL, NOISE)


def test_statistic_is_chi_square_with_six_degrees_of_freedom() -> None:
    statistics = [verified(seed).statistic for seed in range(120)]
    assert kstest(statistics, chi2(6).cdf).pvalue > 1e-3
    low, high = chi2.ppf([0.0005, 0.9995], 6 * 120) / 120
    assert low < np.mean(statistics) < high


def test_a_good_run_passes_and_reports_what_it_saw() -> None:
    proof = verified(1)
    assert proof.passed
    assert proof.limit == pytest.approx(22.458, abs=1e-3)
    assert proof.duration_s == pytest.approx(60.0)
    assert np.all(np.abs(proof.velocity_mps) < 4 * proof.sigma[:3])
    assert np.all(np.abs(proof.attitude_rad) < 4 * proof.sigma[3:])


@pytest.mark.parametrize("channel", range(6))
def test_a_sensor_that_shifts_after_the_stages_fails(channel: int) -> None:
    later = np.zeros(6)
    later[channel] = 0.3 * 9.8e-3 if channel < 3 else 1.5 * DEG_H
    assert not verified(2, later).passed


def test_slow_noise_that_terms_and_window_share_is_not_counted_twice() -> None:
    # A bias instability far above the rest, so slow that it is one constant: the terms take it out of the window too.
    slow = ChannelNoise(white=ARW, flicker=5.0 * DEG_H)
    wandering = NOISE.model_copy(update={"gyro_z": slow})
    rng = np.random.default_rng(3)
    alignment = Alignment(C_TB, AZIMUTH, 0.0, 0.0, "given", "given")
    windows = [rest(60.0 * k, rng, np.zeros(6)) for k in range(3)]
    result = paper_chain(windows, alignment, SITE, IDEAL, wandering)
    proof = verify(rest(180.0, rng, np.zeros(6)), result.at_rest, SITE, IDEAL, wandering)
    if_independent = math.sqrt(result.noise_covariance[5, 5]) * 60.0
    assert proof.sigma[5] < 0.8 * if_independent


def test_consistency_by_hand() -> None:
    statistic, limit = consistency(np.array([2.0, 0.0]), np.array([[2.0, 1.0], [1.0, 2.0]]))
    assert statistic == pytest.approx(4 * 2 / 3)
    assert limit == pytest.approx(-2 * math.log(0.001))
