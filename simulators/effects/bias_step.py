"""Bias step: the bias jumps at one moment."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simulators.effects.base import Array, ChannelKind, Circumstances, LinearEffect, Parameter, Range


class BiasStep(LinearEffect):
    """Reading + step from ``time`` on; the sample in which it falls takes its share."""

    name = "bias_step"
    text = "The sensor's bias jumps at one moment, as after a shock."
    term = "bias instability of the step kind; shock residual (IEEE 1293)"
    channels = ChannelKind.SENSOR
    parameters = (
        Parameter("step", "y", "added from then on", {"accel": Range(1e-4, 3e-2), "gyro": Range(5e-8, 5e-5)}),
        Parameter("time", "s", "when, on the device's clock", {"any": Range(0.0, 1e4)}),
    )
    shown_by = "rest long before and after"
    source = "shock tests on data sheets: up to the turn-on repeatability"

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the share of each interval that lies behind the step."""
        share = np.clip((seen.time_s - shape["time"]) / seen.interval_s, 0.0, 1.0)
        return np.asarray(share[:, None])


EFFECT = BiasStep()
