"""Noise larger than the model states: which term of IEEE 952 it is, or that it is of none of their colours."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import idct

from inertial.documents import CHANNELS, ChannelNoise
from simulators.discrepancy.candidates import Slot
from simulators.discrepancy.evidence import Evidence, Fit, bayes_factor
from simulators.discrepancy.resolution import AS_STATED, coarser, last_place
from simulators.discrepancy.whitening import ease, fit_noise

Array = NDArray[np.float64]

TERMS = {
    "random_walk": ("coefficient", ChannelNoise(white=1.0)),
    "bias_instability": ("coefficient", ChannelNoise(flicker=1.0)),
    "rate_random_walk": ("coefficient", ChannelNoise(random_walk=1.0)),
    "quantisation": ("step", ChannelNoise(quantisation=1.0)),
}
"""Effect, its parameter, and unit noise of its kind."""
MARGIN = 7.0
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
class OtherNoise:
    """Noise on a channel that the named terms do not explain: what the wide family gains over them [nats], where."""

    channel: str
    gain: float
    band_hz: tuple[float, float]


def name_noise(evidence: Evidence, fit: Fit, margin: float = MARGIN) -> tuple[list[NoiseFinding], list[OtherNoise]]:
    """Return the noise terms larger than stated, and channels whose noise is of no colour in the library."""
    found: list[NoiseFinding] = []
    other: list[OtherNoise] = []
    for channel in range(len(CHANNELS)):
        slots = [slot for slot in evidence.slots if slot[1] == channel and evidence.stated[slot] is not None]
        if slots:
            terms, strange = _of_channel(evidence, fit, slots, CHANNELS[channel], margin)
            found += terms
            other += strange
    return found, other


def _of_channel(
    evidence: Evidence, fit: Fit, slots: list[Slot], channel: str, margin: float
) -> tuple[list[NoiseFinding], list[OtherNoise]]:
    power: dict[Slot, Array] = {}
    free: dict[Slot, Array] = {}
    wide = 0.0
    for slot in slots:
        basis, rss, stated = evidence.basis[slot], fit.rss[slot], evidence.stated[slot]
        assert stated is not None
        free[slot] = fit_noise(basis, rss, basis.counts, None, evidence.floor[slot]).power
        wide += _whittle(rss, basis.counts, free[slot])
        power[slot] = ease(stated, free[slot], evidence.eased[slot])
    scatter = max(evidence.scatter(slot) for slot in slots)
    tails = max(scatter, *(_tails(evidence, fit, slot) for slot in slots))
    found, power = _named(evidence, fit, power, tails, margin)
    if [one.effect for one in found] == ["random_walk"]:
        found, power = _jolted(evidence, fit, found[0], power)
    power = {slot: ease(p, free[slot], evidence.eased[slot]) for slot, p in power.items()}
    gained = wide - _total(evidence, fit, {slot: _levelled(evidence, fit, slot, p, tails) for slot, p in power.items()})
    total = sum(f.gain for f in found)
    lower = all(np.median(fit.noise[slot].power / power[slot]) < _LOWER for slot in slots)
    if gained / scatter < OTHER_COLOUR + _OF_TOTAL * total or lower:
        return found, []
    return [], [OtherNoise(channel, gained + total, _band_hz(evidence, fit, slots[0], power[slots[0]]))]


def _named(
    evidence: Evidence, fit: Fit, power: dict[Slot, Array], tails: float, margin: float
) -> tuple[list[NoiseFinding], dict[Slot, Array]]:
    """Return the terms, two at most, that a channel has more of, and its power with them."""
    found: list[NoiseFinding] = []
    steps = [step for slot in power if (step := coarser(evidence.library.scenes[slot[0]], slot[1])) is not None]
    as_stated = any(abs(step - 1.0) <= AS_STATED for step in steps)
    if steps and min(steps) > 1.0 + AS_STATED:
        coarse, power = _coarse(evidence, fit, power, min(steps))
        found = [coarse]
    channel, value = next(CHANNELS[slot[1]] for slot in power), _total(evidence, fit, power)
    while len(found) < _MOST:
        trials = []
        for effect, (_, unit) in TERMS.items():
            if effect in [f.effect for f in found] or (effect == "quantisation" and as_stated):
                continue
            variance = _best(evidence, fit, power, unit)
            changed = {slot: now + variance * evidence.basis[slot].stated(unit, 0.0) for slot, now in power.items()}
            gain = _total(evidence, fit, changed) - value
            certain = gain / tails if effect in _OF_SAMPLES else gain
            trials.append((bayes_factor(certain, 1, _PLACES), gain, effect, variance, changed))
        trials.sort(key=lambda trial: -trial[0])
        score, gain, effect, variance, changed = trials[0]
        if score < margin:
            break
        ties = tuple(t[2] for t in trials[1:] if t[0] > score - 3.0)
        size = math.sqrt(variance)
        sigma = _sigma(evidence, changed, TERMS[effect][1]) / (2.0 * size)
        sigma *= math.sqrt(tails) if effect in _OF_SAMPLES else 1.0
        found.append(NoiseFinding(effect, channel, size, sigma, gain, score, ties))
        power, value = changed, value + gain
    return found, power


def _jolted(
    evidence: Evidence, fit: Fit, white: NoiseFinding, power: dict[Slot, Array]
) -> tuple[list[NoiseFinding], dict[Slot, Array]]:
    """Return larger white noise, and the power with it, as the rounding that it jolts shows it, if that is likelier."""

    def with_more(value: float) -> dict[Slot, Array]:
        jolted = {slot: evidence.jolted(slot, value) for slot in power}
        return {slot: now if (other := jolted[slot]) is None else other for slot, now in power.items()}

    values = white.value * np.linspace(*_JOLTS)
    value = max(values.tolist(), key=lambda one: _total(evidence, fit, with_more(one)))
    if _total(evidence, fit, with_more(value)) > _total(evidence, fit, power):
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
    changed = max(changed, read, key=lambda one: _total(evidence, fit, one))
    sigma = last_place(column) * times * stated / beyond
    gain = _total(evidence, fit, changed) - _total(evidence, fit, power)
    return NoiseFinding("quantisation", CHANNELS[column], beyond, sigma, gain, max(gain, SEEN), ()), changed


def _tails(evidence: Evidence, fit: Fit, slot: Slot) -> float:
    """Return by how much heavy tails raise the variance of a variance found from samples: 1 + excess kurtosis / 2."""
    left = evidence.library.left(slot, fit.ids, fit.amplitude)
    white = idct(left * evidence.basis[slot].each(fit.noise[slot].power ** -0.5), norm="ortho")
    kurtosis = float(np.mean(white**4) / np.mean(white**2) ** 2)
    return max(1.0, 0.5 * (kurtosis - 1.0))


def _levelled(evidence: Evidence, fit: Fit, slot: Slot, power: Array, tails: float) -> Array:
    """Return the power (b,) at the level that fits best among those that its samples leave open."""
    counts = evidence.basis[slot].counts
    off = _LEVEL_SIGMAS * math.sqrt(2.0 * tails / float(counts.sum()))
    level = float(np.sum(fit.rss[slot] / power) / counts.sum())
    return np.asarray(power * np.clip(level, 1.0 - off, 1.0 + off))


def _whittle(rss: Array, counts: Array, power: Array) -> float:
    """Return the log-likelihood of all but the mean, which tells of a bias and not of noise."""
    rss, counts, power = rss[1:], counts[1:], power[1:]
    return float(-0.5 * np.sum(counts * np.log(power) + rss / power))


def _total(evidence: Evidence, fit: Fit, power: dict[Slot, Array]) -> float:
    return sum(_whittle(fit.rss[slot], evidence.basis[slot].counts, p) for slot, p in power.items())


def _best(evidence: Evidence, fit: Fit, power: dict[Slot, Array], unit: ChannelNoise) -> float:
    """Return the variance of one term that is most likely on top of ``power``, by Fisher scoring from above."""
    columns = {slot: evidence.basis[slot].stated(unit, 0.0) for slot in power}
    start = [
        float(np.quantile(np.maximum(fit.rss[s] / evidence.basis[s].counts - power[s], 0.0) / columns[s], 0.3))
        for s in power
    ]
    variance = max(*start, 1e-300) if len(start) > 1 else max(start[0], 1e-300)
    variance = max(variance, 1e-6 * min(float(np.min(power[s] / columns[s])) for s in power))
    for _ in range(200):
        up = down = 0.0
        for slot, column in columns.items():
            now = power[slot] + variance * column
            up += float(np.sum((column * fit.rss[slot] / now**2)[1:]))
            down += float(np.sum((column * evidence.basis[slot].counts / now)[1:]))
        ratio = up / down
        variance *= ratio
        if abs(ratio - 1.0) < 1e-5:
            break
    return variance


def _sigma(evidence: Evidence, power: dict[Slot, Array], unit: ChannelNoise) -> float:
    """Return the 1σ of the variance from its Fisher information."""
    information = 0.0
    for slot, now in power.items():
        column = evidence.basis[slot].stated(unit, 0.0)
        information += 0.5 * float(np.sum(evidence.basis[slot].counts * (column / now) ** 2))
    return 1.0 / math.sqrt(information)
