"""A simulated block: truth → inverse error model → effects → noise → readout → samples.

The calibration of its model says how its readings stood to the truth in the laboratory: readings are the exact
inverse of (1), (2). What has happened to it since are effects, of the model and of the occasion, by their stages.
An effect's ``bias_shift`` is added to the reading, so that the compensating term of (8), (9) is minus the shift.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.protocols.native import DTHETA_LSB_RAD, DV_LSB_MPS
from drivers.samples import SampleArray, Status, empty_samples
from inertial.documents import BlockModel, ChannelNoise, EffectEntry, Noise
from inertial.error_model import Coefficients, readings_from_true
from simulators.effects import get_effect
from simulators.effects.base import Circumstances, Occasion, Readings, Stage, Step, values_of
from simulators.motion import Setup, Trajectory, Turn, vibration_mean_square
from simulators.noise import Flicker, Quantiser, RateRandomWalk, White, generator

Array = NDArray[np.float64]

START_UP_S = 0.7
"""How long after power-up frames carry ``Status.START_UP``."""
_THERMOMETERS = np.array([1.0, 0.96, 1.05])  # each sensor's share of the rise: gyros, accelerometers, electronics
_THERMOMETER_NOISE_C = 0.01
_SUPPLY_V = 28.0
_SUPPLY_NOISE_V = 0.005
_AT_ONCE = 8192  # samples made in one go: their arrays stay in the processor's cache
_SENT = Stage.READOUT + 0.5  # when a reading is rounded to the steps of its frame


@dataclass(frozen=True)
class Thermal:
    """Temperature from ``start_c`` at power-up to ``end_c``, exponentially; ``heated`` holds what came upon it.

    Each heating is (time since power-up [s], change [°C], time constant [s]).
    """

    start_c: float = 25.0
    end_c: float = 25.0
    time_constant_s: float = 60.0
    heated: tuple[tuple[float, float, float], ...] = ()

    def at(self, time_s: Array) -> Array:
        """Return the temperature [°C] at times since power-up [s]."""
        temperature_c = self.end_c + (self.start_c - self.end_c) * np.exp(-time_s / self.time_constant_s)
        for at_s, change_c, time_constant_s in self.heated:
            temperature_c -= change_c * np.expm1(-np.maximum(time_s - at_s, 0.0) / time_constant_s)
        return temperature_c


class SimulatedBlock:
    """One block from power-up on, giving the same samples however many are asked for at once.

    Sample k (from 0) covers the time k/rate to (k + 1)/rate since power-up and is stamped with its end.

    Parameters
    ----------
    model : what the block is.
    setup : how it is believed to stand and move; effects of the stage SETUP make the truth differ. Its times are
        those of the first power-up.
    rate_hz : samples a second.
    seed : draws the noise. ``power_cycle`` counts power-ups, each with noise of its own.
    effects : what has happened to it, besides the model's own effects.
    epoch_s : time of this power-up on the clock of ``setup``.

    Raises
    ------
    EffectError
        An effect that is unknown or whose channel or parameters do not fit.
    ValueError
        A calibration that has no inverse.
    """

    def __init__(
        self,
        model: BlockModel,
        setup: Setup,
        *,
        rate_hz: float,
        seed: int = 0,
        effects: Sequence[EffectEntry] = (),
        thermal: Thermal | None = None,
        power_cycle: int = 0,
        epoch_s: float = 0.0,
    ) -> None:
        self.rate_hz = rate_hz
        self._coefficients = Coefficients.from_document(model.calibration)
        self._seed, self._cycle, self._epoch_s = seed, power_cycle, epoch_s
        self._thermal = thermal or Thermal()
        self._next = 0
        self._entries: list[EffectEntry] = []
        self._steps = _own_noise(model.noise, 1.0 / rate_hz, seed, power_cycle)
        self._circumstances_rng = generator(seed, power_cycle, zlib.crc32(b"circumstances"))
        self._setup = setup
        for entry in (*model.effects, *effects):
            self.add_effect(entry)
        self._trajectory = Trajectory(self.true_setup, seed)
        readings_from_true(np.zeros((1, 3)), np.zeros((1, 3)), self._coefficients)  # refuse one without inverse now

    @property
    def time_s(self) -> float:
        """Time since power-up [s] at the end of the last sample given."""
        return self._next / self.rate_hz

    @property
    def temperature_c(self) -> float:
        """Temperature now [°C], without the thermometers' noise."""
        return float(self._thermal.at(np.array(self.time_s)))

    @property
    def setup(self) -> Setup:
        """How the block is believed to stand and move, unforeseen moves included."""
        return self._setup

    @property
    def true_setup(self) -> Setup:
        """How it really does."""
        setup = self._setup
        for entry in self._entries:
            setup = get_effect(entry.effect).arrange(setup, self._occasion(entry))
        return setup

    @property
    def trajectory(self) -> Trajectory:
        """The truth, on the clock of the first power-up."""
        return self._trajectory

    def add_effect(self, entry: EffectEntry) -> None:
        """Let something happen to the block from the next sample on."""
        effect = get_effect(entry.effect)
        occasion = self._occasion(entry)
        self._entries.append(entry)
        self._steps.append((float(effect.stage), effect.begin(occasion)))
        self._steps.sort(key=_stage)

    def move(self, rate_radps: float, axis: tuple[float, float, float], duration_s: float) -> None:
        """Turn the block from the next sample on, about a body axis, whatever was planned for that time."""
        start_s = self._epoch_s + self.time_s
        self._setup = self._setup.with_motion(Turn(start_s, start_s + duration_s, rate_radps, axis))
        self._trajectory = Trajectory(self.true_setup, self._seed)

    def heat(self, change_c: float, time_constant_s: float) -> None:
        """Warm or cool the block from the next sample on, until it is switched off."""
        heated = (*self._thermal.heated, (self.time_s, change_c, time_constant_s))
        self._thermal = replace(self._thermal, heated=heated)

    def generate(self, count: int) -> SampleArray:
        """Return the next ``count`` samples, with three temperatures, less those that an effect loses."""
        samples = empty_samples(count, _THERMOMETERS.size)
        lost = np.zeros(count, dtype=np.bool_)
        for start in range(0, count, _AT_ONCE):
            self._fill(samples[start : start + _AT_ONCE], lost[start : start + _AT_ONCE])
        return samples[~lost] if lost.any() else samples

    def _fill(self, samples: SampleArray, lost: NDArray[np.bool_]) -> None:
        count = len(samples)
        seen = self._circumstances(count)
        accel, gyro = readings_from_true(seen.accel_mps2, seen.gyro_radps, self._coefficients)
        accel *= seen.interval_s
        gyro *= seen.interval_s
        readings = Readings(accel, gyro, seen.time_s.copy(), lost)
        for _, step in self._steps:
            step(seen, readings)
        samples["sequence"] = (self._next + np.arange(count)).astype(np.uint32)
        samples["time"] = np.rint(readings.time_s * 1e6) / 1e6
        samples["dv"], samples["dtheta"] = readings.dv, readings.dtheta
        samples["temperature"] = seen.temperature_c
        samples["supply"] = seen.supply_v
        samples["status"] = np.where(seen.time_s < START_UP_S, int(Status.START_UP), 0)
        self._next += count

    def _circumstances(self, count: int) -> Circumstances:
        interval_s = 1.0 / self.rate_hz
        dv, dtheta = self._trajectory.increments(self._next, count, self.rate_hz, self._epoch_s)
        time_s = np.arange(self._next + 1, self._next + count + 1) / self.rate_hz
        normal = self._circumstances_rng.standard_normal((count, _THERMOMETERS.size + 1))
        rise_c = self._thermal.at(time_s) - self._thermal.start_c
        temperature_c = self._thermal.start_c + rise_c[:, None] * _THERMOMETERS + _THERMOMETER_NOISE_C * normal[:, 1:]
        supply_v = _SUPPLY_V + _SUPPLY_NOISE_V * normal[:, 0]
        shaken = vibration_mean_square(self._setup, time_s + self._epoch_s - 0.5 * interval_s)
        return Circumstances(time_s, interval_s, dv / interval_s, dtheta / interval_s, temperature_c, supply_v, shaken)

    def _occasion(self, entry: EffectEntry) -> Occasion:
        values = values_of(get_effect(entry.effect), entry)
        key = zlib.crc32(f"{len(self._entries)} {entry.effect} {entry.channel}".encode())
        return Occasion(entry.channel, values, 1.0 / self.rate_hz, generator(self._seed, self._cycle, key))


def _stage(step: tuple[float, Step]) -> float:
    return step[0]


def _own_noise(noise: Noise, interval_s: float, seed: int, cycle: int) -> list[tuple[float, Step]]:
    """Return the steps of the model's noise and of the readout, three channels at a time."""
    steps: list[tuple[float, Step]] = []
    for triad in ("accel", "gyro"):
        channels: list[ChannelNoise] = [getattr(noise, f"{triad}_{axis}") for axis in "xyz"]
        for name, kind in (("white", White), ("flicker", Flicker), ("random_walk", RateRandomWalk)):
            coefficients = [getattr(channel, name) for channel in channels]
            if any(coefficients):
                rng = generator(seed, cycle, zlib.crc32(f"{triad} {name}".encode()))
                steps.append((float(Stage.NOISE), _add(kind(coefficients, interval_s, rng), triad)))
        steps.append((float(Stage.READOUT), _round([channel.quantisation for channel in channels], triad)))
    steps += [(_SENT, _round([DV_LSB_MPS] * 3, "accel")), (_SENT, _round([DTHETA_LSB_RAD] * 3, "gyro"))]
    return steps


def _add(process: White | Flicker | RateRandomWalk, triad: str) -> Step:
    def step(seen: Circumstances, readings: Readings) -> None:
        rows = readings.dv if triad == "accel" else readings.dtheta
        rows += process.increments(seen.time_s.size)

    return step


def _round(sizes: list[float], triad: str) -> Step:
    quantiser = Quantiser(sizes)

    def step(seen: Circumstances, readings: Readings) -> None:  # noqa: ARG001
        quantiser.quantise(readings.dv if triad == "accel" else readings.dtheta)

    return step
