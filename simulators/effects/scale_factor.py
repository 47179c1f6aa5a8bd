"""Scale-factor error: the reading is too large in proportion."""

from __future__ import annotations

from collections.abc import Mapping

from simulators.effects.base import Array, ChannelKind, Circumstances, LinearEffect, Parameter, Range


class ScaleFactor(LinearEffect):
    """Reading + error × true input."""

    name = "scale_factor"
    text = "The sensor reads too much in proportion to its input."
    term = "scale-factor error (IEEE 528)"
    channels = ChannelKind.SENSOR
    parameters = (Parameter("error", "1", "share of the input added", {"any": Range(1e-6, 1e-2)}),)
    shown_by = "positions and turns of both signs"
    source = "data sheets: 5 ppm (laser gyro) to 1 % (consumer MEMS)"

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the true input."""
        return seen.true(channel)[:, None]


EFFECT = ScaleFactor()
