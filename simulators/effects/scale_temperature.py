"""Temperature coefficient of scale."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simulators.effects.base import Array, ChannelKind, Circumstances, LinearEffect, Parameter, Range


class ScaleTemperature(LinearEffect):
    """Reading + coefficient × (temperature - reference) × true input."""

    name = "scale_temperature"
    text = "The sensor's scale factor follows the temperature."
    term = "temperature sensitivity of scale factor (IEEE 528, 1293)"
    channels = ChannelKind.SENSOR
    parameters = (
        Parameter("coefficient", "1/K", "change of scale per kelvin", {"any": Range(1e-6, 1e-3)}),
        Parameter("reference", "degC", "temperature at which nothing is added", {"any": Range(-40.0, 85.0)}),
    )
    shown_by = "positions or turns of both signs at two temperatures"
    source = "data sheets: 1 to 300 ppm/K"

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:
        """Return the true input times the temperature less the reference."""
        return np.asarray(seen.true(channel) * (seen.temperature_c[:, 0] - shape["reference"]), dtype=np.float64)[
            :, None
        ]


EFFECT = ScaleTemperature()
