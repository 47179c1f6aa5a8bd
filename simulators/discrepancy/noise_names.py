"""Noise larger than the model states: which term of IEEE 952 it is, a mount that sways, or of none of their colours."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.fft import idct

from inertial.documents import CHANNELS, ChannelNoise
from simulators.discrepancy.candidates import Slot
from simulators.discrepancy.evidence import Evidence, Fit, bayes_factor
from simulators.discrepancy.margins import TIE
from simulators.discrepancy.mount_sway import FEWEST, Sway, find_sway
from simulators.discrepancy.noise_likelihood import log_likelihood, most_likely, start_of
from simulators.discrepancy.readout import as_read
from simulators.discrepancy.resolution import AS_STATED, coarser, last_place
from simulators.discrepancy.whitening import SWAY, WIDE, ease, fit_noise

Array = NDArray[np.float64]

TERMS = {
    "random_walk": ("coefficient", ChannelNoise(white=1.0)),
    "bias_instability": ("coefficient", ChannelNoise(flicker=1.0)),
    "rate_random_walk": ("coefficient", ChannelNoise(random_walk=1.0)),
    "quantisation": ("step", ChannelNoise(quantisation=1.0)),
}
"""Effect, its parameter, and unit noise of its kind."""
MARGIN = 7.0
"""Bayes factor [nats] that a term must have."""
CERTAIN = 3.5
"""... one of slow noise that is certain, as no colour explains it otherwise: few coefficients tell which it is."""
OTHER_COLOUR = 12.0
"""What the wide family must gain over the named terms [nats] for the noise to be of another colour."""
SEEN = 50.0
"""Evidence [nats] of what the increments themselves show."""
_PLACES = 24.0
_OF_SAMPLES = ("random_walk", "quantisation")  # whose size is that of single samples
_LEVEL_SIGMAS = 3.0
_MOST = 2  # terms of a channel
_OF_TOTAL = 0.02  # of what they gain, which they may leave to noise of another colour
_JOLTS = (0.7, 1.1, 21)  # shares of white noise that may be right when rounding goes with it: from, to, how many
_STIRS = (0.1, 0.3, 1.0)  # shares of a sway's rate that may stir a readout in steps
_NONE = np.zeros(0)
_LOWER, _ODD = 0.9, 1.3  # of the power with named terms: noise that is less, and bins that have more


@dataclass(frozen=True)
class NoiseFinding:
    """A noise term that is larger than stated."""

    effect: str
    channel: str
    value: float
    sigma: float
    gain: float
    score: float
    ties: tuple[str, ...]


@dataclass(frozen=True)
class LargerNoise:
    """Noise of which terms are larger than stated, or of a model that leaves its size free than in its proportions.

    ``value``: log-likelihood of a slot [nats] less the price of the terms, minus infinity where the model says nothing
    of its noise; ``names``: of the one term that is enough, and of those that tie with it; ``certain``: whether its
    course alone, without the mean, would have it named; ``noise``: what is stated with the terms.
    """

    value: float
    names: tuple[str, ...]
    certain: bool
    noise: ChannelNoise


@dataclass(frozen=True)
class OtherNoise:
    """Noise on a channel that the named terms do not explain: what the wide family gains over them [nats], where."""

    channel: str
    gain: float
    band_hz: tuple[float, float]


@dataclass(frozen=True)
class NamedNoise:
    """Terms larger than stated, noise of no colour in the library, and the sway of the mount that goes with them.

    ``swaying``: the sway's power by slot (b,).
    """

    found: list[NoiseFinding]
    other: list[OtherNoise]
    sway: Sway | None
    swaying: dict[Slot, Array]

    @property
    def evidence_nats(self) -> float:
        """Return what all of it together explains."""
        swayed = 0.0 if self.sway is None else sum(self.sway.evidence_nats.values())
        return swayed + sum(one.score for one in self.found)


def name_noise(evidence: Evidence, fit: Fit, margin: float = MARGIN) -> NamedNoise:
    """Return what noise there is beyond what is stated.

    Several channels that sway at one correlation time are the mount's and not the block's, if that explains more than
    larger noise of each does, named or of a colour of its own.
    """
    slots = [slot for slot in evidence.slots if evidence.stated[slot] is not None]
    block = _explained(evidence, fit, slots, None, margin)
    if sum(fit.noise[slot].level in (SWAY, WIDE) for slot in slots) < FEWEST:
        return block
    power = {slot: _eased(evidence, fit, slot) for slot in slots}
    sway = find_sway(evidence, fit, power, _of_their_own(evidence, fit, power, block))
    if sway is None:
        return block
    mount = _explained(evidence, fit, slots, sway, margin)
    return mount if mount.evidence_nats > block.evidence_nats + margin else block


def larger_noise(evidence: Evidence, fit: Fit, slot: Slot) -> LargerNoise:
    """Return what noise of which terms are larger than stated makes of one slot's part of a fit."""
    return evidence.once(fit, ("larger noise", slot), partial(_larger_noise, evidence, fit, slot))


def _larger_noise(evidence: Evidence, fit: Fit, slot: Slot) -> LargerNoise:
    noise, shape = getattr(evidence.library.scenes[slot[0]].model.noise, CHANNELS[slot[1]]), evidence.basis[slot].shape
    if evidence.stated[slot] is not None:
        power = {slot: _eased(evidence, fit, slot)}
    elif shape is not None:
        power = {slot: evidence.quiet(slot, fit.rss[slot]).power}
        noise = _times(noise, math.sqrt(float(np.median(power[slot] / shape))))
    else:
        return LargerNoise(-math.inf, (), False, noise)
    nothing = {slot: np.zeros((len(power[slot]), 0))}
    tails = max(evidence.scatter(slot), _tails(evidence, fit, slot))
    found, power, _ = _named(evidence, fit, power, nothing, _NONE, tails, 0.0)
    price = sum(one.gain - one.score for one in found)
    each = evidence.basis[slot].counts * np.log(power[slot]) + fit.rss[slot] / power[slot]
    names = tuple(name for one in found for name in (one.effect, *one.ties)) if len(found) == 1 else ()
    certain = any(one.score > MARGIN for one in found)
    for one in found:
        (term,) = TERMS[one.effect][1].model_fields_set
        noise = noise.model_copy(update={term: math.hypot(getattr(noise, term), one.value)})
    return LargerNoise(float(-0.5 * evidence.came[slot] @ each) - price, names, certain, noise)


def _times(noise: ChannelNoise, factor: float) -> ChannelNoise:
    """Return noise so many times as large in proportion, read in the same steps."""
    sizes = {term: factor * getattr(noise, term) for term in ("white", "flicker", "random_walk")}
    return noise.model_copy(update=sizes)


def _of_their_own(evidence: Evidence, fit: Fit, power: dict[Slot, Array], block: NamedNoise) -> dict[str, float]:
    """Return the evidence [nats] of noise that each channel has of its own: terms with a name, or any colour."""
    found = {}
    for channel in {slot[1] for slot in power}:
        mine = {slot: now for slot, now in power.items() if slot[1] == channel}
        free = log_likelihood(evidence, fit, {slot: _free(evidence, fit, slot) for slot in mine}) - log_likelihood(
            evidence, fit, mine
        )
        named = sum(one.score for one in block.found if one.channel == CHANNELS[channel])
        found[CHANNELS[channel]] = max(free - OTHER_COLOUR, named)
    return found


def _explained(evidence: Evidence, fit: Fit, slots: list[Slot], sway: Sway | None, margin: float) -> NamedNoise:
    named = NamedNoise([], [], sway, {})
    for channel, name in enumerate(CHANNELS):
        mine = [slot for slot in slots if slot[1] == channel]
        if mine:
            felt = sway.columns if sway is not None and name in sway.evidence_nats else {}
            columns = {slot: felt[slot] for slot in mine if slot in felt}
            terms, strange, swaying = _of_channel(evidence, fit, mine, columns, margin)
            named.found.extend(terms)
            named.other.extend(strange)
            named.swaying.update(swaying)
    return named


def _eased(evidence: Evidence, fit: Fit, slot: Slot) -> Array:
    """Return the stated power (b,), less where its readout is finer or its samples leave less."""
    return ease(as_read(evidence, fit, slot), _free(evidence, fit, slot), evidence.eased[slot])


def _free(evidence: Evidence, fit: Fit, slot: Slot) -> Array:
    basis = evidence.basis[slot]
    return fit_noise(basis, fit.rss[slot], basis.counts, None, evidence.floor[slot]).power


def _of_channel(
    evidence: Evidence, fit: Fit, slots: list[Slot], columns: dict[Slot, Array], margin: float
) -> tuple[list[NoiseFinding], list[OtherNoise], dict[Slot, Array]]:
    """Return the terms of a channel, its noise of another colour, and the power (b,) that a sway's columns have.

    ``columns`` (b, k) of the sway by slot, if the channel feels one.
    """
    free = {slot: _free(evidence, fit, slot) for slot in slots}
    wide = log_likelihood(evidence, fit, free)
    power = {slot: _eased(evidence, fit, slot) for slot in slots}
    swayed = _NONE
    if columns:
        power, swayed = _stirred(evidence, fit, power, columns)
    still = columns or {slot: np.zeros((len(power[slot]), 0)) for slot in slots}
    scatter = max(evidence.scatter(slot) for slot in slots)
    tails = max(scatter, *(_tails(evidence, fit, slot) for slot in slots))
    found, power, swayed = _named(evidence, fit, power, still, swayed, tails, margin)
    swaying = {slot: still[slot] @ swayed for slot in slots}
    if [one.effect for one in found] == ["random_walk"]:
        found, power = _jolted(evidence, fit, found[0], power, swaying)
    whole = {slot: ease(p + swaying[slot], free[slot], evidence.eased[slot]) for slot, p in power.items()}
    gained = wide - log_likelihood(
        evidence, fit, {slot: _levelled(evidence, fit, slot, p, tails) for slot, p in whole.items()}
    )
    total = sum(f.gain for f in found)
    lower = all(np.median(fit.noise[slot].power / whole[slot]) < _LOWER for slot in slots)
    if gained / scatter < OTHER_COLOUR + _OF_TOTAL * total or lower:
        return found, [], swaying
    if not found and margin > CERTAIN:
        slow = _of_channel(evidence, fit, slots, columns, CERTAIN)
        if slow[0] and not any(one.effect in _OF_SAMPLES for one in slow[0]):
            return slow
    return [], [OtherNoise(_channel_of(slots), gained + total, _band_hz(evidence, fit, slots[0], whole[slots[0]]))], {}


def _stirred(
    evidence: Evidence, fit: Fit, power: dict[Slot, Array], columns: dict[Slot, Array]
) -> tuple[dict[Slot, Array], Array]:
    """Return the power beside a sway and the sway's variances (k,).

    A sway moves a readout in steps from one to the next and so whitens its rounding, as much as white noise of some
    share of its size would.
    """
    best, variances = power, most_likely(evidence, fit, power, columns, start_of(evidence, fit, power, columns))
    size = {slot: float(evidence.basis[slot].counts @ (columns[slot] @ variances)) for slot in power}
    for share in _STIRS:
        stirred = dict(power)
        for slot in power:
            basis = evidence.basis[slot]
            rate = share**2 * size[slot] / basis.n
            whiter = evidence.jolted(slot, math.sqrt(rate * basis.interval_s))
            if whiter is not None:
                stirred[slot] = whiter - rate * basis.white_filled
        found = most_likely(evidence, fit, stirred, columns, variances)
        if log_likelihood(evidence, fit, _summed(stirred, columns, found)) > log_likelihood(
            evidence, fit, _summed(best, columns, variances)
        ):
            best, variances = stirred, found
    return best, variances


def _named(
    evidence: Evidence,
    fit: Fit,
    power: dict[Slot, Array],
    columns: dict[Slot, Array],
    swayed: Array,
    tails: float,
    margin: float,
) -> tuple[list[NoiseFinding], dict[Slot, Array], Array]:
    """Return the terms, two at most, that a channel has more of, its power with them, and the sway's variances then."""
    found: list[NoiseFinding] = []
    steps = [step for slot in power if (step := coarser(evidence.library.scenes[slot[0]], slot[1])) is not None]
    as_stated = any(abs(step - 1.0) <= AS_STATED for step in steps)
    if steps and min(steps) > 1.0 + AS_STATED:
        coarse, power = _coarse(evidence, fit, power, min(steps))
        found = [coarse]
    value = log_likelihood(evidence, fit, _summed(power, columns, swayed))
    while len(found) < _MOST:
        trials = []
        for effect, (_, unit) in TERMS.items():
            if effect in [f.effect for f in found] or (effect == "quantisation" and as_stated):
                continue
            units = {slot: evidence.basis[slot].stated(unit, 0.0) for slot in power}
            beside = {slot: np.column_stack([columns[slot], units[slot]]) for slot in power}
            start = np.append(swayed, _start(evidence, fit, _summed(power, columns, swayed), units))
            variances = most_likely(evidence, fit, power, beside, start)
            gain = log_likelihood(evidence, fit, _summed(power, beside, variances)) - value
            certain = gain / tails if effect in _OF_SAMPLES else gain
            trials.append((bayes_factor(certain, 1, _PLACES), gain, effect, variances, beside))
        # What tails make less certain is how much there is; which of those that there are it is says the likelihood.
        there = [trial for trial in trials if trial[0] >= margin]
        if not there:
            break
        score, gain, effect, variances, beside = max(there, key=lambda trial: trial[1])
        ties = tuple(t[2] for t in trials if t[2] != effect and _surplus(gain, effect, t[1], t[2], tails) < TIE)
        size = math.sqrt(float(variances[-1]))
        sigma = _sigma(evidence, _summed(power, beside, variances), beside) / (2.0 * size)
        sigma *= math.sqrt(tails) if effect in _OF_SAMPLES else 1.0
        found.append(NoiseFinding(effect, _channel_of(power), size, sigma, gain, score, ties))
        power = {slot: now + variances[-1] * beside[slot][:, -1] for slot, now in power.items()}
        swayed, value = variances[:-1], value + gain
    return found, power, swayed


def _surplus(gain: float, effect: str, other_gain: float, other: str, tails: float) -> float:
    """Return how much more [nats] a term explains than another, sizes of single samples as certain as tails leave."""
    return (gain - other_gain) / (tails if {effect, other} & {*_OF_SAMPLES} else 1.0)


def _channel_of(slots: Iterable[Slot]) -> str:
    """Return the channel of slots that are all of one."""
    return CHANNELS[next(iter(slots))[1]]


def _summed(power: Mapping[Slot, Array], columns: Mapping[Slot, Array], variances: Array) -> dict[Slot, Array]:
    return {slot: now + columns[slot] @ variances for slot, now in power.items()}


def _jolted(
    evidence: Evidence, fit: Fit, white: NoiseFinding, power: dict[Slot, Array], swaying: dict[Slot, Array]
) -> tuple[list[NoiseFinding], dict[Slot, Array]]:
    """Return larger white noise, and the power with it, as the rounding that it jolts shows it, if that is likelier."""

    def with_more(value: float) -> dict[Slot, Array]:
        jolted = {slot: evidence.jolted(slot, value) for slot in power}
        return {slot: now if (other := jolted[slot]) is None else other for slot, now in power.items()}

    def likelihood(value: float) -> float:
        return log_likelihood(evidence, fit, {slot: now + swaying[slot] for slot, now in with_more(value).items()})

    values = white.value * np.linspace(*_JOLTS)
    value = max(values.tolist(), key=likelihood)
    if likelihood(value) > log_likelihood(evidence, fit, {slot: now + swaying[slot] for slot, now in power.items()}):
        return [replace(white, value=value, sigma=white.sigma * white.value / value)], with_more(value)
    return [white], power


def _band_hz(evidence: Evidence, fit: Fit, slot: Slot, power: Array) -> tuple[float, float]:
    """Return where a slot's noise is larger than named terms make it; the whole band if nowhere by much."""
    frequency = evidence.basis[slot].frequency_hz
    odd = frequency[fit.rss[slot] / evidence.basis[slot].counts / power > _ODD]
    return (float(odd.min()), float(odd.max())) if odd.size else (0.0, float(frequency[-1]))


def _coarse(
    evidence: Evidence, fit: Fit, power: dict[Slot, Array], times: float
) -> tuple[NoiseFinding, dict[Slot, Array]]:
    """Return the finding of a step so many times the stated one, as the increments show it, and the power with it."""
    scene, column = next((evidence.library.scenes[slot[0]], slot[1]) for slot in power)
    stated = getattr(scene.model.noise, CHANNELS[column]).quantisation
    beyond = stated * math.sqrt(times**2 - 1.0)
    unit = TERMS["quantisation"][1]
    changed = {slot: now + beyond**2 * evidence.basis[slot].stated(unit, 0.0) for slot, now in power.items()}
    larger = getattr(scene.model.noise, CHANNELS[column]).model_copy(update={"quantisation": times * stated})
    read = {slot: evidence.read_with(slot, larger) for slot in power}
    changed = max(changed, read, key=lambda one: log_likelihood(evidence, fit, one))
    sigma = last_place(column) * times * stated / beyond
    gain = log_likelihood(evidence, fit, changed) - log_likelihood(evidence, fit, power)
    return NoiseFinding("quantisation", CHANNELS[column], beyond, sigma, gain, max(gain, SEEN), ()), changed


def _tails(evidence: Evidence, fit: Fit, slot: Slot) -> float:
    """Return by how much heavy tails raise the variance of a variance found from samples: 1 + excess kurtosis / 2."""
    left = evidence.library.left(slot, fit.ids, fit.amplitude)
    white = idct(left * evidence.basis[slot].each(fit.noise[slot].power ** -0.5), norm="ortho")
    square = float(np.mean(white**2))
    return max(1.0, 0.5 * (float(np.mean(white**4)) / square**2 - 1.0)) if square > 0.0 else 1.0


def _levelled(evidence: Evidence, fit: Fit, slot: Slot, power: Array, tails: float) -> Array:
    """Return the power (b,) at the level that fits best among those that its samples leave open."""
    counts = evidence.basis[slot].counts
    off = _LEVEL_SIGMAS * math.sqrt(2.0 * tails / float(counts.sum()))
    level = float(np.sum(fit.rss[slot] / power) / counts.sum())
    return np.asarray(power * np.clip(level, 1.0 - off, 1.0 + off))


def _start(evidence: Evidence, fit: Fit, power: Mapping[Slot, Array], columns: Mapping[Slot, Array]) -> float:
    """Return a variance of one term (b,) on top of ``power`` that is not too small, from which to climb."""
    beyond = {s: np.maximum(fit.rss[s] / evidence.basis[s].counts - power[s], 0.0) / columns[s] for s in power}
    least = 1e-6 * min(float(np.min(power[s] / columns[s])) for s in power)
    return max(least, *(float(np.quantile(share, 0.3)) for share in beyond.values()))


def _sigma(evidence: Evidence, power: Mapping[Slot, Array], columns: Mapping[Slot, Array]) -> float:
    """Return the 1σ of the last column's variance beside the others', from their Fisher information."""
    information = sum(
        0.5 * (columns[slot] * (evidence.basis[slot].counts / now**2)[:, None]).T @ columns[slot]
        for slot, now in power.items()
    )
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information * np.outer(scale, scale))
    return float(scale[-1] * math.sqrt(inverse[-1, -1]))
