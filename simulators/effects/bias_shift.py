"""Bias shift: a constant added to the reading."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simulators.effects.base import Array, ChannelKind, Circumstances, LinearEffect, Parameter, Range


class BiasShift(LinearEffect):
    """Reading + shift. The compensating term of (8), (9) is minus the shift."""

    name = "bias_shift"
    text = "The sensor reads a constant too much, since before the recording began."
    term = "bias (IEEE 528); bias repeatability (IEEE 952, 1293)"
    channels = ChannelKind.SENSOR
    parameters = (
        Parameter("shift", "y", "added to the reading", {"accel": Range(1e-4, 3e-2), "gyro": Range(5e-8, 5e-5)}),
    )
    shown_by = "rest, the attitude known"
    source = "navigation-grade to tactical data sheets: 10 µg to 3 mg, 0.01 to 10 deg/h"

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return ones."""
        return np.ones((seen.time_s.size, 1))


EFFECT = BiasShift()
