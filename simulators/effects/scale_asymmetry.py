"""Scale-factor asymmetry: inputs of either sign are scaled differently."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simulators.effects.base import Array, ChannelKind, Circumstances, LinearEffect, Parameter, Range


class ScaleAsymmetry(LinearEffect):
    """Reading + error × ∣true input∣: the scale is larger by the error above zero and smaller by it below."""

    name = "scale_asymmetry"
    text = "The sensor scales positive and negative inputs differently."
    term = "scale-factor asymmetry (IEEE 528)"
    channels = ChannelKind.SENSOR
    parameters = (Parameter("error", "1", "half the difference of the two scales", {"any": Range(1e-6, 5e-3)}),)
    shown_by = "turns and positions of both signs"
    source = "data sheets: 1 to 500 ppm"

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the size of the true input."""
        return np.abs(seen.true(channel))[:, None]


EFFECT = ScaleAsymmetry()
