"""Coarse alignment: the attitude given or found, and its σ against scatter over seeds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from inertial.alignment import Reference, coarse_alignment
from inertial.attitude import body_to_tangent, rotation_vector
from inertial.documents import ChannelNoise, Noise
from inertial.earth import Site
from inertial.error_model import Coefficients, Terms
from inertial.increments import Increments

SITE = Site.at(math.radians(35.7), 0.0)
AZIMUTH = math.radians(40.0)
ROLL, PITCH, HEADING = 0.05, -0.3, 0.7
TRUE = body_to_tangent(ROLL, PITCH, HEADING)
WHITE = Noise(
    **{f"accel_{a}": ChannelNoise(white=1e-3) for a in "xyz"},
    **{f"gyro_{a}": ChannelNoise(white=3e-6) for a in "xyz"},
)


def rest(seed: int | None = None, f: float = 0.0, duration_s: float = 30.0) -> Increments:
    count = round(duration_s / 0.1)
    force = TRUE.T @ [0.0, 0.0, SITE.gravity_mps2] - f
    dv = np.tile(force * 0.1, (count, 1))
    dtheta = np.tile(TRUE.T @ SITE.earth_rate_radps(AZIMUTH) * 0.1, (count, 1))
    if seed is not None:
        rng = np.random.default_rng(seed)
        dv += rng.normal(size=dv.shape) * 1e-3 * math.sqrt(0.1)
        dtheta += rng.normal(size=dv.shape) * 3e-6 * math.sqrt(0.1)
    return Increments(0.0, dv, dtheta, np.full(count, 0.1))


def turned(C_tb: NDArray[np.float64]) -> NDArray[np.float64]:
    return rotation_vector(C_tb @ TRUE.T)


def test_given_reference_is_taken_as_given() -> None:
    reference = Reference(AZIMUTH, 2e-3, ROLL, PITCH, HEADING, 5e-5)
    found = coarse_alignment(rest(), Coefficients.ideal(), SITE, reference, WHITE)
    np.testing.assert_allclose(found.C_tb, TRUE, atol=1e-15)
    assert (found.azimuth_rad, found.azimuth_sigma_rad, found.level_sigma_rad) == (AZIMUTH, 2e-3, 5e-5)
    assert (found.level_source, found.azimuth_source) == ("given", "given")
    np.testing.assert_allclose(np.diag(found.covariance), [25e-10, 25e-10, 4e-6])


def test_block_levels_itself_and_finds_north() -> None:
    found = coarse_alignment(rest(), Coefficients.ideal(), SITE, Reference(heading_rad=HEADING), WHITE)
    assert found.azimuth_rad == pytest.approx(AZIMUTH, abs=1e-9)
    np.testing.assert_allclose(found.C_tb, TRUE, atol=1e-9)
    assert (found.level_source, found.azimuth_source) == ("accelerometers", "gyrocompass")


def test_accelerometer_bias_tilts_a_block_that_levels_itself_by_as_many_mrad_as_mg() -> None:
    reference = Reference(AZIMUTH, heading_rad=HEADING)
    found = coarse_alignment(rest(f=-9.80665e-3), Coefficients.ideal(), SITE, reference, WHITE)
    # 1 mg on every axis: what of it lies level, over g, is the tilt about the axis across it.
    level = (TRUE @ np.full(3, 9.80665e-3))[:2] / SITE.gravity_mps2
    np.testing.assert_allclose(turned(found.C_tb)[:2], [level[1], -level[0]], atol=1e-5)
    assert found.level_sigma_rad == pytest.approx(1e-3, rel=0.01)


def test_terms_are_applied_before_levelling() -> None:
    terms = Terms(np.full(3, 0.05), np.zeros(3))
    found = coarse_alignment(
        rest(f=0.05), Coefficients.ideal(), SITE, Reference(AZIMUTH, heading_rad=HEADING), WHITE, terms=terms
    )
    np.testing.assert_allclose(found.C_tb, TRUE, atol=1e-9)


def test_sigma_is_the_scatter_over_seeds() -> None:
    runs = 300
    errors = np.empty((runs, 3))
    for seed in range(runs):
        found = coarse_alignment(
            rest(seed),
            Coefficients.ideal(),
            SITE,
            Reference(heading_rad=HEADING),
            WHITE,
            accel_bias_sigma_mps2=0.0,
            gyro_bias_sigma_radps=0.0,
        )
        # The whole attitude error in a frame of the true azimuth: the found frame is turned by the azimuth error.
        errors[seed] = turned(found.C_tb)
        errors[seed, 2] = found.azimuth_rad - AZIMUTH
    low, high = chi2.ppf([0.0005, 0.9995], 2 * runs) / (2 * runs)
    assert low < np.mean(errors[:, :2] ** 2) / found.level_sigma_rad**2 < high
    low, high = chi2.ppf([0.0005, 0.9995], runs) / runs
    # 1σ is stated for a tilt about any axis; about north it leaks tan(latitude) into azimuth. The heading's share of
    # a pitched nose's roll error is left to the bound.
    assert low * 0.9 < np.mean(errors[:, 2] ** 2) / found.azimuth_sigma_rad**2 < high * 1.1


def test_a_falling_block_cannot_be_levelled() -> None:
    window = Increments(0.0, np.zeros((100, 3)), np.zeros((100, 3)), np.full(100, 0.1))
    with pytest.raises(ValueError, match="where gravity is"):
        coarse_alignment(window, Coefficients.ideal(), SITE, Reference(AZIMUTH), WHITE)


def test_no_north_at_the_pole() -> None:
    pole = Site.at(math.pi / 2, 0.0)
    with pytest.raises(ValueError, match="pole"):
        coarse_alignment(rest(), Coefficients.ideal(), pole, Reference(), WHITE)


def test_half_a_level_is_refused() -> None:
    with pytest.raises(ValueError, match="roll and pitch"):
        Reference(AZIMUTH, roll_rad=0.0)
