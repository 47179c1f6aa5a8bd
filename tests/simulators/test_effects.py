"""Effects: each against its own formula, and the library's promises for all of them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from inertial.attitude import body_to_tangent
from inertial.documents import CHANNELS, BlockModel, EffectEntry, ParameterValue
from inertial.earth import STANDARD_GRAVITY_MPS2, Site
from simulators.block import SimulatedBlock, Thermal
from simulators.effects import effects, get_effect
from simulators.effects.base import EffectError, LinearEffect, unit_of, values_of
from simulators.effects.catalogue import catalogue
from simulators.motion import Setup, Turn, Vibration
from simulators.scenarios import effect

DEG = math.pi / 180
RATE_HZ = 50.0
SETUP = Setup(Site.at(0.6, 100.0), 0.7, body_to_tangent(0.1, 0.2, 0.3))


def readings(*entries: EffectEntry, count: int = 3000, setup: Setup = SETUP) -> np.ndarray:
    """Return rates (count, 6) of a noiseless ideal block, the frame's own steps included."""
    samples = SimulatedBlock(BlockModel(), setup, rate_hz=RATE_HZ, effects=entries).generate(count)
    return np.hstack([samples["dv"], samples["dtheta"]]) * RATE_HZ


def added(entry: EffectEntry, count: int = 3000) -> np.ndarray:
    """Return what an effect adds to the running integrals (count, 6), in rate units of one sample."""
    return np.cumsum(readings(entry, count=count) - readings(count=count), axis=0)


# The frame counts in steps of 2^-24 m/s and 2^-30 rad: two such sums differ by one step of each at most.
RESOLUTION = np.array([2.0**-24] * 3 + [2.0**-30] * 3) * RATE_HZ * 1.001


def assert_added(entry: EffectEntry, expected: np.ndarray) -> None:
    """The effect adds ``expected`` (n,) [y] to its own channel and nothing to any other."""
    channel = CHANNELS.index(entry.channel)
    difference = added(entry, expected.size)
    difference[:, channel] -= np.cumsum(expected)
    assert np.all(np.abs(difference) <= RESOLUTION)


def test_a_bias_shift_is_added_to_the_reading() -> None:
    shift = 2.4 * DEG / 3600
    assert_added(effect("bias_shift", "gyro_y", shift=(2.4, "deg/h")), np.full(3000, shift))
    assert_added(effect("bias_shift", "accel_x", shift=(0.3, "mg")), np.full(3000, 0.3e-3 * STANDARD_GRAVITY_MPS2))


def test_a_bias_step_begins_at_its_time_within_the_sample() -> None:
    expected = np.zeros(3000)
    expected[1000:] = 1e-3
    expected[1000] *= 0.25  # from 20.015 s on, a quarter of the sample from 20.00 to 20.02 s
    assert_added(effect("bias_step", "accel_z", step=(1e-3, "m/s^2"), time=(20.015, "s")), expected)


def test_a_turn_on_transient_decays_exponentially() -> None:
    entry = effect("turn_on_transient", "gyro_z", amplitude=(1e-5, "rad/s"), time_constant=(12.0, "s"))
    edges = np.arange(3001) / RATE_HZ
    expected = -1e-5 * 12.0 * np.diff(np.exp(-edges / 12.0)) * RATE_HZ
    assert_added(entry, expected)


def test_a_scale_factor_error_follows_the_input() -> None:
    true = readings()[:, 2].mean()
    assert_added(effect("scale_factor", "accel_z", error=(100.0, "ppm")), np.full(3000, 1e-4 * true))


@pytest.mark.parametrize(
    ("name", "unit", "variance"),
    [
        ("random_walk", "m/s^2/sqrt(Hz)", lambda n: n**2 * RATE_HZ),
        ("bias_instability", "m/s^2", None),
        ("rate_random_walk", "m/s^2/sqrt(s)", None),
    ],
)
def test_noise_effects_act_on_their_own_channel_alone(name: str, unit: str, variance: object) -> None:
    entry = effect(name, "accel_x", coefficient=(0.01, unit))
    difference = readings(entry) - readings()
    assert np.std(difference[:, 0]) > 1e-4
    assert np.all(difference[:, 1:] == 0.0)
    assert np.array_equal(difference, readings(entry) - readings())
    if callable(variance):
        # 3000 samples: 5 σ of a variance is 5·√(2/3000).
        assert np.var(difference[:, 0]) == pytest.approx(variance(0.01), rel=5 * math.sqrt(2 / 3000))


def test_a_coarser_step_shows_in_the_increments() -> None:
    step = 2.0**-20  # an exact multiple of the frame's own step
    dtheta = readings(effect("quantisation", "gyro_x", step=(step, "rad/s*s")))[:, 3] / RATE_HZ
    assert np.array_equal(dtheta, np.rint(dtheta / step) * step)
    assert set(np.unique(np.rint(dtheta / step))) <= {2.0, 1.0, 0.0}


def test_a_stuck_sensor_repeats_the_last_value_exactly() -> None:
    noise = effect("random_walk", "accel_y", coefficient=(1e-3, "m/s^2/sqrt(Hz)"))
    stuck = effect("stuck_samples", "accel_y", start=(10.01, "s"), duration=(5.0, "s"))
    free, held = readings(noise), readings(noise, stuck)
    time_s = np.arange(1, 3001) / RATE_HZ
    within = (time_s >= 10.01) & (time_s < 15.01)
    assert within.sum() == 250
    assert np.all(held[within, 1] == free[499, 1])
    assert np.array_equal(held[~within], free[~within])
    assert np.array_equal(np.delete(held, 1, axis=1), np.delete(free, 1, axis=1))


def test_an_azimuth_error_turns_the_earth_rate_and_nothing_else() -> None:
    there = readings(effect("azimuth_error", "all", error=(2.0, "deg")))
    stated = SETUP.azimuth_rad + 2.0 * DEG
    elsewhere = readings(setup=Setup(SETUP.site, stated, SETUP.C_tb))
    assert np.array_equal(there, elsewhere)
    assert np.array_equal(there[:, :3], readings()[:, :3])


def tilt_after_half_turn(rides: float, frame: str) -> np.ndarray:
    """Return the level specific force (2,) [rad of tilt] before and after a half turn about up, tilted by 1 mrad."""
    half = Turn(20.0, 40.0, math.pi / 20, (0.0, 0.0, 1.0), frame)  # type: ignore[arg-type]
    setup = Setup(SETUP.site, 0.0, np.eye(3), (half,))
    entry = effect("level_error", "all", tilt_1=(0.0, "rad"), tilt_2=(1e-3, "rad"), rides=(rides, "1"))
    accel = readings(entry, setup=setup)[:, 0] / setup.site.gravity_mps2
    return np.array([accel[:900].mean(), accel[2100:].mean()])


def test_a_level_error_of_the_room_is_seen_from_the_other_side_after_half_a_turn() -> None:
    # Tilted by +1 mrad about the left axis the nose is down: forward reads minus.
    assert tilt_after_half_turn(0.0, "body") == pytest.approx([-1e-3, 1e-3], rel=1e-3)
    assert tilt_after_half_turn(0.0, "tangent") == pytest.approx([-1e-3, 1e-3], rel=1e-3)


def test_a_level_error_that_rides_with_the_block_stays() -> None:
    assert tilt_after_half_turn(1.0, "body") == pytest.approx([-1e-3, -1e-3], rel=1e-3)
    assert tilt_after_half_turn(1.0, "tangent") == pytest.approx([-1e-3, -1e-3], rel=1e-3)


EXAMPLE = Setup(
    SETUP.site,
    SETUP.azimuth_rad,
    SETUP.C_tb,
    (Turn(0.5, 1.5, 2.0, (1.0, 1.0, 1.0), "body"), Vibration(2.0, 3.0, (0.0, 1.0, 0.0), 5.0, (5.0, 20.0))),
)
HAPPENS_AT_ONCE = {"time": 0.01, "start": 0.01, "limit": 0.5, "reference": 20.0, "nominal": 24.0}
HAPPENS_AT_ONCE |= {"fraction": 0.2, "frequency": 3.0}


@pytest.mark.parametrize("name", sorted(effects()))
def test_every_effect_describes_itself_and_can_be_simulated(name: str) -> None:
    found = get_effect(name)
    assert found.name == name
    assert all(text.strip() for text in (found.text, found.term, found.shown_by, found.source))
    for channel in (found.channel_names()[0], found.channel_names()[-1]):
        values = {}
        for parameter in found.parameters:
            typical = parameter.typical.get("any") or parameter.typical[channel.partition("_")[0]]
            assert typical.low < typical.high
            value = HAPPENS_AT_ONCE.get(parameter.name, typical.high)
            values[parameter.name] = ParameterValue(value=value, unit=unit_of(parameter, channel))
        entry = EffectEntry(effect=name, channel=channel, parameters=values)
        assert set(values_of(found, entry)) == set(values)
        with_it, without = (
            SimulatedBlock(
                BlockModel(), EXAMPLE, rate_hz=RATE_HZ, effects=entries, thermal=Thermal(20.0, 40.0, 2.0)
            ).generate(200)
            for entries in ([entry], [])
        )
        fields = ["sequence", "time", "dv", "dtheta"]
        assert len(with_it) != len(without) or not all(np.array_equal(with_it[f], without[f]) for f in fields)
    if isinstance(found, LinearEffect):
        assert 1 <= found.amplitudes <= len(found.parameters)


def test_the_page_of_effects_is_current() -> None:
    page = Path(__file__).parents[2] / "docs" / "effects.md"
    assert page.read_text() == catalogue(), "run: python -m simulators.effects.catalogue > docs/effects.md"


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        (effect("no_such", "gyro_x"), "no effect is named 'no_such'"),
        (effect("bias_shift", "gyro_w", shift=(1.0, "rad/s")), "channel 'gyro_w' is no sensor channel of it"),
        (effect("bias_shift", "all", shift=(1.0, "rad/s")), "channel 'all' is no sensor channel of it"),
        (effect("bias_shift", "gyro_x"), "'shift' is missing"),
        (effect("bias_shift", "gyro_x", shift=(1.0, "rad/s"), drift=(1.0, "rad/s")), "no parameter 'drift'"),
        (effect("bias_shift", "gyro_x", shift=(1.0, "mg")), r"in 'mg'; give rad/s \(or deg/s, deg/h\)"),
        (effect("bias_shift", "accel_x", shift=(1.0, "deg/h")), r"give m/s\^2 \(or mg, ug\)"),
        (effect("random_walk", "accel_x", coefficient=(1.0, "")), r"give m/s\^2/sqrt\(Hz\)"),
    ],
)
def test_a_wrong_entry_is_refused_by_name(entry: EffectEntry, words: str) -> None:
    with pytest.raises(EffectError, match=words):
        SimulatedBlock(BlockModel(), SETUP, rate_hz=RATE_HZ, effects=[entry])
