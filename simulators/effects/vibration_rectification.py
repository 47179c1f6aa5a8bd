"""Vibration rectification: a bias that lasts as long as the vibration."""

from __future__ import annotations

from collections.abc import Mapping

from simulators.effects.base import Array, ChannelKind, Circumstances, LinearEffect, Parameter, Range


class VibrationRectification(LinearEffect):
    """Reading + coefficient × mean square of the vibration: grms² (in (m/s²)²) from its start to its end."""

    name = "vibration_rectification"
    text = "Vibration shifts the sensor's mean reading."
    term = "vibration rectification error (IEEE 528, 1293)"
    channels = ChannelKind.SENSOR
    parameters = (
        Parameter(
            "coefficient",
            "y/(m/s^2)^2",
            "shift per mean square",
            {"accel": Range(1e-7, 1e-3), "gyro": Range(1e-10, 1e-5)},
        ),
    )
    shown_by = "rest, then vibration, then rest"
    source = "data sheets: 10 to 100 µg/g² rms, 0.05 to 5 deg/h/g² rms"

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the mean square of the vibration."""
        return seen.vibration_mps2_squared[:, None]


EFFECT = VibrationRectification()
