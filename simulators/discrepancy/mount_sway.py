"""A mount that sways: one random angle, felt by gyros as its rate and by accelerometers as gravity tilted.

A launcher in the wind sways without mean: its angle forgets itself within a correlation time that all sensors share.
What it adds to their noise looks on one gyro like bias instability and on one accelerometer like noise of no colour at
all; that it is on several at once, at one correlation time, tells that it is not theirs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inertial.documents import CHANNELS
from simulators.discrepancy.candidates import GYROS, Slot
from simulators.discrepancy.evidence import Evidence, Fit, bayes_factor
from simulators.discrepancy.noise_likelihood import log_likelihood, most_likely, start_of
from simulators.discrepancy.sway_time import times_to_try

Array = NDArray[np.float64]

FEWEST = 2
"""Channels that must feel a sway."""
FELT = 3.0
"""Evidence [nats] by which one of them feels it."""
_TIMES, _HALVED = 10, 4  # correlation times tried at first; how often the way between two of them is halved


@dataclass(frozen=True)
class Sway:
    """A sway whose angle forgets itself within ``correlation_s``, and the power by slot (b, 1) that it adds.

    On gyros as rate [1/s²] by variance of the angle [rad²], on accelerometers as the angle itself, gravity left out.
    ``evidence_nats`` by channel that feels it, beside the noise stated.
    """

    correlation_s: float
    columns: dict[Slot, Array]
    evidence_nats: dict[str, float]


def find_sway(evidence: Evidence, fit: Fit, power: Mapping[Slot, Array], otherwise: Mapping[str, float]) -> Sway | None:
    """Return the sway that explains most of what slots have beyond a power (b,).

    None where it explains too few channels better than noise of their own does, whose evidence [nats] ``otherwise`` is:
    a channel that something else explains as well does not tell how the mount sways.
    """
    times = times_to_try((evidence.basis[slot] for slot in power), _TIMES)
    tried = {time: _at(evidence, fit, power, time) for time in times}

    width = math.log(times[1] / times[0])
    for _ in range(_HALVED):
        width *= 0.5
        middle = max(tried, key=lambda time: _merit(tried[time], otherwise))
        for time in (middle * math.exp(-width), middle * math.exp(width)):
            tried[time] = _at(evidence, fit, power, time)
    best = max(tried.values(), key=lambda sway: _merit(sway, otherwise))
    return best if sum(nats > FELT for nats in _beyond(best, otherwise)) >= FEWEST else None


def _beyond(sway: Sway, otherwise: Mapping[str, float]) -> list[float]:
    """Return by how much [nats] a sway explains each channel better than noise of its own."""
    return [sway.evidence_nats.get(channel, 0.0) - nats for channel, nats in otherwise.items()]


def _merit(sway: Sway, otherwise: Mapping[str, float]) -> float:
    """Return what a sway explains better, less the logarithms of what it explains worse.

    So a channel that another noise fills does not decide, and a correlation time that is only about right is told from
    one that is far off.
    """
    return sum(nats if nats > 0.0 else -math.log1p(-nats) for nats in _beyond(sway, otherwise))


def _at(evidence: Evidence, fit: Fit, power: Mapping[Slot, Array], correlation_s: float) -> Sway:
    tilted = {slot: slot[1] not in GYROS for slot in power}
    columns = {slot: evidence.basis[slot].sway(correlation_s, tilted=tilted[slot])[:, None] for slot in power}
    channels = {channel: [slot for slot in power if slot[1] == channel] for _, channel in power}
    felt = {CHANNELS[channel]: _gain(evidence, fit, power, columns, slots) for channel, slots in channels.items()}
    return Sway(correlation_s, columns, {channel: nats for channel, nats in felt.items() if nats > 0.0})


def angle_rad(sway: Sway, powers: Mapping[Slot, Array]) -> float | None:
    """Return the angle's σ [rad], root mean square of what gyros feel by its power (b,); none where none feels it."""
    squares = [float(np.sum(powers[slot]) / np.sum(sway.columns[slot])) for slot in powers if slot[1] in GYROS]
    return math.sqrt(float(np.mean(squares))) if squares else None


def _gain(
    evidence: Evidence, fit: Fit, power: Mapping[Slot, Array], columns: Mapping[Slot, Array], slots: Sequence[Slot]
) -> float:
    """Return the Bayes factor [nats] of a sway on a channel's slots, or less than 0."""
    mine, swaying = {slot: power[slot] for slot in slots}, {slot: columns[slot] for slot in slots}
    variances = most_likely(evidence, fit, mine, swaying, start_of(evidence, fit, mine, swaying))
    swayed = {slot: now + swaying[slot] @ variances for slot, now in mine.items()}
    gained = log_likelihood(evidence, fit, swayed) - log_likelihood(evidence, fit, mine)
    return bayes_factor(gained, len(variances), 1.0)
