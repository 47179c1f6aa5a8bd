"""A readout effect that was read off the samples it acted on, which are taken out before anything is fitted."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ReadOff:
    """An effect of one sensor's readout, its only parameter ± ``sigma`` [y]; ``nats``: what it explains."""

    effect: str
    channel: str
    value: float
    sigma: float
    nats: float
