"""Turn-on transient: a bias that dies away as the block warms up."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from simulators.effects.base import Array, ChannelKind, Circumstances, LinearEffect, Parameter, Range


class TurnOnTransient(LinearEffect):
    """Reading + amplitude·exp(−t/τ) from turn-on, averaged over each interval."""

    name = "turn_on_transient"
    text = "The sensor's bias dies away after turn-on, exponentially."
    term = "turn-on transient; warm-up time (IEEE 528)"
    channels = ChannelKind.SENSOR
    parameters = (
        Parameter("amplitude", "y", "added at turn-on", {"accel": Range(1e-4, 5e-2), "gyro": Range(1e-7, 1e-4)}),
        Parameter("time_constant", "s", "until a factor 1/e is left", {"any": Range(5.0, 2000.0)}),
    )
    shown_by = "rest from turn-on, three time constants long"
    source = "data sheets: stabilisation 30 s (laser) to 30 min (mechanical gyros, quartz accelerometers)"

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the mean of exp(−t/τ) over each interval."""
        half = 0.5 * seen.interval_s / shape["time_constant"]
        mean = np.exp(-seen.time_s / shape["time_constant"] + half) * (math.sinh(half) / half)
        return np.asarray(mean[:, None])


EFFECT = TurnOnTransient()
