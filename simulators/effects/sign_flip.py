"""Sign flip: a sensor is mounted or wired the wrong way round."""

from __future__ import annotations

from simulators.effects.base import ChannelKind, Circumstances, Effect, Occasion, Readings, Stage, Step


class SignFlip(Effect):
    """Reading × (-1)."""

    name = "sign_flip"
    text = "The sensor reads with the wrong sign."
    term = "polarity error"
    stage = Stage.FRAME
    channels = ChannelKind.SENSOR
    parameters = ()
    shown_by = "gravity along the sensor, or a turn about it"
    source = "commissioning reports"

    def begin(self, occasion: Occasion) -> Step:
        """Turn the sign."""

        def step(seen: Circumstances, readings: Readings) -> None:  # noqa: ARG001
            readings.of(occasion.channel)[:] *= -1.0

        return step


EFFECT = SignFlip()
