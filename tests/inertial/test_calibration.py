"""Turntable calibration: coefficients planted by a truth written apart from the estimator come back within their σ."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from inertial.calibration import (
    DTG_MOUNTING,
    CalibrationPrior,
    CalibrationResult,
    TableRun,
    calibrate_table,
    calibration_report,
    coefficient_names,
)
from inertial.documents import Calibration, ChannelNoise, Noise, parse_document
from inertial.earth import EARTH_RATE_RADPS, Site
from inertial.error_model import Coefficients, readings_from_true
from inertial.increments import Increments
from inertial.table_plan import Table, plan_table_run
from inertial.turntable import TableSetup, TableTurn

Array = NDArray[np.float64]
SITE = Site.at(math.radians(35.7), 1200.0)
STEP_S, FINE = 0.05, 5
ARCSEC = math.radians(1.0 / 3600.0)
ACCEL_WHITE, GYRO_WHITE = 2e-4, 2e-6  # 20 µg/√Hz, 0.007 deg/√h
NOISE = Noise.model_validate(
    {f"accel_{a}": {"white": ACCEL_WHITE} for a in "xyz"} | {f"gyro_{a}": {"white": GYRO_WHITE} for a in "xyz"}
)
TABLE = Table(rate_radps=math.radians(40.0), slew_radps=math.radians(40.0), angle_sigma_rad=2.0 * ARCSEC)
SETUP = TableSetup(SITE, math.radians(20.0), np.eye(3), (), level_sigma_rad=3e-5, azimuth_sigma_rad=3e-5)


@cache
def planned() -> tuple[TableSetup, float]:
    plan = plan_table_run(SETUP, NOISE, table=TABLE, steps=40, rest_s=15.0)
    return plan.setup, plan.duration_s


def planted(seed: int) -> Coefficients:
    """DTG-grade: scale factors off by a per mille, ± differing by 100 ppm, misalignments of a mrad, 5 mg, 10 deg/h."""
    rng = np.random.default_rng(seed)

    def pair() -> tuple[Array, Array]:
        common = np.eye(3) + 1e-3 * rng.standard_normal((3, 3))
        half = 50e-6 * rng.standard_normal((3, 3))
        return common + half, common - half

    g_sensitivity = np.zeros((3, 3))
    for i, columns in enumerate([(0, 1), (0, 1), (0, 2)]):
        g_sensitivity[i, columns] = 5e-6 * rng.standard_normal(2)  # 10 deg/h/g
    return Coefficients(*pair(), 0.05 * rng.standard_normal(3), *pair(), 5e-5 * rng.standard_normal(3), g_sensitivity)


def truth_values(coefficients: Coefficients, names: tuple[str, ...]) -> Array:
    document = coefficients.to_document().model_dump()
    values = []
    for name in names:
        own, kind, *other = name.split(".")
        entry = document[own][kind]
        values.append(entry.get(other[0], 0.0) if other else entry)
    return np.array(values)


def table_run(
    setup: TableSetup,
    duration_s: float,
    coefficients: Coefficients,
    seed: int,
    *,
    tilt_rad: Array | None = None,
    noise: float = 1.0,
) -> Increments:
    """Simulate: the table speeds up and down smoothly, turns by angles that are off by their σ; readings have noise.

    ``tilt_rad`` (3,) turns the whole room. Truth by composing rotations at a fine step, apart from the estimator.
    """
    rng = np.random.default_rng(seed)
    count = round(duration_s / STEP_S)
    time = np.arange(count * FINE + 1) * STEP_S / FINE
    room = Rotation.from_rotvec(np.zeros(3) if tilt_rad is None else tilt_rad)
    inner, outer = np.zeros((len(time), 3)), np.zeros((len(time), 3))
    for turn in setup.turns:
        s = np.clip((time - turn.start_s) / (turn.end_s - turn.start_s), 0.0, 1.0)
        progress = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)  # at rest at both ends, twice the mean rate between
        angle = turn.angle_rad + turn.angle_sigma_rad * rng.standard_normal()
        (inner if turn.frame == "body" else outer)[:] += np.outer(progress * angle, turn.axis)
    attitude = room * Rotation.from_rotvec(outer) * Rotation.from_matrix(setup.C_tb) * Rotation.from_rotvec(inner)
    relative = (attitude[:-1].inv() * attitude[1:]).as_rotvec()
    middle = (attitude[:-1] * Rotation.from_rotvec(relative / 2.0)).inv()
    earth = SITE.earth_rate_radps(setup.azimuth_rad)
    turned = relative + middle.apply(earth) * STEP_S / FINE
    force = middle.apply([0.0, 0.0, SITE.gravity_mps2])
    rate = turned.reshape(count, FINE, 3).sum(axis=1) / STEP_S
    accel, gyro = readings_from_true(force.reshape(count, FINE, 3).mean(axis=1), rate, coefficients)
    accel = accel + noise * ACCEL_WHITE / math.sqrt(STEP_S) * rng.standard_normal(accel.shape)
    gyro = gyro + noise * GYRO_WHITE / math.sqrt(STEP_S) * rng.standard_normal(gyro.shape)
    return Increments(0.0, accel * STEP_S, gyro * STEP_S, np.full(count, STEP_S))


@cache
def one_run() -> tuple[CalibrationResult, Coefficients]:
    setup, duration = planned()
    truth = planted(1)
    tilt = np.array([2e-5, -3e-5, 4e-5])
    return calibrate_table([TableRun(table_run(setup, duration, truth, 2, tilt_rad=tilt), setup)]), truth


def test_all_planted_coefficients_come_back_within_three_sigma_and_residuals_are_noise() -> None:
    result, truth = one_run()
    error = (result.values - truth_values(truth, result.order)) / result.sigma
    assert len(result.order) == 48
    assert np.max(np.abs(error)) < 3.5  # 48 draws
    assert np.mean(np.abs(error) > 3.0) <= 1 / 48
    covariance = result.covariance
    nees = float((error * result.sigma) @ np.linalg.solve(covariance, error * result.sigma))
    assert chi2.ppf(0.0005, 48) < nees < chi2.ppf(0.9995, 48)
    assert 0.0005 < result.chi_square_probability < 0.9995
    assert not result.unobservable
    normalised = np.array([residual.normalised for residual in result.residuals])
    assert np.sqrt(np.mean(normalised**2)) == pytest.approx(1.0, abs=0.15)
    assert np.max(np.abs(normalised)) < 5.0


def test_sign_asymmetry_of_a_hundred_ppm_is_resolved() -> None:
    result, truth = one_run()
    wanted = truth_values(truth, result.order)
    for channel, limit in (("accel_x", 25e-6), ("accel_z", 25e-6), ("gyro_x", 5e-6), ("gyro_z", 5e-6)):
        plus, minus = (result.order.index(f"{channel}.scale_{sign}") for sign in ("positive", "negative"))
        difference = np.zeros(48)
        difference[[plus, minus]] = 1.0, -1.0
        sigma = math.sqrt(difference @ result.covariance @ difference)
        assert sigma < limit
        assert abs(difference @ (result.values - wanted)) < 3.5 * sigma


def test_filter_and_batch_agree_to_a_millionth_of_sigma() -> None:
    result, _ = one_run()
    assert result.disagreement < 1e-6


def test_table_errors_are_found_with_the_coefficients() -> None:
    result, _ = one_run()
    for name, planted_rad in (("level 1", 2e-5), ("level 2", -3e-5)):
        value, sigma = result.nuisances[f"run 1: {name}"]
        assert abs(value - planted_rad) < 4.0 * sigma
        assert sigma < 2e-5


def test_sigma_predicted_by_the_planner_is_what_comes_out() -> None:
    result, _ = one_run()
    plan = plan_table_run(SETUP, NOISE, table=TABLE, steps=40, rest_s=15.0)
    # The real rests lose a little more to the standstill judgement, and noise is estimated from them.
    assert result.sigma / plan.sigma == pytest.approx(np.ones(48), rel=0.4)


def test_covariance_is_consistent_over_runs() -> None:
    setup, duration = planned()
    total = 0.0
    runs = 3
    for seed in range(runs):
        truth = planted(10 + seed)
        tilt = 3e-5 * np.random.default_rng(seed).standard_normal(3)
        result = calibrate_table(
            [TableRun(table_run(setup, duration, truth, 20 + seed, tilt_rad=tilt), setup)], noise=NOISE
        )
        error = result.values - truth_values(truth, result.order)
        total += float(error @ np.linalg.solve(result.covariance, error))
    assert chi2.ppf(0.0005, 48 * runs) < total < chi2.ppf(0.9995, 48 * runs)


def test_a_wrong_table_angle_shows_in_chi_square() -> None:
    setup, duration = planned()
    window = table_run(setup, duration, planted(1), 2)
    wrong = list(setup.turns)
    wrong[7] = replace(wrong[7], rate_radps=wrong[7].rate_radps * 1.001)
    result = calibrate_table([TableRun(window, replace(setup, turns=tuple(wrong)))])
    assert result.chi_square_probability < 1e-6


def test_six_positions_leave_a_bias_that_is_named_and_not_invented() -> None:
    turns, now, rate = [], 20.0, math.radians(30.0)
    for frame in ("body", "body", "body", "body", "tangent", "tangent", "tangent"):
        axis = (1.0, 0.0, 0.0) if frame == "body" else (0.0, 1.0, 0.0)
        turns.append(TableTurn(now, now + 3.0, rate, axis, frame, ARCSEC))
        now += 25.0
    setup = replace(SETUP, turns=tuple(turns))
    truth = planted(3)
    result = calibrate_table([TableRun(table_run(setup, now, truth, 4), setup)], noise=NOISE)
    texts = " ".join(combination.text for combination in result.unobservable)
    assert "gyro_z.scale_positive" in texts  # nothing turned about z
    assert "turns in the positive sense about gyro_z" in texts
    assert any("accel" in combination.text and "half way" in combination.text for combination in result.unobservable)
    seen = np.array([result.order.index(name) for name in ("gyro_x.scale_positive", "gyro_y.bias_radps")])
    error = (result.values - truth_values(truth, result.order))[seen] / result.sigma[seen]
    assert np.max(np.abs(error)) < 4.0


def test_mounting_decides_which_g_sensitivities_there_are() -> None:
    assert sum("g_sensitivity" in name for name in coefficient_names(DTG_MOUNTING)) == 6
    assert not any("g_sensitivity" in name for name in coefficient_names({}))
    assert "gyro_z.g_sensitivity_radps_per_mps2.accel_y" in coefficient_names({"gyro_z": ("accel_y",)})
    with pytest.raises(ValueError, match="names no sensor"):
        coefficient_names({"gyro_q": ("accel_x",)})


def test_noise_that_crosses_zero_does_not_go_into_the_bias() -> None:
    """A level accelerometer with S⁺ ≠ S⁻ by 4 % and 0.02 m/s² of noise a sample rectifies 0.3 mm/s²."""
    setup, duration = planned()
    ideal = Coefficients.ideal()
    lopsided = replace(ideal, accel_positive=np.diag([1.02, 1.0, 1.0]), accel_negative=np.diag([0.98, 1.0, 1.0]))
    result = calibrate_table([TableRun(table_run(setup, duration, lopsided, 5, noise=20.0), setup)])
    bias = result.order.index("accel_x.bias_mps2")
    assert abs(result.values[bias]) < 3.5 * result.sigma[bias]
    assert 0.0005 < result.chi_square_probability < 0.9995


def test_two_recordings_are_pooled_and_lost_or_moving_spans_are_named() -> None:
    setup, duration = planned()
    truth = planted(6)
    whole = table_run(setup, duration, truth, 7)
    knocked = whole.dtheta_rad.copy()
    rest = int((setup.turns[0].start_s - 7.0) / STEP_S)
    knocked[rest : rest + 20] += math.radians(0.05)
    cut = len(whole) * 3 // 4
    second = Increments(0.0, whole.dv_mps[:cut], knocked[:cut], whole.interval_s[:cut])
    single = calibrate_table([TableRun(whole, setup)], noise=NOISE)
    both = calibrate_table(
        [TableRun(table_run(setup, duration, truth, 8), setup), TableRun(second, setup)], noise=NOISE
    )
    assert any("run 2" in text and "does not hold all of it" in text for text in both.refused)
    assert np.all(both.sigma < 1.001 * single.sigma)
    error = (both.values - truth_values(truth, both.order)) / both.sigma
    assert np.max(np.abs(error)) < 4.0


def test_nothing_to_calibrate_from_is_refused() -> None:
    short = Increments(0.0, np.zeros((20, 3)), np.zeros((20, 3)), np.full(20, STEP_S))
    with pytest.raises(ValueError, match="no rest"):
        calibrate_table([TableRun(short, SETUP)], noise=NOISE)


def test_document_round_trips_and_report_states_the_equation() -> None:
    result, _ = one_run()
    document = result.to_document(block="B7", date="2026-01-01", table_run="run", temperature_range_c=(20.0, 30.0))
    again = parse_document(Calibration, document.canonical_json(), "calibration.json")
    restored = Coefficients.from_document(again.coefficients)
    assert np.array_equal(restored.accel_positive, result.coefficients.accel_positive)
    assert np.array_equal(restored.g_sensitivity, result.coefficients.g_sensitivity)
    assert np.array_equal(np.array(again.covariance), result.covariance)
    report = calibration_report(result)
    assert "A_x = S+ a_x+" in report
    for name in result.order:
        assert name in report


def test_an_error_that_rides_with_the_block_is_a_rotation_of_its_axes() -> None:
    """A block askew in its fixture: gravity and turns keep their table axes, all its own axes are rotated."""
    setup, duration = planned()
    riding = replace(setup, level_frame="body", level_sigma_rad=1e-3)
    window = table_run(setup, duration, Coefficients.ideal(), 9)
    skewed = Rotation.from_rotvec([4e-4, -2e-4, 0.0]).inv()
    askew = Increments(0.0, skewed.apply(window.dv_mps), skewed.apply(window.dtheta_rad), window.interval_s)
    result = calibrate_table([TableRun(askew, riding)], noise=NOISE)
    # Either the fixture or the misalignments: one and the same, so σ holds the prior of the fixture.
    name = "accel_z.misalignment_positive.accel_x"
    assert result.sigma[result.order.index(name)] == pytest.approx(1e-3, rel=0.1)
    error = (result.values - truth_values(Coefficients.ideal(), result.order)) / result.sigma
    assert np.max(np.abs(error)) < 4.0
    assert result.chi_square_probability > 0.0005


def test_earth_rate_alone_calibrates_a_gyro_bias() -> None:
    """Hand arithmetic: one level rest, no turns; every scale one: bias = Earth rate − reading."""
    rest = 60.0
    count = round(rest / STEP_S)
    setup = replace(SETUP, azimuth_rad=0.0, level_sigma_rad=0.0, azimuth_sigma_rad=0.0)
    reading = np.array([1e-5, 2e-5, 3e-5])
    window = Increments(
        0.0,
        np.tile([0.0, 0.0, SITE.gravity_mps2 * STEP_S], (count, 1)),
        np.tile(reading * STEP_S, (count, 1)),
        np.full(count, STEP_S),
    )
    certain = CalibrationPrior(scale=1e-9, misalignment=1e-9, g_sensitivity_radps_per_mps2=1e-12)
    result = calibrate_table([TableRun(window, setup)], noise=NOISE, prior=certain)
    latitude = SITE.latitude_rad
    earth = EARTH_RATE_RADPS * np.array([math.cos(latitude), 0.0, math.sin(latitude)])
    assert result.coefficients.gyro_bias_radps == pytest.approx(earth - reading, abs=1e-12)


def test_channel_noise_other_than_white_widens_sigma() -> None:
    setup, duration = planned()
    window = table_run(setup, duration, Coefficients.ideal(), 11)
    drifting = NOISE.model_copy(update={"gyro_x": ChannelNoise(white=GYRO_WHITE, flicker=1e-6)})
    plain = calibrate_table([TableRun(window, setup)], noise=NOISE)
    wide = calibrate_table([TableRun(window, setup)], noise=drifting)
    bias = plain.order.index("gyro_x.bias_radps")
    assert wide.sigma[bias] > 1.3 * plain.sigma[bias]
