"""Second-order nonlinearity of the scale factor."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simulators.effects.base import Array, ChannelKind, Circumstances, LinearEffect, Parameter, Range


class ScaleQuadratic(LinearEffect):
    """Reading + coefficient × (true input)²."""

    name = "scale_quadratic"
    text = "The sensor's reading bends with the square of its input."
    term = "second-order nonlinearity coefficient K2 (IEEE 1293)"
    channels = ChannelKind.SENSOR
    parameters = (Parameter("coefficient", "1/(y)", "K2", {"accel": Range(1e-7, 1e-4), "gyro": Range(1e-6, 1e-1)}),)
    shown_by = "positions, and turns at several rates of both signs"
    source = "data sheets: 5 to 100 µg/g²"

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the square of the true input."""
        return np.asarray(seen.true(channel)[:, None] ** 2)


EFFECT = ScaleQuadratic()
