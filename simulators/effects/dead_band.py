"""Dead band: small inputs are not felt at all."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.special import ndtr

from simulators.effects.base import Array, Parameter, Range, SampleEffect
from simulators.normal import density


class DeadBand(SampleEffect):
    """A reading smaller than ``half_width`` becomes zero; one beyond it stays as it is. Each sample by itself."""

    name = "dead_band"
    text = "The sensor reads zero for small inputs."
    term = "dead band (IEEE 528); lock-in of laser gyros"
    parameters = (
        Parameter("half_width", "y", "of the band about zero", {"accel": Range(1e-5, 5e-1), "gyro": Range(1e-8, 1e-2)}),
    )
    shown_by = "slow turns through zero, and rest near zero input"
    source = "data sheets: 1 to 100 µg; lock-in of undithered laser gyros, 10 to 1000 deg/h"

    def changed(self, reading: Array, values: Mapping[str, float]) -> Array:
        """Return zero within the band."""
        return np.where(np.abs(reading) < values["half_width"], 0.0, reading)

    def mean_change(self, reading: Array, sigma: float, values: Mapping[str, float]) -> Array:
        """Return minus the mean of what the band takes away."""
        low, high = ((side * values["half_width"] - reading) / sigma for side in (-1.0, 1.0))
        return np.asarray(sigma * (density(high) - density(low)) - reading * (ndtr(high) - ndtr(low)))


EFFECT = DeadBand()
