"""Drift: the bias runs off in a straight line."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simulators.effects.base import Array, ChannelKind, Circumstances, LinearEffect, Parameter, Range


class Drift(LinearEffect):
    """Reading + rate × time, the time of the device at the middle of each interval."""

    name = "drift"
    text = "The sensor's bias changes steadily with time."
    term = "drift rate, rate ramp (IEEE 952), trend"
    channels = ChannelKind.SENSOR
    parameters = (
        Parameter("rate", "y/s", "growth of the bias", {"accel": Range(1e-8, 1e-4), "gyro": Range(1e-11, 1e-7)}),
    )
    shown_by = "rest, as long as can be"
    source = "fits of rate ramp in IEEE 952 annex C; ageing on data sheets: 0.001 to 1 deg/h per hour"

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the time."""
        return np.asarray((seen.time_s - 0.5 * seen.interval_s)[:, None])


EFFECT = Drift()
