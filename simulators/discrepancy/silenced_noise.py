"""Noise that is gone where a limit or a dead band stands in its way (IEEE 528), which no other name explains.

Means alone may not tell a limit that is met now and then from a scale error of third order. What is left can: where a
sample is silenced it has no noise, so that the noise comes and goes with the input, and nowhere else.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from inertial.documents import CHANNELS
from simulators.discrepancy.adopt import Adopted, Search
from simulators.discrepancy.candidates import Kind
from simulators.discrepancy.clipping import without_limit
from simulators.discrepancy.compare import Scene
from simulators.discrepancy.nonstationarity import MARGIN, unsteady_nats
from simulators.discrepancy.ranking import Ranking, Scored
from simulators.discrepancy.read_off import ReadOff
from simulators.discrepancy.silence import without_band

WITHOUT = {"saturation": without_limit, "dead_band": without_band}
"""What takes out the samples that such an effect silences."""


def told_by_silence(search: Search) -> Search:
    """Return the search with limits and dead bands in the place of names beside which noise comes and goes.

    If they do better, what they silence counted.
    """
    for entry in search.of_kind(Kind.NAMED):
        silencing = _silencing(search, entry)
        if silencing is not None:
            search = search.with_instead(entry, silencing)
    return search


def _silencing(search: Search, entry: Adopted) -> Adopted | None:
    """Return what silences the noise that comes and goes beside a name, if that explains more than the name."""
    evidence, h = search.evidence, entry.hypothesis
    channels = evidence.channels(h.columns)
    if h.effect in WITHOUT or len(channels) != 1:
        return None
    slots = [slot for slot in evidence.slots if slot[1] in channels]
    before = sum(max(0.0, unsteady_nats(evidence, search.fit, slot)) for slot in slots)
    if before <= MARGIN:
        return None
    ranking, rest = Ranking(evidence), [one.hypothesis for one in search.adopted if one is not entry]
    without = ranking.fit_of(rest, search.fit)
    own = ranking.score(h, without, rest)
    assert own is not None  # or it had not been adopted
    channel, best = CHANNELS[channels.pop()], own.score
    found = None
    for rival in ranking.rank_against(replace(own, score=own.score - before), without, rest):
        if rival.hypothesis.effect not in WITHOUT or rival.hypothesis.channel != channel:
            continue
        after = [unsteady_nats(evidence, rival.fit, slot, _silenced(search, rival, slot[0])) for slot in slots]
        told = before - sum(max(0.0, nats) for nats in after)
        if rival.score + told > best:
            best = rival.score + told
            found = Adopted(rival.hypothesis, rival.gain + told, best, noise_nats=told)
    return found


def _silenced(search: Search, one: Scored, place: int) -> NDArray[np.bool_]:
    """Return which samples (n,) of a recording are in reach of a limit or a dead band."""
    scene: Scene = search.evidence.library.scenes[place]
    h = one.hypothesis
    (size,) = h.shape.values()
    masked = WITHOUT[h.effect](scene, ReadOff(h.effect, h.channel, size, 0.0, one.score))
    return np.asarray(masked.data.missing[:, CHANNELS.index(h.channel)])
