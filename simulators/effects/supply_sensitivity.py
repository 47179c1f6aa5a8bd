"""Supply sensitivity: the bias follows the supply voltage."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simulators.effects.base import Array, ChannelKind, Circumstances, LinearEffect, Parameter, Range


class SupplySensitivity(LinearEffect):
    """Reading + coefficient × (supply - nominal)."""

    name = "supply_sensitivity"
    text = "The sensor's bias follows the supply voltage."
    term = "power-supply sensitivity (IEEE 952, 1293)"
    channels = ChannelKind.SENSOR
    parameters = (
        Parameter(
            "coefficient", "y/V", "change of bias per volt", {"accel": Range(1e-6, 1e-2), "gyro": Range(1e-9, 1e-5)}
        ),
        Parameter("nominal", "V", "supply at which nothing is added", {"any": Range(3.0, 36.0)}),
    )
    shown_by = "rest while the supply steps over its range"
    source = "data sheets: 1 to 100 µg/V, 0.01 to 1 deg/h/V"

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the supply less its nominal value."""
        return np.asarray(seen.supply_v - shape["nominal"], dtype=np.float64)[:, None]


EFFECT = SupplySensitivity()
