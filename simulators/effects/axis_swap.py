"""Axis swap: two sensors are wired to each other's channel."""

from __future__ import annotations

from simulators.effects.base import ChannelKind, Circumstances, Effect, Occasion, Readings, Stage, Step


class AxisSwap(Effect):
    """The two channels of the pair bear each other's readings; ``gyro_x<-gyro_y`` is the same as ``gyro_y<-gyro_x``."""

    name = "axis_swap"
    text = "Two sensors of a triad are exchanged."
    term = "wiring error"
    stage = Stage.FRAME
    channels = ChannelKind.PAIR
    parameters = ()
    shown_by = "rest in two attitudes, or turns about two axes"
    source = "commissioning reports"

    def begin(self, occasion: Occasion) -> Step:
        """Exchange the columns."""
        on, _, by = occasion.channel.partition("<-")

        def step(seen: Circumstances, readings: Readings) -> None:  # noqa: ARG001
            held = readings.of(on).copy()
            readings.of(on)[:] = readings.of(by)
            readings.of(by)[:] = held

        return step


EFFECT = AxisSwap()
