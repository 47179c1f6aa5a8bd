"""Latency: what a frame holds is older than its time stamp says."""

from __future__ import annotations

import numpy as np

from simulators.effects.base import (
    Array,
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


class Latency(Effect):
    """The input of a moment ``delay`` ago: increments of the same integral, its time shifted, linear within a sample.

    Before the first sample the input was as in the first.
    """

    name = "latency"
    text = "The samples are older than their time stamps say."
    term = "data latency, time-tag error"
    stage = Stage.SENSOR
    channels = ChannelKind.GROUP
    parameters = (Parameter("delay", "s", "age of the samples", {"any": Range(1e-5, 0.2)}),)
    shown_by = "turns that start and stop sharply, timed by the same clock"
    source = "filters and serial lines: 0.1 to 50 ms"

    def begin(self, occasion: Occasion) -> Step:
        """Put the delayed input in place of the present one."""
        triads = ("accel", "gyro") if occasion.channel == "all" else (occasion.channel,)
        lag = occasion.values["delay"] / occasion.interval_s
        kept: dict[str, Array] = {}

        def step(seen: Circumstances, readings: Readings) -> None:
            for triad in triads:
                true = seen.accel_mps2 if triad == "accel" else seen.gyro_radps
                depth = int(np.ceil(abs(lag))) + 2
                before = kept.get(triad)
                if before is None:
                    before = np.repeat(true[:1], depth, axis=0)
                longer = np.concatenate([before, true])
                kept[triad] = longer[-depth:]
                rows = readings.dv if triad == "accel" else readings.dtheta
                rows += (delayed(longer, lag)[depth:] - true) * seen.interval_s

        return step


def delayed(rate: Array, lag: float) -> Array:
    """Return mean rates (n, …) of the intervals ``lag`` samples earlier; beyond either end the nearest one holds."""
    whole = int(np.floor(lag))
    share = lag - whole
    index = np.arange(len(rate)) - whole
    later, earlier = (np.clip(index - k, 0, len(rate) - 1) for k in (0, 1))
    return np.asarray((1.0 - share) * rate[later] + share * rate[earlier])


EFFECT = Latency()
