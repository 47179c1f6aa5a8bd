"""Clock scale: the device's clock runs fast or slow."""

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


class ClockScale(Effect):
    """Time stamps are (1 + error) × true time since power-up; increments stay what the true interval gave."""

    name = "clock_scale"
    text = "The block's clock runs fast, so that all its rates look too small."
    term = "clock (time-base) scale-factor error"
    stage = Stage.FRAME
    channels = ChannelKind.BLOCK
    parameters = (Parameter("error", "1", "share by which the clock is fast", {"any": Range(1e-6, 0.05)}),)
    shown_by = "rest in a known field, then turns long apart"
    source = "crystals: 1 to 100 ppm; RC oscillators of sensors: up to 4 %"

    def begin(self, occasion: Occasion) -> Step:
        """Stretch the time stamps."""

        def step(seen: Circumstances, readings: Readings) -> None:  # noqa: ARG001
            readings.time_s[:] *= 1.0 + occasion.values["error"]

        return step


EFFECT = ClockScale()
