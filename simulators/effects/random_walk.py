"""Random walk: white noise of the reading, on top of the model's own."""

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
from simulators.noise import White


class RandomWalk(Effect):
    """Angle or velocity random walk N: Allan deviation N/√τ. Adds to the model's in power."""

    name = "random_walk"
    text = "The sensor's reading has more white noise than believed."
    term = "angle random walk, velocity random walk (IEEE 952, 1293)"
    stage = Stage.NOISE
    channels = ChannelKind.SENSOR
    parameters = (Parameter("coefficient", "y/sqrt(Hz)", "N", {"accel": Range(1e-5, 5e-3), "gyro": Range(5e-8, 2e-4)}),)
    shown_by = "rest, seconds are enough"
    source = "data sheets: 1 to 500 µg/√Hz, 0.001 to 0.5 deg/√h"

    def begin(self, occasion: Occasion) -> Step:
        """Add the process to the channel."""
        process = White([occasion.values["coefficient"]], occasion.interval_s, occasion.rng)

        def step(seen: Circumstances, readings: Readings) -> None:
            readings.of(occasion.channel)[:] += process.increments(seen.time_s.size)[:, 0]

        return step


EFFECT = RandomWalk()
