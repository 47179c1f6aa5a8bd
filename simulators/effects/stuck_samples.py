"""Stuck samples: a sensor's register stands still while frames go on."""

from __future__ import annotations

import numpy as np

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


class StuckSamples(Effect):
    """From ``start`` for ``duration`` every frame repeats the value sent before; no status bit tells."""

    name = "stuck_samples"
    text = "The sensor repeats one value for a while."
    term = "stale data"
    stage = Stage.FRAME
    channels = ChannelKind.SENSOR
    parameters = (
        Parameter("start", "s", "first frame that repeats, on the device's clock", {"any": Range(0.0, 1e4)}),
        Parameter("duration", "s", "how long", {"any": Range(0.02, 100.0)}),
    )
    shown_by = "any, where noise is above the readout's step"
    source = "field reports on serial sensors"

    def begin(self, occasion: Occasion) -> Step:
        """Hold the value of the last frame before ``start``."""
        start, end = occasion.values["start"], occasion.values["start"] + occasion.values["duration"]
        held = 0.0  # what a register holds that has never been written

        def step(seen: Circumstances, readings: Readings) -> None:
            nonlocal held
            column = readings.of(occasion.channel)
            before = np.flatnonzero(seen.time_s < start)
            if before.size:
                held = float(column[before[-1]])
            column[(seen.time_s >= start) & (seen.time_s < end)] = held

        return step


EFFECT = StuckSamples()
