"""Whether what a fit leaves comes and goes: noise goes on all the time, and what drives structure does not.

Structure that a wide noise model has swallowed shows so. The rounding errors of a readout in coarse steps come and go
themselves, with the motion that they round: what they do is simulated, and only what is beyond it counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import idct

from inertial.documents import CHANNELS, ChannelNoise
from simulators.discrepancy.candidates import Slot, to_cosine
from simulators.discrepancy.evidence import Evidence, Fit
from simulators.discrepancy.rounding_errors import rounding_errors
from simulators.discrepancy.whitening import FREE_SHARE, SWAY, WIDE, freely_rounded_hz

Array = NDArray[np.float64]

MARGIN = 7.0
"""Evidence [nats] that power varies with time more than that of steady noise does: once in a thousand records."""
_SHARE_SEEN = 0.8  # of a block that must have been measured
_COEFFICIENTS = 8  # that make up one block's power
_FEWEST = 4  # blocks of a band
_FIRST, _HIGHEST_HZ = 32, 5.0
_FROM = 0.25  # of the frequency from which rounding errors show, from which they come and go
_CLIP = 3.5  # σ of a sample beyond which it is an outlier, which says nothing of structure
_PARTS = np.linspace(0.0, 0.98, 15)  # of a block's power that a sway may have
_LEAST = (0.25, 0.1)  # of the noise that is stated, which there is at least


@dataclass(frozen=True)
class Unsteady:
    """A channel whose remainder has more power at some times than at others, most at ``at_s``, by ``nats``."""

    channel: str
    at_s: float
    nats: float


def find_unsteady(evidence: Evidence, fit: Fit) -> list[Unsteady]:
    """Return the slots whose whitened remainder is not steady, in some band from zero up."""
    found = [_of_slot(evidence, fit, slot) for slot in evidence.slots]
    return [one for one in found if one.nats > MARGIN]


def unsteady_nats(evidence: Evidence, fit: Fit, slot: Slot, silenced: NDArray[np.bool_] | None = None) -> float:
    """Return the evidence [nats] that what a fit leaves of a slot is not steady, but for the samples (n,) silenced."""
    return _of_slot(evidence, fit, slot, silenced).nats


def _of_slot(evidence: Evidence, fit: Fit, slot: Slot, silenced: NDArray[np.bool_] | None = None) -> Unsteady:
    basis, scene = evidence.basis[slot], evidence.library.scenes[slot[0]]
    left = idct(evidence.library.left(slot, fit.ids, fit.amplitude), norm="ortho")
    gone = scene.data.missing[:, slot[1]] if silenced is None else silenced
    came = ~(gone | scene.shaking())[: basis.n * scene.group]
    noise = _least_noise(evidence, fit, slot)
    rounded_hz = freely_rounded_hz(noise, basis.interval_s)
    bands = _bands(basis.n, basis.interval_s)
    penalty = math.log(max(len(bands), 1) * len(CHANNELS))
    leans = _leans(evidence, fit, slot)
    least = basis.each(evidence.resolved[slot] / fit.noise[slot].power)
    ratio, freedom, places = _by_band(clipped_white(evidence, fit, slot, left), came, bands, least, leans)
    nats = _beyond_chance(ratio, freedom, 2.0 * freedom)
    rounded = bands > _FROM * 2.0 * basis.n * basis.interval_s * rounded_hz
    if np.max(nats[rounded], initial=0.0) > MARGIN + penalty:
        expected = _by_rounding(evidence, fit, slot, noise, came, bands[rounded], least)
        nats[rounded] = _beyond_chance(ratio[rounded], *expected)
    best = int(np.argmax(nats)) if bands.size else 0
    nats, places = (np.append(values, 0.0) for values in (nats, places))
    when_s = float(scene.time_s[0] + places[best] * (scene.time_s[-1] - scene.time_s[0]))
    return Unsteady(CHANNELS[slot[1]], when_s, float(nats[best]) - penalty)


def _bands(count: int, interval_s: float) -> NDArray[np.int64]:
    """Return how many coefficients from zero up each band has."""
    doubled = _FIRST * 2 ** np.arange(32, dtype=np.int64)
    return doubled[doubled < min(count // 4, 2.0 * count * interval_s * _HIGHEST_HZ)]


def clipped_white(evidence: Evidence, fit: Fit, slot: Slot, left: Array) -> Array:
    """Return the whitened coefficients (n,) of what is left (n,), outliers clipped."""
    weight = evidence.basis[slot].each(fit.noise[slot].power ** -0.5)
    return to_cosine(np.clip(idct(to_cosine(left) * weight, norm="ortho"), -_CLIP, _CLIP))


def _leans(evidence: Evidence, fit: Fit, slot: Slot) -> Array | None:
    """Return how much of a tilt's power (n,) an accelerometer would feel, where its mount sways; else none.

    A tilt turns gravity away from its direction: of that the axis which points along it feels nothing.
    """
    if slot[1] > 2 or fit.noise[slot].level not in (SWAY, WIDE):
        return None
    scene = evidence.library.scenes[slot[0]]
    force = np.stack([scene.analysed(scene.predicted[:, c], c) for c in range(3)])
    return np.asarray(1.0 - np.square(force[slot[1]]) / np.maximum(np.sum(np.square(force), axis=0), 1e-300))


def _by_band(
    white: Array, came: NDArray[np.bool_], bands: NDArray[np.int64], least: Array, leans: Array | None = None
) -> tuple[Array, Array, Array]:
    """Return of each band the likelihood ratio [2 nats] of power that varies from block to block, of how many blocks.

    And where along the record power is most. Below the ``least`` (n,) that can be told it is not known to vary. As
    great a part of it as may be varies with ``leans`` (n,), as sway does.
    """
    ratio, freedom, places = (np.zeros(len(bands)) for _ in range(3))
    for band, highest in enumerate(bands.tolist()):
        count = highest // _COEFFICIENTS
        padded = np.zeros(8 * highest)
        padded[2:highest] = white[2:highest]
        power = np.square(idct(padded, norm="ortho")).reshape(count, -1).mean(axis=1)
        seen = np.array([part.mean() for part in np.array_split(came, count)]) > _SHARE_SEEN
        if seen.sum() < _FEWEST:
            continue
        power = np.maximum(power[seen], float(np.sum(least[2:highest])) / padded.size)
        power = power / float(power.mean())
        if leans is not None:
            power = _steadied(power, np.array([part.mean() for part in np.array_split(leans, count)])[seen])
        ratio[band] = _COEFFICIENTS * float(np.sum(power - 1.0 - np.log(np.maximum(power, 1e-12))))
        freedom[band] = power.size
        places[band] = (int(np.flatnonzero(seen)[int(np.argmax(power))]) + 0.5) / count
    return ratio, freedom, places


def _steadied(power: Array, leans: Array) -> Array:
    """Return the power of blocks (k,) over what it is expected to be if the likeliest part of it is a sway's."""
    swaying = leans / max(float(leans.mean()), 1e-300)
    models = [1.0 + part * (swaying - 1.0) for part in _PARTS]
    model = min(models, key=lambda one: float(np.sum(np.log(one) + power / one)))
    steady = power / model
    return np.asarray(steady / float(steady.mean()))


def _by_rounding(
    evidence: Evidence,
    fit: Fit,
    slot: Slot,
    noise: ChannelNoise,
    came: NDArray[np.bool_],
    bands: NDArray[np.int64],
    least: Array,
) -> tuple[Array, Array]:
    """Return mean and variance of the likelihood ratio by band that rounding errors alone make of the same motion."""
    scene, spread = evidence.library.scenes[slot[0]], evidence.library.spread[slot]
    errors = rounding_errors(scene, slot[1], noise)
    ratios = [_by_band(clipped_white(evidence, fit, slot, left / spread), came, bands, least)[0] for left in errors]
    return np.mean(ratios, axis=0), np.var(ratios, axis=0, ddof=1)


def _least_noise(evidence: Evidence, fit: Fit, slot: Slot) -> ChannelNoise:
    """Return the noise with as little white noise as there may be; the less, the less it jolts a readout in steps.

    Where rounding is lost in any what is left shows it; of noise of which the model knows the size about, so does that.
    """
    basis, model = evidence.basis[slot], evidence.library.scenes[slot[0]].model
    noise: ChannelNoise = getattr(model.noise, CHANNELS[slot[1]])
    most = FREE_SHARE if model.noise.free else 1.0
    power = basis.stated(noise, 0.0)
    found = most
    for least in _LEAST:
        slow = basis.frequency_hz < freely_rounded_hz(
            noise.model_copy(update={"white": least * noise.white}), basis.interval_s
        )
        slow[0] = False  # a bias
        count = float(basis.counts[slow].sum())
        if not count or not power[slow].all():
            break
        share = math.sqrt(float(np.sum(fit.rss[slot][slow] / power[slow])) / count)
        found = min(max(share, least), most)
        if share >= least:
            break
    return noise.model_copy(update={"white": found * noise.white})


def _beyond_chance(ratio: Array, mean: Array, variance: Array) -> Array:
    """Return a bound on -ln of the chance that a multiple of χ², of such a mean and variance, is as large (Chernoff).

    What multiple, and of what freedom, is by Satterthwaite (1946).
    """
    scale = np.maximum(variance / np.maximum(2.0 * mean, 1e-300), 1.0)
    excess = np.maximum(ratio / np.maximum(mean, 1e-300), 1.0)
    return np.asarray(0.5 * mean / scale * (excess - 1.0 - np.log(excess)))
