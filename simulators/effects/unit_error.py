"""Unit error: readings are in another unit than stated."""

from __future__ import annotations

from inertial.documents import CHANNELS
from simulators.effects.base import (
    ChannelKind,
    Circumstances,
    Effect,
    Occasion,
    Parameter,
    Range,
    Readings,
    Stage,
    Step,
    target,
)


class UnitError(Effect):
    """Reading × factor, of one sensor or of a whole triad.

    Factors that happen are :data:`FACTORS`, the sample rate in hertz (rates for increments), and their inverses.
    """

    name = "unit_error"
    text = "The readings are in another unit than stated."
    term = "scaling (engineering-unit) error"
    stage = Stage.FRAME
    channels = ChannelKind.SENSOR
    parameters = (Parameter("factor", "1", "what the reading is multiplied by", {"any": Range(1e-6, 1e6)}),)
    shown_by = "gravity along the sensor, or a turn about it"
    source = "commissioning reports"

    def channel_names(self) -> tuple[str, ...]:
        """Return the sensors and the triads."""
        return (*CHANNELS, "accel", "gyro")

    def begin(self, occasion: Occasion) -> Step:
        """Scale the columns."""
        names = [name for name in CHANNELS if name.startswith(target(occasion.channel))]

        def step(seen: Circumstances, readings: Readings) -> None:  # noqa: ARG001
            for name in names:
                readings.of(name)[:] *= occasion.values["factor"]

        return step


_ANY = {"milli": 1e3, "half or double": 2.0, "ten": 10.0}

FACTORS = {
    "accel": {"g for m/s^2": 1.0 / 9.80665, "mg for m/s^2": 1e3 / 9.80665, "feet for metres": 1.0 / 0.3048, **_ANY},
    "gyro": {
        "degrees for radians": 57.29577951308232,
        "deg/h for rad/s": 206264.80624709636,
        "grads for radians": 63.66197723675813,
        **_ANY,
    },
}
"""Ratios of units that are mistaken for each other, by triad."""

EFFECT = UnitError()
