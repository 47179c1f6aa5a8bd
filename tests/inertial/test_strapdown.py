"""Strapdown navigation against closed forms that share nothing with its loop."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import j1

from inertial.attitude import body_to_tangent, rotation_matrix, rotation_vector
from inertial.earth import Site
from inertial.strapdown import PAPER_CORIOLIS, navigate

Array = NDArray[np.float64]
SITE = Site.at(math.radians(35.7), 1200.0)
AZIMUTH = math.radians(40.0)
EARTH_RATE = SITE.earth_rate_radps(AZIMUTH)
GRAVITY = np.array([0.0, 0.0, SITE.gravity_mps2])
WEIGHTLESS = Site(SITE.latitude_rad, 0.0, 0.0)


def at_rest(C_tb: Array, duration_s: float, interval_s: float) -> tuple[Array, Array]:
    count = round(duration_s / interval_s)
    return np.tile(C_tb.T @ GRAVITY * interval_s, (count, 1)), np.tile(C_tb.T @ EARTH_RATE * interval_s, (count, 1))


@pytest.mark.parametrize("coriolis", [2.0, PAPER_CORIOLIS])
def test_block_at_rest_stays_where_it_is(coriolis: float) -> None:
    C = body_to_tangent(0.3, 0.8, 2.0)
    motion = navigate(*at_rest(C, 300.0, 0.01), 0.01, C, SITE, AZIMUTH, coriolis=coriolis)
    assert motion.time_s[-1] == pytest.approx(300.0)
    assert motion.radial_m[-1] < 1e-5
    assert np.abs(motion.velocity_mps[-1]).max() < 1e-7
    assert np.abs(rotation_vector(motion.C_tb[-1] @ C.T)).max() < 1e-10


def test_paper_coriolis_differs_at_rest_only_by_the_error_velocity_it_turns() -> None:
    # With a level accelerometer error a the velocity is a·t; one ω×v more or less makes ω·a·t²/2: 1e-3 of it in 30 s.
    dv, dtheta = at_rest(np.eye(3), 30.0, 0.01)
    dv[:, 0] += 1e-3 * 0.01
    once, twice = (
        navigate(dv, dtheta, 0.01, np.eye(3), SITE, AZIMUTH, coriolis=c, gravity_gradient=False).velocity_mps[-1]
        for c in (PAPER_CORIOLIS, 2.0)
    )
    np.testing.assert_allclose(once - twice, np.cross(EARTH_RATE, [1e-3, 0, 0]) * 30.0**2 / 2, rtol=2e-3, atol=1e-7)
    assert np.linalg.norm(once - twice) < 2e-3 * np.linalg.norm(twice)


def test_turn_on_the_table_leaves_position_and_shows_the_angle() -> None:
    # 90° to the left at 1 deg/s about body z, level: ω_b = Rz(−rt)·ω_t + r·z, integrated by hand; then rest.
    rate, interval = math.radians(1.0), 0.01
    t = np.arange(9001) * interval
    e1, e2, e3 = EARTH_RATE
    angle = np.column_stack(
        [
            (e1 * np.sin(rate * t) - e2 * np.cos(rate * t)) / rate,
            (e1 * np.cos(rate * t) + e2 * np.sin(rate * t)) / rate,
            (e3 + rate) * t,
        ]
    )
    dv = np.tile(GRAVITY * interval, (9000, 1))
    motion = navigate(dv, np.diff(angle, axis=0), interval, np.eye(3), SITE, AZIMUTH)
    np.testing.assert_allclose(motion.C_tb[-1], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-10)
    assert np.abs(motion.velocity_mps[-1]).max() < 1e-8
    assert motion.radial_m[-1] < 1e-6


def test_constant_rate_and_force_are_integrated_exactly_however_large() -> None:
    # Seen from inertial space: v = ∫exp(s·w×)·f ds, the tangent frame turning under it, which is v̇ = C·f − 1·ω×v.
    w, f, interval, count = np.array([7.0, -9.0, 11.0]), np.array([30.0, -20.0, 10.0]), 0.02, 500
    motion = navigate(
        np.tile(f * interval, (count, 1)),
        np.tile(w * interval, (count, 1)),
        interval,
        np.eye(3),
        WEIGHTLESS,
        AZIMUTH,
        coriolis=1.0,
    )
    total = count * interval
    earth_turn = rotation_matrix(-EARTH_RATE * total)
    np.testing.assert_allclose(motion.C_tb[-1], earth_turn @ rotation_matrix(w * total), atol=1e-11)
    expected = earth_turn @ constant_rate_integral(w, total) @ f
    np.testing.assert_allclose(motion.velocity_mps[-1], expected, atol=2e-6 * np.linalg.norm(expected) + 1e-6)


def constant_rate_integral(w: Array, t: float) -> Array:
    """∫₀ᵗ exp(s·w×) ds by Rodrigues' formula, term by term."""
    size = float(np.linalg.norm(w))
    x, y, z = w / size
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) * t + K * (1 - math.cos(size * t)) / size + K @ K * (t - math.sin(size * t) / size))


def coning(time_s: Array, cone: float, frequency: float) -> tuple[Array, Array]:
    """Rotation vector α(cos Ωt, sin Ωt, 0) and the integral of its body rate.

    With q = (cos α/2, sin α/2·cos Ωt, sin α/2·sin Ωt, 0), 2·q*⊗q̇ = (−Ω sin α sin Ωt, Ω sin α cos Ωt, −2Ω sin² α/2).
    """
    phase = frequency * time_s
    vector = cone * np.column_stack([np.cos(phase), np.sin(phase), np.zeros_like(phase)])
    angle = np.column_stack(
        [
            math.sin(cone) * np.cos(phase),
            math.sin(cone) * np.sin(phase),
            -2.0 * math.sin(cone / 2) ** 2 * phase,
        ]
    )
    return vector, angle


@pytest.mark.parametrize("jitter", [0.0, 0.3], ids=["even", "uneven intervals"])
def test_pure_coning_does_not_drift(jitter: float) -> None:
    # Uncorrected, increments alone drift by about α²Ω/2·(ΩT)²/6 about z: 0.33 rad/h here. What the two-sample
    # correction leaves is of order (ΩT)⁴ (Savage 1998, part 1, section V): below 1 % of it at ΩT = 0.126.
    cone, frequency, interval, count = math.radians(1.0), 2 * math.pi * 10.0, 0.002, 50_000
    steps = interval * (1 + jitter * np.random.default_rng(3).uniform(-1, 1, count))
    time = np.concatenate([[0.0], np.cumsum(steps)])
    vector, angle = coning(time, cone, frequency)
    C0 = rotation_matrix(vector[0])
    motion = navigate(np.zeros((count, 3)), np.diff(angle, axis=0), steps, C0, WEIGHTLESS, AZIMUTH)
    truth = rotation_matrix(-EARTH_RATE * time[-1]) @ rotation_matrix(vector[-1])
    uncorrected = cone**2 * frequency / 2 * (frequency * interval) ** 2 / 6 * time[-1]
    assert np.abs(rotation_vector(motion.C_tb[-1] @ truth.T)).max() < (0.01 if not jitter else 0.03) * uncorrected


def test_sculling_gains_the_velocity_of_the_closed_form() -> None:
    # Rocking θ₀·sin Ωt about x with force b·sin Ωt along body y: up, ∫b·sin u·sin(θ₀ sin u) = b·J₁(θ₀) on average.
    rock, force, frequency, interval, count = 0.02, 5.0, 2 * math.pi * 10.0, 0.002, 5000
    time = np.arange(count + 1) * interval
    dtheta = np.zeros((count, 3))
    dtheta[:, 0] = np.diff(rock * np.sin(frequency * time))
    dv = np.zeros((count, 3))
    dv[:, 1] = np.diff(-force / frequency * np.cos(frequency * time))
    # The Earth stands still for this one: at a pole nothing but up is turned, and 10 s turn that by 0.7 mrad only.
    pole = Site(math.pi / 2, 0.0, 0.0)
    motion = navigate(dv, dtheta, interval, np.eye(3), pole, 0.0, coriolis=0.0)
    expected = force * j1(rock) * time[-1]
    assert motion.velocity_mps[-1, 2] == pytest.approx(expected, rel=2e-4)


def test_gyro_bias_drifts_as_the_cube_of_time() -> None:
    # ε about the left axis tips the nose down by ε·t: C·a gains +g·ε·t forward, so x = g·ε·t³/6. In 60 s the Earth's
    # turn changes that by ω·t ≈ 0.4 %.
    bias = math.radians(1.0) / 3600.0
    dv, dtheta = at_rest(np.eye(3), 60.0, 0.01)
    dtheta[:, 1] += bias * 0.01
    motion = navigate(dv, dtheta, 0.01, np.eye(3), SITE, AZIMUTH, gravity_gradient=False)
    expected = SITE.gravity_mps2 * bias * 60.0**3 / 6
    assert motion.position_m[-1, 0] == pytest.approx(expected, rel=5e-3)
    assert motion.velocity_mps[-1, 0] == pytest.approx(SITE.gravity_mps2 * bias * 60.0**2 / 2, rel=5e-3)
    assert abs(motion.position_m[-1, 1]) < 5e-3 * expected


def test_accelerometer_bias_drifts_as_the_square_of_time() -> None:
    dv, dtheta = at_rest(np.eye(3), 60.0, 0.01)
    dv[:, 2] += 1e-3 * 0.01
    motion = navigate(dv, dtheta, 0.01, np.eye(3), SITE, AZIMUTH, gravity_gradient=False)
    assert motion.position_m[-1, 2] == pytest.approx(1e-3 * 60.0**2 / 2, rel=1e-4)


def test_free_motion_turns_by_twice_the_earth_rate() -> None:
    # No force, no gravity: v̇ = −2ω×v, so v turns about −ω by 2ωt without changing its length.
    v0 = np.array([100.0, -50.0, 20.0])
    still = np.tile(EARTH_RATE * 0.1, (6000, 1))
    motion = navigate(np.zeros((6000, 3)), still, 0.1, np.eye(3), WEIGHTLESS, AZIMUTH, velocity0_mps=v0)
    np.testing.assert_allclose(motion.velocity_mps[-1], rotation_matrix(-2 * EARTH_RATE * 600.0) @ v0, atol=1e-8)


def test_northbound_free_motion_is_deflected_right_in_the_north() -> None:
    still = np.tile(WEIGHTLESS.earth_rate_radps(0.0) * 0.1, (100, 1))
    motion = navigate(np.zeros((100, 3)), still, 0.1, np.eye(3), WEIGHTLESS, 0.0, velocity0_mps=(100.0, 0.0, 0.0))
    assert motion.velocity_mps[-1, 1] < 0.0


def test_gravity_gradient_swings_level_and_runs_away_upwards() -> None:
    # ẍ = −g/R·x and z̈ = 2g/R·z from x = z = 0: v/ω_s·sin ω_s t, v/(√2 ω_s)·sinh √2 ω_s t (Schuler).
    C, v = np.eye(3), 10.0
    motion = navigate(*at_rest(C, 900.0, 0.1), 0.1, C, SITE, AZIMUTH, coriolis=0.0, velocity0_mps=(v, 0.0, v))
    schuler = math.sqrt(SITE.gravity_mps2 / SITE.radius_m)
    assert motion.position_m[-1, 0] == pytest.approx(v / schuler * math.sin(schuler * 900.0), rel=1e-6)
    upwards = math.sqrt(2) * schuler
    assert motion.position_m[-1, 2] == pytest.approx(v / upwards * math.sinh(upwards * 900.0), rel=1e-6)


def test_initial_state_is_the_first_row() -> None:
    dv, dtheta = at_rest(np.eye(3), 1.0, 0.01)
    motion = navigate(dv, dtheta, 0.01, np.eye(3), SITE, AZIMUTH, velocity0_mps=(1, 2, 3), position0_m=(4, 5, 6))
    np.testing.assert_array_equal(motion.velocity_mps[0], [1, 2, 3])
    np.testing.assert_array_equal(motion.position_m[0], [4, 5, 6])


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"interval_s": 0.0}, "interval"),
        ({"C_tb0": 2 * np.eye(3)}, "rotation"),
        ({"C_tb0": np.diag([1.0, 1.0, -1.0])}, "rotation"),
        ({"dtheta_rad": np.zeros((3, 3))}, "one row of each"),
        ({"dv_mps": np.zeros(3)}, "shape"),
    ],
)
def test_refuses_what_it_cannot_navigate(change: dict[str, object], word: str) -> None:
    dv, dtheta = at_rest(np.eye(3), 1.0, 0.01)
    given = {"dv_mps": dv, "dtheta_rad": dtheta, "interval_s": 0.01, "C_tb0": np.eye(3)} | change
    with pytest.raises(ValueError, match=word):
        navigate(**given, site=SITE, azimuth_rad=AZIMUTH)  # type: ignore[arg-type]
