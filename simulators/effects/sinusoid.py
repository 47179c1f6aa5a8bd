"""Sinusoidal pick-up: a line in the spectrum, as of mains, a wheel's spin or a dither."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from simulators.effects.base import Array, ChannelKind, Circumstances, LinearEffect, Parameter, Range


class Sinusoid(LinearEffect):
    """Reading + cosine·cos 2πft + sine·sin 2πft, averaged over each interval; t is the device's time."""

    name = "sinusoid"
    text = "The sensor picks up an oscillation of one frequency."
    term = "sinusoidal noise (IEEE 952)"
    channels = ChannelKind.SENSOR
    amplitudes = 2
    parameters = (
        Parameter(
            "cosine", "y", "amplitude in phase at time 0", {"accel": Range(1e-5, 5e-2), "gyro": Range(1e-8, 1e-3)}
        ),
        Parameter("sine", "y", "amplitude a quarter later", {"accel": Range(1e-5, 5e-2), "gyro": Range(1e-8, 1e-3)}),
        Parameter("frequency", "Hz", "of the line", {"any": Range(0.02, 1000.0)}),
    )
    shown_by = "rest, a hundred periods long, sampled at more than twice the frequency"
    source = "field reports: mains, spin and dither lines of 10 µg to 5 mg, 0.01 to 100 deg/h"

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the means of cos 2πft and sin 2πft over each interval."""
        omega = 2.0 * math.pi * shape["frequency"]
        half = 0.5 * omega * seen.interval_s
        phase = omega * seen.time_s - half
        return np.column_stack([np.cos(phase), np.sin(phase)]) * (math.sin(half) / half)


EFFECT = Sinusoid()
