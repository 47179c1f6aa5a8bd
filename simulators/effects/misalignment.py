"""Misalignment: a sensor sees a share of what belongs to another axis of its triad."""

from __future__ import annotations

from collections.abc import Mapping

from simulators.effects.base import Array, ChannelKind, Circumstances, LinearEffect, Parameter, Range


class Misalignment(LinearEffect):
    """Reading + angle × true input of the other sensor."""

    name = "misalignment"
    text = "The sensor's axis leans towards another axis."
    term = "input-axis misalignment (IEEE 528)"
    channels = ChannelKind.PAIR
    parameters = (Parameter("angle", "rad", "lean", {"any": Range(1e-6, 1e-2)}),)
    shown_by = "turns about, or gravity along, the other axis, both ways"
    source = "data sheets: 0.02 mrad (laser) to 1 deg (MEMS)"

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the true input of the other sensor."""
        return seen.true(channel.partition("<-")[2])[:, None]


EFFECT = Misalignment()
