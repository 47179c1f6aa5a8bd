"""Larger noise with a name in the place of an effect: a walk of few coefficients is as good a shift or drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from inertial.documents import CHANNELS, ChannelNoise
from simulators.discrepancy.evidence import Evidence, Fit
from simulators.discrepancy.noise_names import larger_noise
from simulators.discrepancy.ranking import Scored


@dataclass(frozen=True)
class NoiseInstead:
    """What larger noise with a name explains of a sensor beyond a fit [nats], and the names of its one term.

    ``certain``: whether it would be named in any case; ``noise``: how large all of it is.
    """

    channel: str
    nats: float
    names: tuple[str, ...]
    certain: bool
    noise: ChannelNoise


def noise_instead(evidence: Evidence, fit: Fit, channel: int) -> NoiseInstead:
    """Return what larger noise with a name explains of a sensor beyond a fit, in all recordings together.

    Nothing where the noise of the fit, of whatever colour, is as good.
    """
    found = {slot: larger_noise(evidence, fit, slot) for slot in evidence.slots if slot[1] == channel}
    nats = sum(one.value - evidence.slot_value(slot, fit) for slot, one in found.items())
    names = dict.fromkeys(name for one in found.values() for name in one.names)
    certain, noise = any(one.certain for one in found.values()), next(iter(found.values())).noise
    return NoiseInstead(CHANNELS[channel], max(0.0, nats), tuple(names), certain, noise)


def beyond_noise(evidence: Evidence, one: Scored, current: Fit) -> tuple[float, NoiseInstead | None]:
    """Return the score of a hypothesis held against larger noise with a name in its place, and that noise."""
    return held_against_noise(evidence, one.score, one.hypothesis.columns, one.fit, current)


def held_against_noise(
    evidence: Evidence, score: float, columns: Sequence[int], fit: Fit, current: Fit
) -> tuple[float, NoiseInstead | None]:
    """Return the score of columns held against larger noise with a name in their place, and that noise.

    Beside them in their ``fit`` there may be larger noise as well, by the same name for the same price. There is none
    in the place of what acts on several sensors.
    """
    channels = evidence.channels(columns)
    if len(channels) != 1:
        return score, None
    (channel,) = channels
    noise = noise_instead(evidence, current, channel)
    if noise.nats == 0.0:
        return score, noise
    return score - noise.nats + noise_instead(evidence, fit, channel).nats, noise
