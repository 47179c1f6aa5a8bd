"""What an effect is: one way in which a block, its readout or its set-up departs from the belief.

One definition serves three uses: the simulator applies it, the discrepancy workflow fits it, the docs print it. A new
effect is one new file in this folder with an ``EFFECT`` in it, or an entry point of the group ``inertrim.effects``.

A sample passes through the stages in order::

    SETUP    the truth itself: site, azimuth, attitude, motions (`Effect.arrange`)
    SENSOR   added to what the sensor senses, as a function of truth and circumstances
    NOISE    random, added
    READOUT  what electronics do to the sum: dead band, saturation, coarse steps
    FRAME    what happens to a finished frame: values repeated, rows gone, time stamps wrong

Units: a parameter's unit may hold ``y``, which stands for m/s^2 on an accelerometer and rad/s on a gyro.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from inertial.documents import CHANNELS, EffectEntry, ParameterValue
from simulators.errors import ScenarioError
from simulators.motion import Setup

Array = NDArray[np.float64]


class EffectError(ScenarioError):
    """An effect is unknown, or its channel or a parameter does not fit it; the text says which and what would."""


class Stage(IntEnum):
    """Where along the signal's way an effect acts."""

    SETUP = 0
    SENSOR = 1
    NOISE = 2
    READOUT = 3
    FRAME = 4


class ChannelKind(StrEnum):
    """What an effect's channel names: one sensor, ``gyro_x<-accel_y``, ``accel`` or ``gyro``, ``all``, or a group:
    either triad or ``all``.
    """

    SENSOR = "sensor"
    PAIR = "pair"
    TRIAD = "triad"
    GROUP = "group"
    BLOCK = "block"


@dataclass(frozen=True)
class Range:
    """Magnitudes that are typical [SI]: the prior of a fit and the draw of a test."""

    low: float
    high: float


@dataclass(frozen=True)
class Parameter:
    """One number of an effect. ``typical`` by kind of channel: ``accel``, ``gyro``, or ``any`` for both."""

    name: str
    unit: str
    text: str
    typical: Mapping[str, Range]


@dataclass(frozen=True)
class Circumstances:
    """What happened to the block over n samples, none of it the sensors' doing. Time is the device's, at interval ends.

    ``accel_mps2``, ``gyro_radps`` (n, 3) are the true specific force and inertial rate, mean over each interval;
    ``temperature_c`` (n, sensors), of which effects use the first, ``supply_v`` (n,). ``vibration_mps2_squared`` (n,)
    is the mean square of the vibration that is said to go on, rms² from its start to its end and 0 elsewhere.
    """

    time_s: Array
    interval_s: float
    accel_mps2: Array
    gyro_radps: Array
    temperature_c: Array
    supply_v: Array
    vibration_mps2_squared: Array

    def true(self, channel: str) -> Array:
        """Return the true input (n,) [y] of one sensor."""
        values = self.accel_mps2 if channel.startswith("accel") else self.gyro_radps
        return np.asarray(values[:, "xyz".index(channel[-1])])


@dataclass(frozen=True)
class Readings:
    """What the sensors make of it, changed in place: velocity [m/s] and angle [rad] increments (n, 3).

    ``time_s`` (n,) are the time stamps that the frames will bear; frames marked in ``lost`` (n,) never come.
    """

    dv: Array
    dtheta: Array
    time_s: Array
    lost: NDArray[np.bool_]

    def of(self, channel: str) -> Array:
        """Return the increments (n,) [y·s] of one sensor, as a view."""
        values = self.dv if channel.startswith("accel") else self.dtheta
        return np.asarray(values[:, "xyz".index(channel[-1])])


Step = Callable[[Circumstances, Readings], None]
"""Applies an effect to the next samples; called once for each run of samples, in order."""


@dataclass(frozen=True)
class Occasion:
    """What an effect is set up with: its channel, its parameters [SI] and its own random numbers."""

    channel: str
    values: Mapping[str, float]
    interval_s: float
    rng: np.random.Generator = field(default_factory=np.random.default_rng)


class Effect(ABC):
    """Definition of an effect; stateless, so one object stands for all its uses."""

    name: ClassVar[str]
    text: ClassVar[str]
    """What it is, in plain words, one sentence."""
    term: ClassVar[str]
    """The standard's term and where it stands."""
    stage: ClassVar[Stage]
    channels: ClassVar[ChannelKind]
    parameters: ClassVar[tuple[Parameter, ...]]
    acts_on: ClassVar[tuple[str, ...]] = ("accel", "gyro")
    """Triads whose sensors can have it."""
    shown_by: ClassVar[str]
    """The recording that shows it best."""
    source: ClassVar[str]
    """Where the typical magnitudes come from."""

    def channel_names(self) -> tuple[str, ...]:
        """Return every channel that this effect can be on."""
        sensors = tuple(name for name in CHANNELS if name.partition("_")[0] in self.acts_on)
        match self.channels:
            case ChannelKind.SENSOR:
                return sensors
            case ChannelKind.PAIR:
                return tuple(f"{on}<-{by}" for on in sensors for by in self.sources(on))
            case ChannelKind.TRIAD:
                return self.acts_on
            case ChannelKind.GROUP:
                return (*self.acts_on, "all")
            case ChannelKind.BLOCK:
                return ("all",)

    def sources(self, sensor: str) -> tuple[str, ...]:
        """Return what can act on a sensor, for an effect of pairs: the other two of its triad."""
        return tuple(name for name in CHANNELS if name[:-1] == sensor[:-1] and name != sensor)

    def arrange(self, setup: Setup, occasion: Occasion) -> Setup:  # noqa: ARG002
        """Return the true set-up when ``setup`` is what is believed; only a :class:`SetupEffect` changes it."""
        return setup

    @abstractmethod
    def begin(self, occasion: Occasion) -> Step:
        """Return what applies this effect to a stream of samples."""


class SetupEffect(Effect):
    """Effect on how the block stands and moves, and on nothing that comes after."""

    stage = Stage.SETUP

    @abstractmethod
    def arrange(self, setup: Setup, occasion: Occasion) -> Setup:
        """Return the true set-up when ``setup`` is what is believed."""

    def begin(self, occasion: Occasion) -> Step:  # noqa: ARG002
        """Leave the samples as they are: all is done by :meth:`arrange`."""
        return lambda _seen, _readings: None


class LinearEffect(Effect):
    """Effect that adds Σ amplitude × regressor: the first parameters are the amplitudes, the others its shape."""

    stage = Stage.SENSOR
    amplitudes: ClassVar[int] = 1

    @abstractmethod
    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:
        """Return, for each amplitude, what one unit of it adds to the reading: (n, amplitudes) [y per unit]."""

    def begin(self, occasion: Occasion) -> Step:
        """Add the regressors, weighted, to the channel."""
        names = [parameter.name for parameter in self.parameters]
        weights = np.array([occasion.values[name] for name in names[: self.amplitudes]])
        shape = {name: occasion.values[name] for name in names[self.amplitudes :]}

        def step(seen: Circumstances, readings: Readings) -> None:
            # A plain sum of columns: unlike a matrix product it rounds the same for one row and for many.
            columns = self.regressors(seen, occasion.channel, shape)
            added = (columns * weights).sum(axis=1) * seen.interval_s
            readings.of(target(occasion.channel))[:] += added

        return step


class SampleEffect(Effect):
    """Effect on the readings of one sensor, each sample by itself: dead band, saturation and their like."""

    stage = Stage.READOUT
    channels = ChannelKind.SENSOR

    @abstractmethod
    def changed(self, reading: Array, values: Mapping[str, float]) -> Array:
        """Return what becomes of readings (n,) [y]."""

    @abstractmethod
    def mean_change(self, reading: Array, sigma: float, values: Mapping[str, float]) -> Array:
        """Return by how much readings (n,) [y] change in the mean when normal noise of 1σ [y] rides on them (n,)."""

    def begin(self, occasion: Occasion) -> Step:
        """Change the channel's readings."""

        def step(seen: Circumstances, readings: Readings) -> None:
            column = readings.of(occasion.channel)
            column[:] = self.changed(column / seen.interval_s, occasion.values) * seen.interval_s

        return step


def target(channel: str) -> str:
    """Return the sensor that a channel ``a`` or a pair ``a<-b`` acts on."""
    return channel.partition("<-")[0]


_UNITS: dict[str, tuple[str, float]] = {
    "mg": ("m/s^2", 9.80665e-3),
    "ug": ("m/s^2", 9.80665e-6),
    "deg/s": ("rad/s", math.radians(1.0)),
    "deg/h": ("rad/s", math.radians(1.0) / 3600.0),
    "deg": ("rad", math.radians(1.0)),
    "degC": ("degC", 1.0),
    "mg/K": ("m/s^2/K", 9.80665e-3),
    "ug/K": ("m/s^2/K", 9.80665e-6),
    "deg/h/K": ("rad/s/K", math.radians(1.0) / 3600.0),
    "ppm/K": ("1/K", 1e-6),
    "deg/h/g": ("rad/s/(m/s^2)", math.radians(1.0) / 3600.0 / 9.80665),
    "deg/h/g^2": ("rad/s/(m/s^2)^2", math.radians(1.0) / 3600.0 / 9.80665**2),
    "ug/g^2": ("m/s^2/(m/s^2)^2", 1e-6 / 9.80665),
    "ms": ("s", 1e-3),
    "ppm": ("1", 1e-6),
    "min": ("s", 60.0),
    "ug/sqrt(Hz)": ("m/s^2/sqrt(Hz)", 9.80665e-6),
    "deg/sqrt(h)": ("rad/s/sqrt(Hz)", math.radians(1.0) / 60.0),
}


def unit_of(parameter: Parameter, channel: str) -> str:
    """Return the SI unit of a parameter on a channel, for example ``m/s^2/sqrt(Hz)``."""
    return parameter.unit.replace("y", "m/s^2" if channel.startswith("accel") else "rad/s", 1)


def values_of(effect: Effect, entry: EffectEntry) -> dict[str, float]:
    """Return the parameters of an entry by name in SI, checked against the effect's definition.

    Raises
    ------
    EffectError
        A channel of another kind, a parameter that is missing or unknown, a unit that does not convert.
    """
    if entry.channel not in effect.channel_names():
        known = ", ".join(effect.channel_names())
        raise EffectError(
            f"{entry.effect}: channel {entry.channel!r} is no {effect.channels.value} channel of it; it acts on {known}"
        )
    wanted = {parameter.name: parameter for parameter in effect.parameters}
    for name in entry.parameters:
        if name not in wanted:
            raise EffectError(f"{entry.effect}: no parameter {name!r}; it has {', '.join(wanted) or 'none'}")
    for name in wanted:
        if name not in entry.parameters:
            raise EffectError(f"{entry.effect} on {entry.channel}: parameter {name!r} is missing")
    return {
        name: _in_si(entry, name, entry.parameters[name], unit_of(parameter, entry.channel))
        for name, parameter in wanted.items()
    }


def _in_si(entry: EffectEntry, name: str, given: ParameterValue, unit: str) -> float:
    base, factor = _UNITS.get(given.unit, (given.unit, 1.0))
    if base != unit:
        others = ", ".join(u for u, (b, _) in _UNITS.items() if b == unit)
        raise EffectError(
            f"{entry.effect} on {entry.channel}: {name} is in {given.unit!r}; give {unit}"
            + (f" (or {others})" if others else "")
        )
    return given.value * factor
