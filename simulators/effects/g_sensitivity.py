"""g-sensitivity: a gyro's drift in proportion to specific force."""

from __future__ import annotations

from collections.abc import Mapping

from simulators.effects.base import Array, ChannelKind, Circumstances, LinearEffect, Parameter, Range


class GSensitivity(LinearEffect):
    """Reading + coefficient × true specific force along the accelerometer named."""

    name = "g_sensitivity"
    text = "The gyro drifts in proportion to a specific force, as an unbalanced rotor does."
    term = "acceleration-sensitive drift rate (IEEE 528, 952)"
    channels = ChannelKind.PAIR
    acts_on = ("gyro",)
    parameters = (Parameter("coefficient", "y/(m/s^2)", "drift per specific force", {"gyro": Range(1e-9, 1e-4)}),)
    shown_by = "positions: gravity along the axis both ways"
    source = "data sheets: 0.01 deg/h/g (fibre) to 10 deg/h/g (mechanical), 0.1 deg/s/g (MEMS)"

    def sources(self, sensor: str) -> tuple[str, ...]:  # noqa: ARG002
        """Return all three accelerometers."""
        return ("accel_x", "accel_y", "accel_z")

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the specific force along the accelerometer."""
        return seen.true(channel.partition("<-")[2])[:, None]


EFFECT = GSensitivity()
