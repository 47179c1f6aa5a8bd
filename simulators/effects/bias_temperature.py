"""Temperature coefficient of bias."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simulators.effects.base import Array, ChannelKind, Circumstances, LinearEffect, Parameter, Range


class BiasTemperature(LinearEffect):
    """Reading + coefficient × (temperature - reference)."""

    name = "bias_temperature"
    text = "The sensor's bias follows the temperature."
    term = "temperature sensitivity of bias (IEEE 528, 1293)"
    channels = ChannelKind.SENSOR
    parameters = (
        Parameter(
            "coefficient", "y/K", "change of bias per kelvin", {"accel": Range(1e-5, 1e-2), "gyro": Range(1e-9, 5e-6)}
        ),
        Parameter("reference", "degC", "temperature at which nothing is added", {"any": Range(-40.0, 85.0)}),
    )
    shown_by = "rest while the temperature changes by ten kelvin and more, up and down"
    source = "data sheets: 1 to 100 µg/K, 0.001 to 1 deg/h/K"

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the temperature less the reference."""
        return np.asarray(seen.temperature_c[:, :1] - shape["reference"], dtype=np.float64)


EFFECT = BiasTemperature()
