"""Calibration by hand: the real Xsens recording against the published result, and planted coefficients."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.recording import read_recording
from drivers.samples import intervals_s
from inertial.calibration import CalibrationResult, calibration_report
from inertial.earth import EARTH_RATE_RADPS
from inertial.increments import Increments
from inertial.multiposition import calibrate_by_hand

Array = NDArray[np.float64]
STEP_S, GRAVITY = 0.02, 9.81
ACCEL_LSB, GYRO_LSB, OFFSET = 0.0024, 0.00015979546, 32768.0  # of the recording's [columns]


@pytest.fixture(scope="module")
def xsens(shared_data: Path) -> CalibrationResult:
    recording = read_recording(shared_data / "recordings" / "xsens_multiposition")
    samples = recording.samples
    interval = intervals_s(samples)
    window = Increments(float(samples["time"][0] - interval[0]), samples["dv"], samples["dtheta"], interval)
    gravity = recording.meta.site.gravity_mps2
    assert gravity is not None
    return calibrate_by_hand(window, gravity)


def as_published(matrix: Array, bias: Array, lsb: float) -> tuple[Array, Array, Array]:
    """Return scale [unit/count], bias [counts] and T of a = T·K·(raw − b), from A = M·reading + b."""
    scale = np.diag(matrix)
    return scale * lsb, OFFSET - np.linalg.solve(matrix, bias) / lsb, matrix / scale


def test_real_accelerometers_agree_with_the_published_result(xsens: CalibrationResult) -> None:
    found = xsens.coefficients
    scale, bias, T = as_published(found.accel_positive, found.accel_bias_mps2, ACCEL_LSB)
    assert scale == pytest.approx([0.00241278, 0.00242712, 0.00241168], rel=1e-3)
    assert bias == pytest.approx([33124.2, 33275.2, 32364.4], abs=10.0)
    published = np.array([[1.0, -0.0033593, -0.00890639], [0.0, 1.0, -0.0213341], [0.0, 0.0, 1.0]])
    assert pytest.approx(published, abs=1e-3) == T
    assert np.array_equal(found.accel_positive, found.accel_negative)


def test_real_gyros_agree_with_the_published_result(xsens: CalibrationResult) -> None:
    found = xsens.coefficients
    scale, bias, T = as_published(found.gyro_positive, found.gyro_bias_radps, GYRO_LSB)
    assert scale == pytest.approx([0.000209295, 0.000209899, 0.000209483], rel=1e-3)
    assert bias == pytest.approx([32777.1, 32459.8, 32511.8], abs=10.0)
    published = [[1.0, 0.00593634, 0.00111101], [0.00808812, 1.0, -0.0535569], [0.0253067, -0.0025513, 1.0]]
    assert pytest.approx(np.array(published), abs=1e-3) == T


def test_what_gravity_cannot_see_is_said(xsens: CalibrationResult) -> None:
    texts = [combination.text for combination in xsens.unobservable]
    assert sum("gravity's magnitude does not change" in text for text in texts) == 3
    assert any("latitude" in text for text in texts)
    assert any("S+ from S-" in text for text in texts)
    assert "gyro_y at rest follows the attitude" in calibration_report(xsens)


def hand_recording(
    seed: int,
    *,
    accel: Array,
    accel_bias: Array,
    gyro: Array,
    gyro_bias: Array,
    g_sensitivity: Array | None = None,
    latitude_rad: float = math.radians(45.0),
    accel_noise: float = 0.0,
    gyro_noise: float = 0.0,
    rests: int = 26,
    rest_s: float = 4.0,
) -> Increments:
    """Turn a block through random attitudes: true A, G from rotations in space, readings by the inverse of (1), (2)."""
    rng = np.random.default_rng(seed)
    move_s, fine = 2.0, 4
    count = round((rests * (rest_s + move_s) + 20.0) / STEP_S)
    time = np.arange(count * fine + 1) * STEP_S / fine
    attitude = Rotation.random(rng=rng)
    parts = []
    for k in range(rests):
        start = 20.0 + k * (rest_s + move_s)
        s = np.clip((time - start) / move_s, 0.0, 1.0)
        parts.append((start, s**3 * (10.0 - 15.0 * s + 6.0 * s**2), rng.standard_normal(3)))
    rotations = attitude
    whole = Rotation.concatenate([attitude] * len(time))
    for start, progress, axis in parts:
        vector = axis / np.linalg.norm(axis) * rng.uniform(0.8, 2.5)
        moving = time >= start
        whole[moving] = rotations * Rotation.from_rotvec(np.outer(progress[moving], vector))
        rotations = rotations * Rotation.from_rotvec(vector)
    earth = EARTH_RATE_RADPS * np.array([math.cos(latitude_rad), 0.0, math.sin(latitude_rad)])
    relative = (whole[:-1].inv() * whole[1:]).as_rotvec()
    middle = (whole[:-1] * Rotation.from_rotvec(relative / 2.0)).inv()
    turned = relative + middle.apply(earth) * STEP_S / fine
    rate = turned.reshape(count, fine, 3).sum(axis=1) / STEP_S
    force = middle.apply([0.0, 0.0, GRAVITY]).reshape(count, fine, 3).mean(axis=1)
    readings = np.linalg.solve(accel, (force - accel_bias).T).T
    felt = readings @ (np.zeros((3, 3)) if g_sensitivity is None else g_sensitivity).T
    rates = np.linalg.solve(gyro, (rate - gyro_bias - felt).T).T
    readings = readings + accel_noise * rng.standard_normal(readings.shape)
    rates = rates + gyro_noise * rng.standard_normal(rates.shape)
    return Increments(0.0, readings * STEP_S, rates * STEP_S, np.full(count, STEP_S))


UPPER = np.array([[1.01, 0.004, -0.007], [0.0, 0.98, 0.012], [0.0, 0.0, 1.005]])
ACCEL_BIAS = np.array([0.05, -0.08, 0.11])
FULL = np.array([[0.99, 0.01, -0.004], [0.006, 1.015, 0.008], [-0.009, 0.003, 1.002]])
GYRO_BIAS = np.array([2e-3, -1e-3, 3e-3])


def test_planted_coefficients_come_back_with_latitude_given() -> None:
    latitude = math.radians(45.0)
    F = np.array([[1e-5, -2e-5, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 3e-5]])
    window = hand_recording(
        1,
        accel=UPPER,
        accel_bias=ACCEL_BIAS,
        gyro=FULL,
        gyro_bias=GYRO_BIAS,
        g_sensitivity=F,
        accel_noise=2e-3,
        gyro_noise=2e-5,
    )
    mounting = {"gyro_x": ("accel_x", "accel_y"), "gyro_z": ("accel_z",)}
    result = calibrate_by_hand(window, GRAVITY, latitude_rad=latitude, mounting=mounting)
    found = result.coefficients
    assert found.accel_positive == pytest.approx(UPPER, abs=2e-4)
    assert found.accel_bias_mps2 == pytest.approx(ACCEL_BIAS, abs=2e-3)
    assert found.gyro_positive == pytest.approx(FULL, abs=5e-4)
    assert found.gyro_bias_radps == pytest.approx(GYRO_BIAS, abs=1e-5)  # 2 deg/h: the Earth's 15 is in the model
    assert found.g_sensitivity == pytest.approx(F, abs=2e-6)
    assert not result.notes
    values = {"accel_x.scale_positive": 1.01, "accel_z.bias_mps2": 0.11, "gyro_y.misalignment_positive.gyro_x": 0.006}
    for name, planted in values.items():
        k = result.order.index(name)
        assert abs(result.values[k] - planted) < 4.0 * result.sigma[k]


def test_without_latitude_the_earths_rate_is_in_the_sigma_of_the_bias() -> None:
    window = hand_recording(
        2, accel=UPPER, accel_bias=ACCEL_BIAS, gyro=FULL, gyro_bias=GYRO_BIAS, accel_noise=1e-3, gyro_noise=1e-6
    )
    result = calibrate_by_hand(window, GRAVITY)
    error = result.coefficients.gyro_bias_radps - GYRO_BIAS
    sigma = np.array([result.sigma[result.order.index(f"gyro_{axis}.bias_radps")] for axis in "xyz"])
    assert np.all(sigma > 0.5 * EARTH_RATE_RADPS)
    assert np.all(np.abs(error) < 3.0 * sigma)
    assert result.coefficients.gyro_positive == pytest.approx(FULL, abs=1e-3)


def test_a_rest_that_was_knocked_does_not_spoil_the_result() -> None:
    window = hand_recording(
        3, accel=UPPER, accel_bias=ACCEL_BIAS, gyro=FULL, gyro_bias=GYRO_BIAS, accel_noise=2e-3, gyro_noise=2e-5
    )
    pushed = window.dv_mps.copy()
    rest = round(23.0 / STEP_S)
    pushed[rest : rest + 100] *= 1.01
    again = calibrate_by_hand(Increments(0.0, pushed, window.dtheta_rad, window.interval_s), GRAVITY)
    assert again.coefficients.accel_positive == pytest.approx(UPPER, abs=5e-4)


def test_too_few_rests_and_wrong_units_are_refused_with_the_remedy() -> None:
    ideal = {"accel": np.eye(3), "accel_bias": np.zeros(3), "gyro": np.eye(3), "gyro_bias": np.zeros(3)}
    with pytest.raises(ValueError, match="lay the block down"):
        calibrate_by_hand(hand_recording(4, rests=5, accel_noise=1e-3, gyro_noise=1e-5, **ideal), GRAVITY)
    window = hand_recording(5, rests=14, accel_noise=1e-3, gyro_noise=1e-5, **ideal)
    in_g = Increments(0.0, window.dv_mps / GRAVITY, window.dtheta_rad, window.interval_s)
    with pytest.raises(ValueError, match=r"\[columns\]"):
        calibrate_by_hand(in_g, GRAVITY)
