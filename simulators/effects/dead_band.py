"""Dead band: small inputs are not felt at all."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simulators.effects.base import Array, Parameter, Range, SampleEffect


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


EFFECT = DeadBand()
