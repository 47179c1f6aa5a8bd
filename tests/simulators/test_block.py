"""The simulated block against its own error model, its noise model and the laws of chunks and seeds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from drivers.protocols import get_protocol
from drivers.protocols.native import DTHETA_LSB_RAD, DV_LSB_MPS, decode_samples
from drivers.samples import Status
from inertial.attitude import body_to_tangent
from inertial.documents import AccelCoefficients, BlockModel, ChannelCoefficients, ChannelNoise, Noise
from inertial.earth import Site
from inertial.error_model import Coefficients, Terms, true_from_readings
from simulators.block import START_UP_S, SimulatedBlock, Thermal
from simulators.motion import Setup, Turn, Vibration
from simulators.scenarios import demo_model, effect

SITE = Site.at(math.radians(35.7), 1200.0)
# No sensor near zero, where the frame's steps would hop between the signs' coefficients.
TILTED = Setup(SITE, math.radians(40.0), body_to_tangent(0.2, -0.3, 0.4))
MOVED = Setup(
    SITE,
    0.7,
    np.eye(3),
    (Turn(3.0, 8.0, 0.3, (1.0, 1.0, 0.0)), Vibration(9.0, 12.0, (0.0, 0.0, 1.0), 5.0, (20.0, 45.0))),
)
QUIET = demo_model(3).model_copy(update={"noise": Noise()})
EVERYTHING = (
    effect("level_error", "all", tilt_1=(0.01, "deg"), tilt_2=(-0.02, "deg"), rides=(0.0, "1")),
    effect("bias_shift", "gyro_y", shift=(2.4, "deg/h")),
    effect("turn_on_transient", "accel_z", amplitude=(1.0, "mg"), time_constant=(5.0, "s")),
    effect("random_walk", "gyro_x", coefficient=(0.02, "deg/sqrt(h)")),
    effect("bias_instability", "accel_x", coefficient=(5.0, "ug")),
    effect("rate_random_walk", "gyro_z", coefficient=(1e-7, "rad/s/sqrt(s)")),
    effect("quantisation", "accel_y", step=(1e-5, "m/s^2*s")),
    effect("stuck_samples", "gyro_x", start=(6.0, "s"), duration=(2.0, "s")),
)


def block(model: BlockModel = QUIET, setup: Setup = TILTED, **options: object) -> SimulatedBlock:
    return SimulatedBlock(model, setup, rate_hz=100.0, **options)  # type: ignore[arg-type]


def test_the_error_model_undoes_what_the_block_does() -> None:
    simulated = block()
    samples = simulated.generate(2000)
    accel, gyro = true_from_readings(
        samples["dv"] * 100.0, samples["dtheta"] * 100.0, Coefficients.from_document(QUIET.calibration)
    )
    dv, dtheta = simulated.trajectory.increments(0, 2000, 100.0)
    # The readout keeps each integral within half a step; scale factors and couplings add a per mille to that.
    assert np.abs(np.cumsum(accel / 100.0 - dv, axis=0)).max() < 0.502 * DV_LSB_MPS
    assert np.abs(np.cumsum(gyro / 100.0 - dtheta, axis=0)).max() < 0.502 * DTHETA_LSB_RAD + 1e-12


def test_the_terms_that_undo_a_shift_are_minus_the_shift() -> None:
    shift = 1e-3
    samples = block(effects=[effect("bias_shift", "accel_y", shift=(shift, "m/s^2"))]).generate(2000)
    terms = Terms(np.array([0.0, -shift, 0.0]), np.zeros(3))
    coefficients = Coefficients.from_document(QUIET.calibration)
    accel, _ = true_from_readings(samples["dv"] * 100.0, samples["dtheta"] * 100.0, coefficients, terms)
    force = TILTED.C_tb.T @ [0.0, 0.0, SITE.gravity_mps2]
    # Coefficients differ from one by a few 1e-4, and that share of the shift is left.
    assert accel.mean(axis=0) == pytest.approx(force, abs=1e-3 * shift)


@pytest.mark.parametrize("chunks", [[1500], [1] * 20 + [1480], [499, 1, 700, 300], [37] * 40 + [20]])
def test_samples_do_not_depend_on_the_chunks_they_are_made_in(chunks: list[int]) -> None:
    options = {"seed": 9, "effects": EVERYTHING, "thermal": Thermal(10.0, 40.0, 20.0)}
    whole = block(demo_model(3), MOVED, **options).generate(1500)
    simulated = block(demo_model(3), MOVED, **options)
    assert np.array_equal(whole, np.concatenate([simulated.generate(count) for count in chunks]))


def test_seed_and_power_cycle_change_the_noise_and_nothing_but_the_noise() -> None:
    one, two, again, later = (
        block(demo_model(3), seed=seed, power_cycle=cycle).generate(6000)
        for seed, cycle in ((1, 0), (2, 0), (1, 0), (1, 1))
    )
    assert np.array_equal(one, again)
    noise = demo_model(3).noise
    for channel, field in ((noise.accel_x, "dv"), (noise.gyro_x, "dtheta")):
        for other in (two, later):
            difference = (one[field] - other[field]) * 100.0
            # Flicker of B adds at most 7 B² to the variance of a difference: nothing beside this white noise.
            assert np.std(difference) == pytest.approx(channel.white * math.sqrt(2 * 100.0), rel=0.05)
            assert abs(difference.mean()) < 6 * channel.white * math.sqrt(2 / 3 / 60.0) + 10 * channel.flicker


def test_the_model_s_noise_reaches_the_readings_by_channel() -> None:
    model = BlockModel(noise=Noise(gyro_y=ChannelNoise(white=1e-4), accel_x=ChannelNoise(white=1e-2)))
    samples = block(model).generate(20_000)
    tolerance = 6 * math.sqrt(2 / 20_000)
    assert np.var(samples["dv"][:, 0]) == pytest.approx(1e-4 * 0.01, rel=tolerance)
    assert np.var(samples["dtheta"][:, 1]) == pytest.approx(1e-8 * 0.01, rel=tolerance)
    assert np.ptp(samples["dv"][:, 1]) <= DV_LSB_MPS * 1.5
    assert np.ptp(samples["dtheta"][:, [0, 2]], axis=0).max() <= DTHETA_LSB_RAD * 1.5


def test_the_model_s_own_quantisation_is_coarser_than_the_frame_s() -> None:
    step = 2.0**-20
    samples = block(BlockModel(noise=Noise(accel_x=ChannelNoise(quantisation=step)))).generate(500)
    assert np.array_equal(samples["dv"][:, 0] % step, np.zeros(500))
    assert np.any(samples["dv"][:, 1] % step != 0.0)


def test_samples_survive_their_frame_unchanged() -> None:
    samples = block(demo_model(3), MOVED, effects=EVERYTHING).generate(300)
    decoded = decode_samples(get_protocol("native").encode_samples(samples))
    for name in ("sequence", "time", "dv", "dtheta", "status"):
        assert np.array_equal(decoded[name], samples[name])
    assert np.abs(decoded["temperature"] - samples["temperature"]).max() <= 2**-9 + 1e-6
    assert np.abs(decoded["supply"] - samples["supply"]).max() <= 0.6e-3


def test_time_sequence_and_start_up_status_begin_at_power_up() -> None:
    samples = block().generate(200)
    assert np.array_equal(samples["sequence"], np.arange(200))
    assert samples["time"][[0, 99]] == pytest.approx([0.01, 1.0], abs=1e-12)
    starting = (samples["status"] & Status.START_UP) != 0
    assert np.array_equal(starting, samples["time"] < START_UP_S)


def test_temperatures_rise_exponentially_each_sensor_to_its_own_share() -> None:
    samples = block(thermal=Thermal(20.0, 50.0, 10.0)).generate(6000)
    at_20_s = samples["temperature"][1999]
    rise = 30.0 * (1 - math.exp(-2.0))
    assert at_20_s[0] == pytest.approx(20.0 + rise, abs=0.06)  # six σ of the thermometer
    assert at_20_s[1] < at_20_s[0] < at_20_s[2]
    assert samples["temperature"][0] == pytest.approx(20.0, abs=0.1)


def test_heat_from_outside_adds_to_the_rise_from_its_moment_on() -> None:
    heated, plain = block(thermal=Thermal(20.0, 50.0, 10.0)), block(thermal=Thermal(20.0, 50.0, 10.0))
    heated.generate(1000)
    heated.heat(-8.0, 5.0)
    after = heated.generate(1000)
    difference = after["temperature"] - plain.generate(2000)["temperature"][1000:]
    assert np.abs(difference[0]).max() < 0.02  # its first hundredth of a second; the thermometers' noise is the same
    assert difference[-1, 0] == pytest.approx(-8.0 * (1 - math.exp(-2.0)), abs=1e-4)


def test_a_move_takes_effect_with_the_next_sample_and_then_rests_elsewhere() -> None:
    simulated = block(BlockModel(), Setup(SITE, 0.0, np.eye(3)))
    simulated.generate(100)
    simulated.move(math.radians(10.0), (1.0, 0.0, 0.0), 2.0)
    moving, after = simulated.generate(200), simulated.generate(100)
    earth = 2.0 * SITE.earth_rate_radps(0.0)[0]
    assert moving["dtheta"][:, 0].sum() == pytest.approx(math.radians(20.0) + earth, abs=1e-8)
    assert np.all(moving["dtheta"][:, 0] > 1e-3)
    expected = SITE.gravity_mps2 * np.array([0.0, math.sin(math.radians(20)), math.cos(math.radians(20))])
    assert after["dv"].sum(axis=0) == pytest.approx(expected, abs=1e-6)


def test_a_calibration_without_inverse_is_refused_at_once() -> None:
    broken = BlockModel(calibration=ChannelCoefficients(accel_x=AccelCoefficients(scale_positive=0.0)))
    with pytest.raises(ValueError, match="cannot be inverted"):
        block(broken)
