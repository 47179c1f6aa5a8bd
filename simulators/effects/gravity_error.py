"""Gravity error: gravity at the site is not what was assumed."""

from __future__ import annotations

from dataclasses import replace

from simulators.effects.base import ChannelKind, Occasion, Parameter, Range, SetupEffect
from simulators.motion import Setup


class GravityError(SetupEffect):
    """True gravity = assumed gravity + error."""

    name = "gravity_error"
    text = "The site's gravity is not the one assumed."
    term = "gravity reference error (IEEE 1293)"
    channels = ChannelKind.BLOCK
    parameters = (Parameter("error", "m/s^2", "true less assumed", {"any": Range(1e-6, 1e-2)}),)
    shown_by = "positions: gravity along each accelerometer both ways"
    source = "gravity anomalies: 1 to 300 mGal; a wrong height: 0.3 mGal/m"

    def arrange(self, setup: Setup, occasion: Occasion) -> Setup:
        """Change the site's gravity."""
        return replace(setup, site=replace(setup.site, gravity_mps2=setup.site.gravity_mps2 + occasion.values["error"]))


EFFECT = GravityError()
