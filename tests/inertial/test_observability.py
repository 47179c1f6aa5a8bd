"""What cannot be seen is named in words, with its size, and a second attitude takes away what it should."""

from __future__ import annotations

import math

import numpy as np
import pytest

from inertial.attitude import body_to_tangent
from inertial.documents import ChannelNoise, Noise
from inertial.earth import Site
from inertial.error_model import Coefficients
from inertial.observability import correlation, tilt_axes
from inertial.optimal import LauncherReference, OptimalEstimate, Segment, Turn, estimate

SITE = Site.at(math.radians(35.7), 1200.0)
AZIMUTH = math.radians(40.0)
ACCEL, GYRO = ChannelNoise(white=2e-4), ChannelNoise(white=3e-6)
NOISE = Noise(accel_x=ACCEL, accel_y=ACCEL, accel_z=ACCEL, gyro_x=GYRO, gyro_y=GYRO, gyro_z=GYRO)
HALF_TURN = Turn(np.array([0.0, 0.0, 1.0]), math.pi, "tangent", 1e-5)


def still(C_tb: np.ndarray, start_s: float = 0.0, turns: tuple[Turn, ...] = ()) -> Segment:
    count = 120
    gravity, earth = np.array([0.0, 0.0, SITE.gravity_mps2]), SITE.earth_rate_radps(AZIMUTH)
    ones = np.ones((count, 1))
    return Segment(
        start_s + np.arange(1.0, count + 1), ones * (C_tb.T @ gravity), ones * (C_tb.T @ earth), ones[:, 0], turns
    )


def look(
    C_tb: np.ndarray, *, level: float = math.inf, azimuth: float = math.inf, frame: str | None = None
) -> OptimalEstimate:
    segments = [still(C_tb)]
    if frame:
        half = np.diag([-1.0, -1.0, 1.0])
        segments.append(still(half @ C_tb, 200.0, (HALF_TURN,)))
    reference = LauncherReference(C_tb, AZIMUTH, level, azimuth, "body" if frame == "body" else "tangent")
    return estimate(segments, SITE, reference, NOISE, Coefficients.ideal())


def test_without_reference_three_combinations_are_named() -> None:
    found = look(np.eye(3)).unobservable
    assert [unseen.bounded_by for unseen in found] == ["nothing"] * 3
    texts = [unseen.text for unseen in found]
    assert texts[0].startswith("level y accelerometer bias and roll are one: 1 mg ≡ 1 mrad; give a level reference")
    assert texts[1].startswith("level x accelerometer bias and pitch are one: 1 mg ≡ 1 mrad; give a level reference")
    assert "east gyro bias" in texts[2]
    assert "azimuth error are one" in texts[2]
    assert all("second attitude" in text for text in texts)


def test_equivalence_of_east_gyro_and_azimuth_has_the_factor_of_level_earth_rate() -> None:
    azimuth = look(np.eye(3)).unobservable[2]
    level_rate = float(np.linalg.norm(SITE.earth_rate_radps(AZIMUTH)[:2]))
    size = math.hypot(*(azimuth.weights.get(name, 0.0) for name in ("g_x", "g_y")))
    assert size == pytest.approx(level_rate, rel=1e-9)
    degrees = 1.0 / (math.degrees(level_rate) * 3600.0) * math.degrees(1.0)
    assert f"1 deg/h ≡ {degrees:.3g} deg" in azimuth.text


def test_moving_along_an_unseen_combination_changes_no_reading() -> None:
    C_tb = body_to_tangent(0.02, 0.3, 0.5)
    for unseen in look(C_tb).unobservable:
        step = 1e-5
        tilt = np.array([unseen.weights.get("level_1", 0.0), unseen.weights.get("level_2", 0.0), 0.0]) * step
        turn = unseen.weights.get("azimuth", 0.0) * step
        f = np.array([unseen.weights.get(name, 0.0) for name in ("f_x", "f_y", "f_z")]) * step
        g = np.array([unseen.weights.get(name, 0.0) for name in ("g_x", "g_y", "g_z")]) * step
        tilted = C_tb + np.cross(tilt, C_tb, axisb=0, axisc=0)
        gravity = np.array([0.0, 0.0, SITE.gravity_mps2])
        np.testing.assert_allclose(tilted.T @ gravity - f, C_tb.T @ gravity, atol=1e-8)
        np.testing.assert_allclose(
            tilted.T @ SITE.earth_rate_radps(AZIMUTH + turn) - g, C_tb.T @ SITE.earth_rate_radps(AZIMUTH), atol=1e-13
        )


def test_a_reference_bounds_them_and_is_named_as_what_does() -> None:
    found = look(np.eye(3), level=5e-5, azimuth=1e-3)
    assert [unseen.bounded_by for unseen in found.unobservable] == ["reference"] * 3
    assert "0.05 mg ≡ 0.05 mrad" in found.unobservable[0].text
    assert np.all(np.isfinite(found.sigma))
    assert not np.any(found.unseen)


def test_second_attitude_separates_a_level_error_of_the_room() -> None:
    found = look(np.eye(3), frame="tangent")
    assert all("accelerometer" not in unseen.text for unseen in found.unobservable)
    assert found.sigma[0] < 1e-4  # noise of two minutes, no longer the tilt
    assert np.all(np.isfinite(found.sigma))


def test_a_level_error_that_rides_with_the_block_stays_unseen() -> None:
    found = look(np.eye(3), frame="body")
    assert any("accelerometer" in unseen.text and unseen.bounded_by == "nothing" for unseen in found.unobservable)
    assert np.isinf(found.sigma[0])


def test_block_on_end_has_tilts_about_its_level_axes() -> None:
    nose_up = body_to_tangent(0.0, math.pi / 2, 0.0)
    assert [axis.name for axis in tilt_axes(nose_up)] == ["tilt about body y", "tilt about body z"]
    texts = " ".join(unseen.text for unseen in look(nose_up).unobservable)
    assert "level y accelerometer bias and tilt about body z are one" in texts
    assert "level z accelerometer bias and tilt about body y are one" in texts


def test_correlation_of_a_covariance() -> None:
    found = correlation(np.array([[4.0, 3.0, 0.0], [3.0, 9.0, 0.0], [0.0, 0.0, 0.0]]))
    np.testing.assert_allclose(found, [[1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 0.0]])
