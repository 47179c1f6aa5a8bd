"""Alignment on a moving launcher: real records, planted sway, and a covariance that tells the truth."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyarrow.parquet as parquet
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from inertial.alignment import Reference
from inertial.attitude import body_to_tangent, rotation_vector
from inertial.documents import ChannelNoise, Noise
from inertial.earth import EARTH_RATE_RADPS, Site
from inertial.error_model import Coefficients
from inertial.increments import Increments
from inertial.inertial_alignment import InertialAlignment, align_in_inertial_frame, inertial_alignment

Array = NDArray[np.float64]
SITE = Site.at(math.radians(40.0), 100.0)
STEP_S, FINE = 0.05, 6


def swaying_launcher(
    seed: int,
    duration_s: float = 100.0,
    *,
    sway_m: float = 0.0,
    sway_rad: float = 0.0,
    bump_m: float = 0.0,
    accel_noise: float = 0.0,
    gyro_noise: float = 0.0,
) -> tuple[Array, Array, Array, Array]:
    """Return dv, dtheta, intervals and the true C_tb (north, west, up) at the end.

    Written from rotations in inertial space, so apart from the estimator: six sinusoids a channel of 0.15 to 2 Hz.
    """
    rng = np.random.default_rng(seed)
    count = round(duration_s / STEP_S)
    time = (
        np.arange(count * FINE + 1) * STEP_S / FINE
    )  # fine steps: their small rotations add up to the rate's integral

    def oscillation(size: float) -> Array:
        frequency, phase = rng.uniform(0.15, 2.0, (6, 3)), rng.uniform(0.0, math.tau, (6, 3))
        waves = np.sin(math.tau * frequency * time[:, None, None] + phase)
        return np.asarray(size / math.sqrt(3.0) * waves.sum(axis=1))

    place = oscillation(sway_m)
    place += bump_m * 0.5 * (1.0 + np.tanh((time[:, None] - duration_s * rng.uniform(0.2, 0.8)) / 0.2))
    C_tb0 = body_to_tangent(0.02, -0.03, rng.uniform(0.0, math.tau))
    tangent_to_inertial = Rotation.from_rotvec(np.outer(time, SITE.earth_rate_radps(0.0)))
    body_to_tangent_t = Rotation.from_rotvec(oscillation(sway_rad)) * Rotation.from_matrix(C_tb0)
    attitude = tangent_to_inertial * body_to_tangent_t
    turned = (attitude[:-1].inv() * attitude[1:]).as_rotvec()
    velocity = np.gradient(tangent_to_inertial.apply(place), STEP_S / FINE, axis=0)
    up = SITE.gravity_mps2 * tangent_to_inertial.apply([0.0, 0.0, 1.0])
    gained = np.diff(velocity, axis=0) + 0.5 * STEP_S / FINE * (up[1:] + up[:-1])
    felt = (attitude[:-1] * Rotation.from_rotvec(turned / 2.0)).inv().apply(gained)
    dtheta, dv = turned.reshape(count, FINE, 3).sum(axis=1), felt.reshape(count, FINE, 3).sum(axis=1)
    dtheta = dtheta + gyro_noise * math.sqrt(STEP_S) * rng.standard_normal(dtheta.shape)
    dv = dv + accel_noise * math.sqrt(STEP_S) * rng.standard_normal(dv.shape)
    return dv, dtheta, np.full(count, STEP_S), body_to_tangent_t[-1].as_matrix()


def error_rad(found: InertialAlignment, C_tb: Array) -> Array:
    """Return φ with C_true = exp(φ)·C_found."""
    return rotation_vector(C_tb @ found.C_tb.T)


def real_record(folder: Path, name: str) -> Increments:
    table = parquet.read_table(folder / "recordings" / f"{name}.parquet")
    dv = np.column_stack([table.column(f"dv_{axis}_mps").to_numpy() for axis in "xyz"])
    dtheta = np.column_stack([table.column(f"dtheta_{axis}_rad").to_numpy() for axis in "xyz"])
    return Increments(0.0, dv, dtheta, np.full(len(dv), 0.01))


def first(window: Increments, seconds: float, start: float = 0.0) -> Increments:
    rows = slice(round(start * 100), round((start + seconds) * 100))
    return Increments(start, window.dv_mps[rows], window.dtheta_rad[rows], window.interval_s[rows])


@pytest.mark.parametrize("name", ["rlg_vehicle_quiet", "rlg_vehicle_disturbed"])
@pytest.mark.parametrize("seconds", [60.0, 120.0, 300.0])
def test_a_real_laser_gyro_block_finds_north_with_people_moving_about(
    shared_data: Path, name: str, seconds: float
) -> None:
    site = Site.at(math.radians(34.246048), 380.0)
    window = first(real_record(shared_data, name), seconds)
    found = inertial_alignment(window, Coefficients.ideal(), site, Reference(), Noise())
    assert math.degrees(found.azimuth_rad) == pytest.approx(90.6, abs=0.3)
    assert found.azimuth_source == "gyrocompass"


def test_plain_averaging_of_the_disturbed_record_is_degrees_wrong_where_this_is_not(shared_data: Path) -> None:
    window = real_record(shared_data, "rlg_vehicle_disturbed")
    rate = window.dtheta_rad.mean(axis=0)
    plain = math.degrees(math.atan2(rate[1], rate[0]))  # the block is level to half a degree
    site = Site.at(math.radians(34.246048), 380.0)
    found = align_in_inertial_frame(window.dv_mps, window.dtheta_rad, window.interval_s, site)
    assert abs(plain - 90.6) > 5.0
    assert math.degrees(found.azimuth_rad) == pytest.approx(90.6, abs=0.1)
    assert math.degrees(found.azimuth_sigma_rad) < 0.1


def test_single_minutes_of_the_real_records_scatter_as_their_sigma_says(shared_data: Path) -> None:
    site = Site.at(math.radians(34.246048), 380.0)
    deviations = []
    for name in ("rlg_vehicle_quiet", "rlg_vehicle_disturbed"):
        window = real_record(shared_data, name)
        for start in np.arange(0.0, 300.0, 60.0):
            part = first(window, 60.0, start)
            found = align_in_inertial_frame(part.dv_mps, part.dtheta_rad, part.interval_s, site)
            deviations.append((found.azimuth_rad - math.radians(90.6)) / found.azimuth_sigma_rad)
    squared = float(np.sum(np.square(deviations)))
    assert squared < chi2.ppf(0.999, len(deviations))  # each window's own data, no noise given


def test_a_still_noiseless_block_aligns_exactly() -> None:
    dv, dtheta, interval, truth = swaying_launcher(3)
    found = align_in_inertial_frame(dv, dtheta, interval, SITE)
    assert np.abs(error_rad(found, truth)).max() < 1e-6


def test_sway_of_a_centimetre_and_a_tenth_of_a_degree_averages_out_and_attitude_is_that_of_the_end() -> None:
    dv, dtheta, interval, truth = swaying_launcher(4, sway_m=0.01, sway_rad=0.002)
    found = align_in_inertial_frame(dv, dtheta, interval, SITE)
    assert np.abs(error_rad(found, truth)[:2]).max() < 20e-6
    assert abs(error_rad(found, truth)[2]) < math.radians(0.1)


@pytest.mark.parametrize(
    ("sway_m", "sway_rad", "bump_m", "accel_noise", "gyro_noise"),
    [(0.01, 0.002, 0.0, 1e-4, 1e-6), (0.01, 0.002, 0.03, 3e-5, 3e-7)],
    ids=["swaying", "swaying and kicked"],
)
def test_covariance_is_consistent_on_a_swaying_launcher(
    sway_m: float, sway_rad: float, bump_m: float, accel_noise: float, gyro_noise: float
) -> None:
    runs, total = 14, 0.0
    for seed in range(runs):
        dv, dtheta, interval, truth = swaying_launcher(
            100 + seed,
            60.0,
            sway_m=sway_m,
            sway_rad=sway_rad,
            bump_m=bump_m,
            accel_noise=accel_noise,
            gyro_noise=gyro_noise,
        )
        found = align_in_inertial_frame(
            dv, dtheta, interval, SITE, velocity_random_walk=accel_noise, angle_random_walk=gyro_noise
        )
        phi = error_rad(found, truth)
        total += float(phi @ np.linalg.solve(found.covariance, phi))
    low, high = chi2.ppf([0.0005, 0.9995], 3 * runs)
    assert low < total < high


def test_a_kick_is_found_and_does_not_spoil_the_azimuth() -> None:
    dv, dtheta, interval, truth = swaying_launcher(7, bump_m=0.2, accel_noise=3e-5, gyro_noise=3e-7)
    found = align_in_inertial_frame(dv, dtheta, interval, SITE, velocity_random_walk=3e-5, angle_random_walk=3e-7)
    assert found.bumps_s
    assert abs(error_rad(found, truth)[2]) < 4.0 * found.azimuth_sigma_rad
    assert math.degrees(found.azimuth_sigma_rad) < 0.3


def test_west_gyro_and_accelerometer_errors_turn_the_azimuth_as_theory_says_and_stay_in_sigma() -> None:
    dv, dtheta, interval, truth = swaying_launcher(11)
    known = {"velocity_random_walk": 1e-6, "angle_random_walk": 1e-9}
    west = STEP_S * truth.T @ np.array([0.0, 1.0, 0.0])
    with_bias = align_in_inertial_frame(dv + 1e-3 * west, dtheta, interval, SITE, accel_sigma_mps2=1e-3, **known)
    with_drift = align_in_inertial_frame(dv, dtheta + 1e-8 * west, interval, SITE, gyro_sigma_radps=1e-8, **known)
    # A west force is taken for a tilt about north, and that moves the axis about which gravity turns by tan L; a
    # drift about west turns it by its share of the level Earth rate (Groves section 5.6.2).
    tilt = 1e-3 / SITE.gravity_mps2
    turn = 1e-8 / (EARTH_RATE_RADPS * math.cos(SITE.latitude_rad))
    by_bias, by_drift = error_rad(with_bias, truth), error_rad(with_drift, truth)
    assert abs(by_bias[0]) == pytest.approx(tilt, rel=1e-2)
    assert abs(by_bias[2]) == pytest.approx(tilt * math.tan(SITE.latitude_rad), rel=3e-2)
    assert abs(by_drift[2]) == pytest.approx(turn, rel=3e-2)
    assert with_bias.level_sigma_rad == pytest.approx(tilt, rel=5e-2)
    assert with_bias.azimuth_sigma_rad == pytest.approx(tilt * math.tan(SITE.latitude_rad), rel=5e-2)
    assert with_drift.azimuth_sigma_rad == pytest.approx(turn, rel=5e-2)


def test_given_azimuth_and_heading_are_kept_and_the_level_is_the_blocks_own() -> None:
    dv, dtheta, interval, truth = swaying_launcher(5, sway_m=0.01, accel_noise=1e-5, gyro_noise=1e-7)
    quiet = Noise(accel_x=ChannelNoise(white=1e-5), gyro_x=ChannelNoise(white=1e-7))
    window = Increments(0.0, dv, dtheta, interval)
    reference = Reference(azimuth_rad=1.0, azimuth_sigma_rad=1e-3, roll_rad=0.5, pitch_rad=0.5, heading_rad=0.2)
    given = inertial_alignment(window, Coefficients.ideal(), SITE, reference, quiet)
    own = inertial_alignment(window, Coefficients.ideal(), SITE, Reference(heading_rad=0.2), quiet)
    assert (given.azimuth_rad, given.azimuth_sigma_rad, given.azimuth_source) == (1.0, 1e-3, "given")
    assert given.level_source == "accelerometers"
    assert given.C_tb == pytest.approx(own.C_tb)
    from_north = body_to_tangent(0.0, 0.0, own.azimuth_rad) @ own.C_tb
    assert np.abs(rotation_vector(from_north @ truth.T)).max() < 4.0 * own.azimuth_sigma_rad


@pytest.mark.parametrize(
    ("site", "seconds", "said"),
    [(SITE, 5.0, "lasts 5.0 s"), (Site.at(math.pi / 2), 30.0, "pole")],
)
def test_what_cannot_be_aligned_is_refused_with_the_reason(site: Site, seconds: float, said: str) -> None:
    dv, dtheta, interval, _ = swaying_launcher(1, seconds)
    with pytest.raises(ValueError, match=said):
        align_in_inertial_frame(dv, dtheta, interval, site)
