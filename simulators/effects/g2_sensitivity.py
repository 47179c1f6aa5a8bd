"""g²-sensitivity: a gyro's drift with the square of specific force."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simulators.effects.base import Array, ChannelKind, Circumstances, LinearEffect, Parameter, Range


class G2Sensitivity(LinearEffect):
    """Reading + coefficient × (true specific force along the accelerometer named)²."""

    name = "g2_sensitivity"
    text = "The gyro drifts with the square of a specific force, as an elastic suspension does."
    term = "acceleration-squared-sensitive (anisoelastic) drift rate (IEEE 528, 952)"
    channels = ChannelKind.PAIR
    acts_on = ("gyro",)
    parameters = (
        Parameter("coefficient", "y/(m/s^2)^2", "drift per specific force squared", {"gyro": Range(1e-10, 1e-6)}),
    )
    shown_by = "positions, and vibration along the axis"
    source = "data sheets: 0.005 to 0.2 deg/h/g² (mechanical, fibre)"

    def sources(self, sensor: str) -> tuple[str, ...]:  # noqa: ARG002
        """Return all three accelerometers."""
        return ("accel_x", "accel_y", "accel_z")

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the square of the specific force along the accelerometer."""
        return np.asarray(seen.true(channel.partition("<-")[2])[:, None] ** 2)


EFFECT = G2Sensitivity()
