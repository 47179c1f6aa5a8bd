"""Third-order nonlinearity of the scale factor."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simulators.effects.base import Array, ChannelKind, Circumstances, LinearEffect, Parameter, Range


class ScaleCubic(LinearEffect):
    """Reading + coefficient × (true input)³."""

    name = "scale_cubic"
    text = "The sensor's reading bends with the cube of its input."
    term = "third-order nonlinearity coefficient K3 (IEEE 1293)"
    channels = ChannelKind.SENSOR
    parameters = (Parameter("coefficient", "1/(y)^2", "K3", {"accel": Range(1e-9, 1e-5), "gyro": Range(1e-6, 1e1)}),)
    shown_by = "turns at three rates and more; a tumble for accelerometers"
    source = "data sheets: 0.1 to 50 µg/g³"

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the cube of the true input."""
        return np.asarray(seen.true(channel)[:, None] ** 3)


EFFECT = ScaleCubic()
