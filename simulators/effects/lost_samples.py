"""Lost samples: frames that never come."""

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


class LostSamples(Effect):
    """Each frame is lost with probability ``fraction``, whatever happens to the others."""

    name = "lost_samples"
    text = "Frames are missing from the recording."
    term = "missing data"
    stage = Stage.FRAME
    channels = ChannelKind.BLOCK
    parameters = (Parameter("fraction", "1", "share of frames lost", {"any": Range(1e-5, 0.2)}),)
    shown_by = "any that carries frame numbers or time stamps"
    source = "field reports on serial lines and loggers"

    def begin(self, occasion: Occasion) -> Step:
        """Mark what is lost."""

        def step(seen: Circumstances, readings: Readings) -> None:
            readings.lost[:] |= occasion.rng.random(seen.time_s.size) < occasion.values["fraction"]

        return step


EFFECT = LostSamples()
