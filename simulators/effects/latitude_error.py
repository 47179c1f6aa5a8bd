"""Latitude error: the site lies elsewhere than stated."""

from __future__ import annotations

from dataclasses import replace

from simulators.effects.base import ChannelKind, Occasion, Parameter, Range, SetupEffect
from simulators.motion import Setup


class LatitudeError(SetupEffect):
    """True latitude = stated latitude + error; gravity stays what the site says."""

    name = "latitude_error"
    text = "The site's latitude is not the one stated."
    term = "latitude error of the set-up"
    channels = ChannelKind.BLOCK
    parameters = (Parameter("error", "rad", "true less stated", {"any": Range(1e-5, 0.1)}),)
    shown_by = "rest, the azimuth known"
    source = "typed coordinates: 0.001 to 5 deg"

    def arrange(self, setup: Setup, occasion: Occasion) -> Setup:
        """Move the site along its meridian."""
        return replace(setup, site=replace(setup.site, latitude_rad=setup.site.latitude_rad + occasion.values["error"]))


EFFECT = LatitudeError()
