"""A readout effect that was read off the samples it acted on, which are taken out before anything is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class ReadOff:
    """An effect of one sensor's readout, its only parameter ± ``sigma`` [y]; ``nats``: what it explains."""

    effect: str
    channel: str
    value: float
    sigma: float
    nats: float


def combined(found: Sequence[ReadOff]) -> list[ReadOff]:
    """Return each effect of each sensor once, with the weighted mean of what several recordings say of it."""
    names = dict.fromkeys((one.effect, one.channel) for one in found)
    return [_mean([one for one in found if (one.effect, one.channel) == name]) for name in names]


def _mean(same: Sequence[ReadOff]) -> ReadOff:
    surest = min(same, key=lambda one: one.sigma)
    if len(same) == 1 or surest.sigma == 0.0:
        return surest
    weights = [one.sigma**-2.0 for one in same]
    value = sum(weight * one.value for weight, one in zip(weights, same, strict=True)) / sum(weights)
    return ReadOff(same[0].effect, same[0].channel, value, sum(weights) ** -0.5, sum(one.nats for one in same))
