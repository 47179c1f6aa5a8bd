"""Quantisation: the readout counts in coarser steps than believed."""

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
from simulators.noise import Quantiser


class Quantisation(Effect):
    """The integral is read out in whole steps: increments are differences of a rounded sum (Allan step/2τ)."""

    name = "quantisation"
    text = "The sensor's output comes in coarser steps than believed."
    term = "quantization noise (IEEE 952), Q = step/√12"
    stage = Stage.READOUT
    channels = ChannelKind.SENSOR
    parameters = (Parameter("step", "y*s", "size", {"accel": Range(1e-6, 1e-2), "gyro": Range(1e-8, 1e-4)}),)
    shown_by = "rest, seconds are enough"
    source = "laser-gyro pulses of 0.5 to 2 arc seconds; accelerometer counters of 1e-5 to 1e-3 m/s"

    def begin(self, occasion: Occasion) -> Step:
        """Round the channel's running sum."""
        quantiser = Quantiser([occasion.values["step"]])

        def step(seen: Circumstances, readings: Readings) -> None:  # noqa: ARG001
            column = readings.of(occasion.channel)
            rounded = column[:, None].copy()
            quantiser.quantise(rounded)
            column[:] = rounded[:, 0]

        return step


EFFECT = Quantisation()
