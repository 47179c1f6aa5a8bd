"""Rate random walk: the bias itself walks at random."""

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
from simulators.noise import RateRandomWalk


class RateRandomWalkEffect(Effect):
    """Rate (or acceleration) random walk K: Allan deviation K·√(τ/3), from zero at turn-on."""

    name = "rate_random_walk"
    text = "The sensor's bias drifts off at random, the further the longer."
    term = "rate random walk (IEEE 952), acceleration random walk (IEEE 1293)"
    stage = Stage.NOISE
    channels = ChannelKind.SENSOR
    parameters = (Parameter("coefficient", "y/sqrt(s)", "K", {"accel": Range(1e-8, 1e-4), "gyro": Range(1e-11, 1e-6)}),)
    shown_by = "rest of hours"
    source = "fits in IEEE 952 annex C and of MEMS data sheets"

    def begin(self, occasion: Occasion) -> Step:
        """Add the process to the channel."""
        process = RateRandomWalk([occasion.values["coefficient"]], occasion.interval_s, occasion.rng)

        def step(seen: Circumstances, readings: Readings) -> None:
            readings.of(occasion.channel)[:] += process.increments(seen.time_s.size)[:, 0]

        return step


EFFECT = RateRandomWalkEffect()
