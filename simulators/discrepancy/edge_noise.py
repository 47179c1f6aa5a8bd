"""Noise that a dead band makes of an input near its edge (IEEE 528): readings jump between nothing and all of it.

At rest, means alone cannot tell such a band from a shift. The noise can: how much larger than stated it is follows from
input, width and what is stated, so that one number explains what takes two by any other names.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from inertial.documents import CHANNELS
from simulators.discrepancy.adopt import Adopted, Search
from simulators.discrepancy.candidates import Hypothesis, Kind, Slot
from simulators.discrepancy.compare import SampleNoise
from simulators.discrepancy.evidence import Evidence, Fit
from simulators.discrepancy.look import Look
from simulators.discrepancy.margins import TIE
from simulators.discrepancy.noise_likelihood import log_likelihood
from simulators.discrepancy.noise_names import larger_noise
from simulators.discrepancy.ranking import Ranking, Scored
from simulators.discrepancy.whitening import STATED
from simulators.normal import density

Array = NDArray[np.float64]

_BAND = "dead_band"


def told_by_noise(search: Search) -> Search:
    """Return the search with dead bands in the place of names beside which noise is larger, if they explain both."""
    for entry in search.of_kind(Kind.NAMED):
        band = _band_instead(search, entry)
        if band is not None:
            search = search.with_instead(entry, band)
    return search


def read_sigma(inputs: Array, sigma: float, half_width: float) -> float:
    """Return the rms of readings [y] about their means behind a dead band, of inputs (n,) [y] with noise of 1σ [y].

    Normal noise: ∫ x² N(x; u, σ²) dx from a to b is (u² + σ²)·P - σ·[(2u + σz)·φ(z)] between the ends, in σ about u.
    """
    low, high = ((side * half_width - inputs) / sigma for side in (-1.0, 1.0))
    silent = ndtr(high) - ndtr(low)
    taken = inputs * silent - sigma * (density(high) - density(low))
    ends = (2.0 * inputs + sigma * high) * density(high) - (2.0 * inputs + sigma * low) * density(low)
    square = inputs**2 + sigma**2 - (inputs**2 + sigma**2) * silent + sigma * ends
    return math.sqrt(max(0.0, float(np.mean(square - (inputs - taken) ** 2))))


def _band_instead(search: Search, entry: Adopted) -> Adopted | None:
    """Return a dead band in the place of a name and of larger white noise beside it; none if it explains less."""
    evidence = search.evidence
    channels = evidence.channels(entry.hypothesis.columns)
    slots = [slot for slot in evidence.slots if slot[1] in channels]
    if len(channels) > 1 or any(evidence.stated[slot] is None or not _stated_sigma(evidence, slot) for slot in slots):
        return None
    if all(search.fit.noise[slot].level == STATED for slot in slots):
        return None
    larger = [larger_noise(evidence, search.fit, slot) for slot in slots]
    if not any(one.certain and "random_walk" in one.names for one in larger):
        return None
    met = dict(evidence.library.met)
    band = _explaining_both(search, entry, slots, sum(one.value for one in larger))
    if band is None:
        evidence.library.met = met
    return band


def _explaining_both(search: Search, entry: Adopted, slots: list[Slot], larger: float) -> Adopted | None:
    """Return a dead band that explains no less than a name and noise beside it of a ``larger`` likelihood [nats]."""
    evidence, rest = search.evidence, [one.hypothesis for one in search.adopted if one is not entry]
    band = _met_by_stated(evidence, slots, rest, search.fit)
    if band is None:
        return None
    explained = sum(_with_edge_noise(evidence, band, slot) for slot in slots) - (band.gain - band.score)
    both = larger - (entry.gain - entry.score)
    if explained < both - TIE:
        return None
    beyond = explained - both + entry.score - band.score
    return Adopted(band.hypothesis, band.gain + beyond, band.score + beyond, noise_nats=beyond)


def _met_by_stated(evidence: Evidence, slots: list[Slot], rest: list[Hypothesis], fit: Fit) -> Scored | None:
    """Return the dead band of one channel that fits best beside others in the noise that is stated; none without one.

    The noise that was found is larger by the band itself.
    """
    library, ranking = evidence.library, Ranking(evidence)
    channel = CHANNELS[slots[0][1]]
    known = [h for h in (*library.hypotheses, *library.corrected) if h.name == (_BAND, channel)]
    library.met[channel] = SampleNoise(_stated_sigma(evidence, slots[0]))
    made = [library.trial(_BAND, channel, h.shape, h.places) for h in known]
    trials = [trial for trial in made if trial is not None]
    if not trials:
        return None
    without = ranking.fit_of(rest, fit)
    look = Look(evidence, without, fit.noise)
    finest = ranking.shapes.refine(max(trials, key=look.gain), without, look)
    return ranking.score(finest, without, rest)


def _with_edge_noise(evidence: Evidence, band: Scored, slot: Slot) -> float:
    """Return the log-likelihood [nats] of what a band leaves of a slot, in the noise that it makes of the stated."""
    scene, sigma = evidence.library.scenes[slot[0]], _stated_sigma(evidence, slot)
    noise = getattr(scene.model.noise, CHANNELS[slot[1]])
    times = read_sigma(scene.acting(slot[1]), sigma, band.hypothesis.shape["half_width"]) / sigma
    power = evidence.read_with(slot, noise.model_copy(update={"white": times * noise.white}))
    return log_likelihood(evidence, band.fit, {slot: power})


def _stated_sigma(evidence: Evidence, slot: Slot) -> float:
    """Return the 1σ of the stated white noise of a single sample [y]."""
    scene = evidence.library.scenes[slot[0]]
    white = float(getattr(scene.model.noise, CHANNELS[slot[1]]).white)
    return white / math.sqrt(scene.seen.interval_s)
