"""Azimuth error: the launcher points elsewhere than stated."""

from __future__ import annotations

from dataclasses import replace

from simulators.effects.base import ChannelKind, Occasion, Parameter, Range, SetupEffect
from simulators.motion import Setup


class AzimuthError(SetupEffect):
    """True azimuth = stated azimuth + error, clockwise from north. An east gyro bias looks the same at rest."""

    name = "azimuth_error"
    text = "The launcher's azimuth is not the one stated."
    term = "azimuth reference error"
    channels = ChannelKind.BLOCK
    parameters = (Parameter("error", "rad", "true less stated", {"any": Range(1e-4, 0.1)}),)
    shown_by = "rest at two headings a known angle apart"
    source = "0.01 deg (surveyed) to several degrees (compass)"

    def arrange(self, setup: Setup, occasion: Occasion) -> Setup:
        """Turn the tangent frame."""
        return replace(setup, azimuth_rad=setup.azimuth_rad + occasion.values["error"])


EFFECT = AzimuthError()
