"""True motion against closed forms and against integrations made another way."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from inertial.attitude import body_to_tangent
from inertial.earth import EARTH_RATE_RADPS, Site
from simulators.motion import RAMP_SHARE, Motion, Setup, Trajectory, Turn, Vibration

LATITUDE = math.radians(35.7)
SITE = Site.at(LATITUDE, 1200.0)
LEVEL = np.eye(3)


def trajectory(*motions: Motion, C_tb: np.ndarray = LEVEL, azimuth_deg: float = 0.0) -> Trajectory:
    return Trajectory(Setup(SITE, math.radians(azimuth_deg), C_tb, motions), seed=5)


def test_a_level_block_at_rest_reads_plus_g_up_and_the_earth_rate() -> None:
    dv, dtheta = trajectory().increments(0, 100, 100.0)
    assert dv.sum(axis=0) == pytest.approx([0.0, 0.0, SITE.gravity_mps2], abs=1e-12)
    north, up = EARTH_RATE_RADPS * math.cos(LATITUDE), EARTH_RATE_RADPS * math.sin(LATITUDE)
    assert dtheta.sum(axis=0) == pytest.approx([north, 0.0, up], abs=1e-18)


def test_facing_east_the_left_axis_points_north() -> None:
    _, dtheta = trajectory(azimuth_deg=90.0).increments(0, 100, 100.0)
    assert dtheta.sum(axis=0)[1] == pytest.approx(EARTH_RATE_RADPS * math.cos(LATITUDE), rel=1e-12)


def test_nose_up_the_forward_accelerometer_reads_plus() -> None:
    dv, _ = trajectory(C_tb=body_to_tangent(0.0, math.radians(30.0), 0.0)).increments(0, 100, 100.0)
    assert dv.sum(axis=0) == pytest.approx([SITE.gravity_mps2 / 2, 0.0, SITE.gravity_mps2 * math.sqrt(0.75)])


def test_a_quarter_roll_integrates_gravity_as_its_closed_form_says() -> None:
    # f = g·(0, sin φ, cos φ) for φ = wt from 0 to π/2: both integrals are g/w.
    rate = math.radians(9.0)
    dv, _ = trajectory(Turn(0.0, 10.0, rate, (1.0, 0.0, 0.0))).increments(0, 1000, 100.0)
    assert dv.sum(axis=0) == pytest.approx([0.0, SITE.gravity_mps2 / rate, SITE.gravity_mps2 / rate], rel=1e-13)


def test_a_turn_about_up_adds_its_angle_to_the_earths() -> None:
    dt = trajectory(Turn(2.0, 92.0, math.radians(1.0), (0.0, 0.0, 1.0))).increments(0, 10_000, 100.0)[1].sum(axis=0)
    assert dt[2] == pytest.approx(math.radians(90.0) + EARTH_RATE_RADPS * math.sin(LATITUDE) * 100.0, rel=1e-13)


@pytest.mark.parametrize("frame", ["body", "tangent"])
def test_increments_are_the_integrals_of_rates_evaluated_from_the_attitude(frame: str) -> None:
    start = body_to_tangent(0.3, -0.5, 1.1)
    turn = Turn(0.0, 3.0, 2.0, (1.0, -2.0, 0.5), frame)  # type: ignore[arg-type]
    truth = trajectory(turn, C_tb=start, azimuth_deg=40.0)
    dv, dtheta = truth.increments(0, 30, 10.0)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    axis = np.array(turn.axis) / np.linalg.norm(turn.axis)
    earth = SITE.earth_rate_radps(math.radians(40.0))
    for k in (0, 7, 29):
        C_tb = truth.attitude((k + 0.5 + nodes / 2) / 10.0)
        force = SITE.gravity_mps2 * C_tb[:, 2, :]
        rate = np.einsum("nij,i->nj", C_tb, earth)
        rate += 2.0 * axis if frame == "body" else 2.0 * np.einsum("nij,i->nj", C_tb, axis)
        assert dv[k] == pytest.approx(weights @ force / 20.0, abs=1e-14)
        assert dtheta[k] == pytest.approx(weights @ rate / 20.0, abs=1e-15)


def test_the_angle_increments_compose_to_the_attitude() -> None:
    start = body_to_tangent(0.1, 0.2, 0.3)
    motions = (Turn(1.0, 2.0, 1.5, (0.0, 1.0, 0.0), "tangent"), Turn(2.5, 4.0, -1.0, (1.0, 0.0, 1.0), "body"))
    truth = trajectory(*motions, C_tb=start)
    _, dtheta = truth.increments(0, 5000, 1000.0)
    earth = Rotation.from_rotvec(SITE.earth_rate_radps(0.0) * 5.0)
    inertial = Rotation.from_matrix(start)
    for step in dtheta:
        inertial = inertial * Rotation.from_rotvec(step)
    difference = (earth.inv() * inertial).inv() * Rotation.from_matrix(truth.attitude(np.array([5.0]))[0])
    assert difference.magnitude() < 1e-9


def test_samples_that_straddle_the_ends_of_a_turn_take_their_share() -> None:
    rate = 0.5
    _, dtheta = trajectory(Turn(0.0153, 0.0871, rate, (0.0, 0.0, 1.0))).increments(0, 10, 100.0)
    turned = dtheta[:, 2] - EARTH_RATE_RADPS * math.sin(LATITUDE) * 0.01
    assert turned[1] == pytest.approx(rate * (0.02 - 0.0153), rel=1e-12)
    assert turned[8] == pytest.approx(rate * (0.0871 - 0.08), rel=1e-12)
    assert turned[[0, 9]] == pytest.approx([0.0, 0.0], abs=1e-18)


def test_increments_do_not_depend_on_what_else_is_asked_for() -> None:
    motions = (Turn(1.0, 3.3, 0.4, (1.0, 1.0, 0.0)), Vibration(4.0, 9.0, (1.0, 0.0, 0.0), 5.0, (20.0, 200.0)))
    truth = trajectory(*motions)
    whole = np.hstack(truth.increments(0, 1000, 100.0))
    cuts = [0, 1, 2, 137, 450, 451, 700, 1000]
    parts = [np.hstack(truth.increments(a, b - a, 100.0)) for a, b in pairwise(cuts)]
    assert np.array_equal(whole, np.concatenate(parts))


def test_vibration_has_the_stated_size_and_band_and_ends_at_rest() -> None:
    rate_hz, rms = 2000.0, 7.0
    shake = Vibration(1.0, 41.0, (0.0, 3.0, 0.0), rms, (50.0, 250.0))
    dv, dtheta = trajectory(shake).increments(0, 84_000, rate_hz)
    accel = dv[:, 1] * rate_hz
    assert abs(dv[:, 1].sum()) < 1e-12  # as fast at the end as at the beginning
    assert np.all(accel[:2000] == 0.0)
    assert np.array_equal(dtheta, trajectory().increments(0, 84_000, rate_hz)[1])
    ramp = round(RAMP_SHARE * 40.0 * rate_hz)
    steady = accel[2000 + ramp : 82_000 - ramp]
    # 128 tones of random phase over 36 s: mean squares of neighbours in frequency beat, 3 % covers it.
    assert np.sqrt(np.mean(steady**2)) == pytest.approx(rms, rel=0.03)
    spectrum = np.abs(np.fft.rfft(steady * np.hanning(steady.size))) ** 2
    frequency = np.fft.rfftfreq(steady.size, 1 / rate_hz)
    inside = (frequency > 49.0) & (frequency < 251.0)
    assert spectrum[~inside].sum() < 1e-3 * spectrum.sum()
    lower = spectrum[(frequency > 50.0) & (frequency < 150.0)].sum()
    assert lower == pytest.approx(0.5 * spectrum.sum(), rel=0.1)
    kurtosis = np.mean(steady**4) / np.mean(steady**2) ** 2
    assert kurtosis == pytest.approx(3.0, abs=0.15)


def test_a_new_motion_takes_the_place_of_what_was_planned() -> None:
    planned = Setup(SITE, 0.0, LEVEL, (Turn(10.0, 20.0, 0.1, (0.0, 0.0, 1.0)),))
    changed = Trajectory(planned.with_motion(Turn(12.0, 14.0, 0.3, (1.0, 0.0, 0.0))))
    _, dtheta = changed.increments(0, 300, 10.0)
    assert dtheta.sum(axis=0)[2] == pytest.approx(0.8, abs=0.02)  # 8 of the 10 s are left, the Earth adds 2 mrad
    assert dtheta[125, 0] == pytest.approx(0.03, abs=1e-4)


@pytest.mark.parametrize(
    ("motions", "words"),
    [
        ((Turn(0.0, 5.0, 1.0, (0, 0, 1)), Turn(4.0, 6.0, 1.0, (0, 0, 1))), "before the one ahead ends"),
        ((Turn(5.0, 5.0, 1.0, (0, 0, 1)),), "ends before it starts"),
        ((Turn(0.0, 5.0, 1.0, (0, 0, 0)),), "no direction"),
        ((Vibration(0.0, 5.0, (1, 0, 0), 1.0, (50.0, 20.0)),), "low, high"),
    ],
)
def test_impossible_motions_are_refused(motions: tuple[Motion, ...], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        trajectory(*motions)
