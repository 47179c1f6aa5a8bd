"""How wide a dead band is, read off the samples that it silenced and those beside them.

The search compares means, for which the noise must be known: where it is larger, a wider band does the same to them.
Each sample says more. Whether it is silent, and what it reads where it is not, depends on input, noise, width and the
rounding that follows; of these, noise and width are found together. Rounding an integral is that of Widrow and Kollár,
*Quantization Noise* (2008), noise with tails Tukey's contaminated normal (1960).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from inertial.documents import CHANNELS
from simulators.discrepancy.compare import SampleNoise, Scene
from simulators.normal import density

Array = NDArray[np.float64]
Tails = tuple[tuple[float, float], ...]

_FEWEST = 5  # silent samples that say anything
_NEAR, _FAR_SIGMAS = 2.0, 6.0  # widths and σ within which an input has to do with the band
_ALIKE = 0.05  # σ within which inputs are taken for one
_WIDTHS, _WIDEST = 31, 3.0  # tried, and by what factor they may be off what the means say
_NOISES, _NOISIEST = 13, 4.0  # ... the noise off what is stated, or what a record in coarse steps shows
_TAILS: Tails = ((0.0, 1.0), (0.01, 3.0), (0.05, 3.0), (0.2, 3.0), (0.01, 6.0), (0.05, 6.0))
"""Shares of samples that are so many times as noisy as the others."""
_PASSES = 4
_SURE = 12.0  # nats below the best beyond which nothing counts
_FINEST = 1e-3  # of the noise: a readout of no steps is finer than anything


@dataclass(frozen=True)
class HalfWidth:
    """A dead band's half-width ± ``sigma`` and the noise that it meets, with tails [y]."""

    value: float
    sigma: float
    noise: SampleNoise


def half_width(scenes: Sequence[Scene], channel: str, about: float) -> HalfWidth | None:
    """Return a dead band's half-width and the noise, by the likelihood of every sample near it.

    Rounding of an integral to steps reads an input of u steps as one of the two whole numbers beside it, the nearer
    the likelier; the fraction at which a sample begins is taken to be any.

    Parameters
    ----------
    scenes : of one block.
    channel : whose readout has the band.
    about : half-width to begin with [y].

    Returns
    -------
    The mean over the likelihood and its rms about it, the likeliest noise; none where hardly a sample is silent.
    """
    column = CHANNELS.index(channel)
    stated = getattr(scenes[0].model.noise, channel).white / math.sqrt(scenes[0].seen.interval_s)
    found = max(float(scene.noise_sigma[column]) for scene in scenes)
    sigma = max(found, stated)  # a band that silences most of a record leaves it little noise
    counted = [_counted(scene, column, about, sigma) for scene in scenes]
    inputs, readings, counts = (np.concatenate(part) for part in zip(*counted, strict=True))
    if counts[readings == 0.0].sum() < _FEWEST:
        return None
    step = max(getattr(scenes[0].model.noise, channel).quantisation / scenes[0].seen.interval_s, _FINEST * sigma)
    widths = np.geomspace(about / _WIDEST, about * _WIDEST, _WIDTHS)
    noises = np.geomspace(min(found, stated or found) / _NOISIEST, sigma * _NOISIEST, _NOISES)
    tails = _TAILS
    for _ in range(_PASSES):
        value = np.array([[_by_tails(inputs, readings, counts, step, n, w, tails) for w in widths] for n in noises])
        weight, likely = np.exp(value - value.max()), value > value.max() - _SURE
        finest = widths
        likeliest, _, tail = np.unravel_index(int(np.argmax(value)), value.shape)
        noise = SampleNoise(float(noises[likeliest]), *tails[int(tail)])
        tails = tuple(one for one, kept in zip(tails, likely.any(axis=(0, 1)), strict=True) if kept)
        noises, widths = (_closer(tried, likely.any(axis=(2, k))) for tried, k in ((noises, 1), (widths, 0)))
    share = weight.sum(axis=(0, 2)) / weight.sum()
    mean = float(share @ finest)
    spread = float(np.sqrt(share @ (finest - mean) ** 2 + (finest[1] - finest[0]) ** 2 / 12.0))
    return HalfWidth(mean, spread, noise)


def _closer(tried: Array, likely: NDArray[np.bool_]) -> Array:
    """Return as many values between the neighbours of those that are likely."""
    places = np.flatnonzero(likely)
    return np.linspace(tried[max(places[0] - 1, 0)], tried[min(places[-1] + 1, tried.size - 1)], tried.size)


def _counted(scene: Scene, column: int, about: float, sigma: float) -> tuple[Array, Array, Array]:
    """Return inputs near the band, what was read, and how many samples of a recording were so."""
    reading, acting = scene.measured[:, column], scene.acting(column)
    near = ~scene.data.missing[:, column] & (np.abs(acting) < _NEAR * about + _FAR_SIGMAS * sigma)
    if column < 3:
        for rows, axis in scene.vibrations:
            near &= ~(rows & (axis[column] != 0.0))
    pairs = np.column_stack([np.round(acting[near] / (_ALIKE * sigma)), reading[near]])
    unique, counts = np.unique(pairs, axis=0, return_counts=True)
    return unique[:, 0] * _ALIKE * sigma, unique[:, 1], counts.astype(np.float64)


def _by_tails(
    inputs: Array, readings: Array, counts: Array, step: float, sigma: float, width: float, tails: Tails
) -> Array:
    """Return the log-likelihood [nats] for each of some tails: shares of samples that are noisier than others."""
    times_tried = {1.0} | {times for _, times in tails}
    noisier = {times: _likelihood(inputs, readings, step, times * sigma, width) for times in times_tried}
    mixed = [(1.0 - share) * noisier[1.0] + share * noisier[times] for share, times in tails]
    return np.array([counts @ np.log(np.maximum(one, 1e-12)) for one in mixed])


def _likelihood(inputs: Array, readings: Array, step: float, sigma: float, width: float) -> Array:
    """Return the probability of readings of inputs [y], rounded to steps [y] behind a dead band."""
    size, towards = np.abs(readings), np.where(readings < 0.0, -inputs, inputs)
    beyond = np.maximum(size - step, width)
    read = _weighted(towards, sigma, beyond, size, size, -step)
    read += _weighted(towards, sigma, np.maximum(size, width), size + step, size, step)
    read += np.where(size < step, _weighted(-towards, sigma, width, step - size, -size, step), 0.0)
    silent = ndtr((width - inputs) / sigma) - ndtr((-width - inputs) / sigma)
    return np.where(size == 0.0, silent + read, read)


def _weighted(mean: Array, sigma: float, low: Array | float, high: Array, peak: Array, slope: float) -> Array:
    """Return ∫ (1 - (x - peak)/slope) N(x; mean, σ²) dx from low to high, nothing where high is below low."""
    a, b = (np.asarray(end - mean) / sigma for end in (low, np.maximum(low, high)))
    mass = ndtr(b) - ndtr(a)
    moment = mean * mass - sigma * (density(b) - density(a))
    return np.asarray(mass - (moment - peak * mass) / slope)
