"""Saturation: large inputs are clipped."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simulators.effects.base import Array, Parameter, Range, SampleEffect
from simulators.normal import beyond


class Saturation(SampleEffect):
    """A reading beyond ±``limit`` becomes ±``limit``. Each sample by itself."""

    name = "saturation"
    text = "The sensor clips large inputs."
    term = "input range, saturation (IEEE 528)"
    parameters = (
        Parameter("limit", "y", "largest size of a reading", {"accel": Range(0.5, 500.0), "gyro": Range(1e-3, 40.0)}),
    )
    shown_by = "turns or vibration beyond the range"
    source = "data sheets: 1 to 50 g, 10 to 2000 deg/s"

    def changed(self, reading: Array, values: Mapping[str, float]) -> Array:
        """Return the clipped reading."""
        return np.clip(reading, -values["limit"], values["limit"])

    def mean_change(self, reading: Array, sigma: float, values: Mapping[str, float]) -> Array:
        """Return minus the mean of what lies beyond the limits."""
        above, below = ((side * reading - values["limit"]) / sigma for side in (1.0, -1.0))
        return np.asarray(sigma * (beyond(below) - beyond(above)))


EFFECT = Saturation()
