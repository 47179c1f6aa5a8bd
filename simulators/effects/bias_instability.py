"""Bias instability: flicker of the reading, on top of the model's own."""

from __future__ import annotations

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
)
from simulators.noise import Flicker


class BiasInstability(Effect):
    """Flicker of coefficient B: Allan floor 0.664·B. Adds to the model's in power."""

    name = "bias_instability"
    text = "The sensor's bias wanders on every time scale more than believed."
    term = "bias instability (IEEE 952)"
    stage = Stage.NOISE
    channels = ChannelKind.SENSOR
    parameters = (Parameter("coefficient", "y", "B", {"accel": Range(1e-6, 1e-3), "gyro": Range(5e-9, 5e-5)}),)
    shown_by = "rest of an hour and more"
    source = "data sheets: 0.1 to 100 µg, 0.001 to 10 deg/h"

    def begin(self, occasion: Occasion) -> Step:
        """Add the process to the channel."""
        process = Flicker([occasion.values["coefficient"]], occasion.interval_s, occasion.rng)

        def step(seen: Circumstances, readings: Readings) -> None:
            readings.of(occasion.channel)[:] += process.increments(seen.time_s.size)[:, 0]

        return step


EFFECT = BiasInstability()
