"""Sensor noise as increments: white, flicker, random walk of the rate, quantisation (IEEE 952, annex C).

Each process is seeded, in its steady state from the first sample, and gives the same numbers however many samples
are asked for at once. ``y`` stands for m/s² or rad/s; a process of c channels gives increments (n, c) [y·s].
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from inertial.compiled import compiled

Array = NDArray[np.float64]

_RATIO = 4.0  # at most, between neighbouring correlation times: the sum stays within 1 % of 1/f
_LONGEST_S = 2e4  # what relaxes more slowly than a working day is one more constant
_SHORTEST_INTERVALS = 0.65  # of the fastest process: keeps the sampled spectrum within 6 % up to half the rate
_UPDATES = 16.0  # a process is renewed at least so many times within its correlation time


def generator(seed: int, *key: int) -> np.random.Generator:
    """Return the random numbers of one purpose, independent of all others of the same seed."""
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, *key])))


class White:
    """Velocity or angle random walk of ``coefficient`` (c,) [y/√Hz]: independent increments of variance N²·T."""

    def __init__(self, coefficient: ArrayLike, interval_s: float, rng: np.random.Generator) -> None:
        self._sigma = np.asarray(coefficient, dtype=np.float64) * math.sqrt(interval_s)
        self._rng = rng

    def increments(self, count: int) -> Array:
        """Return the next ``count`` rows."""
        return _white(self._rng, self._sigma, count)


@compiled
def _white(rng: np.random.Generator, sigma: Array, count: int) -> Array:
    rows = np.empty((count, sigma.size))
    for k in range(count):
        for c in range(sigma.size):
            rows[k, c] = sigma[c] * rng.standard_normal()
    return rows


class Flicker:
    """Bias instability of ``coefficient`` B (c,) [y]: two-sided spectrum B²/(2πf), Allan floor √(2 ln 2/π)·B = 0.664·B.

    A sum of first-order Gauss–Markov processes whose correlation times τ stand in a constant ratio r: with variance
    B²·ln r/π each, their Lorentzians add up to B²/(2πf) (∫ 2τ/(1 + (2πfτ)²) d ln τ = 1/(2f)). Each stands for the
    times from τ/√r to τ·√r, so the slowest lies √r below the longest time whatever the rate. Slow ones are renewed
    seldom and held between.
    """

    def __init__(self, coefficient: ArrayLike, interval_s: float, rng: np.random.Generator) -> None:
        size = np.asarray(coefficient, dtype=np.float64) * interval_s
        slowest = _LONGEST_S / math.sqrt(_RATIO) / interval_s
        count = max(2, math.ceil(math.log(slowest / _SHORTEST_INTERVALS, _RATIO)) + 1)
        intervals = np.geomspace(_SHORTEST_INTERVALS, slowest, count)
        self._every = np.maximum(1, intervals / _UPDATES).astype(np.int64)
        self._decay = np.exp(-self._every / intervals)
        sigma = np.sqrt(math.log(slowest / _SHORTEST_INTERVALS) / (count - 1) / math.pi) * size
        self._kick = np.sqrt(1.0 - self._decay**2)[:, None] * sigma
        self._rng = rng
        self._state = rng.standard_normal((count, size.size)) * sigma
        self._next = 0

    def increments(self, count: int) -> Array:
        """Return the next ``count`` rows."""
        rows = _flicker(self._rng, self._next, count, self._every, self._decay, self._kick, self._state)
        self._next += count
        return rows


@compiled
def _flicker(
    rng: np.random.Generator,
    first: int,
    count: int,
    every: NDArray[np.int64],
    decay: Array,
    kick: Array,
    state: Array,
) -> Array:
    rows = np.zeros((count, state.shape[1]))
    for k in range(count):
        for level in range(every.size):
            if (first + k) % every[level] == 0:
                for c in range(state.shape[1]):
                    state[level, c] = decay[level] * state[level, c] + kick[level, c] * rng.standard_normal()
            for c in range(state.shape[1]):
                rows[k, c] += state[level, c]
    return rows


class RateRandomWalk:
    """Rate random walk of ``coefficient`` K (c,) [y/√s]: the rate is K times a Wiener process from zero at turn-on.

    A sample is the integral of the rate over its interval T: K·(W·T + T^1.5·(ξ₁/2 + ξ₂/√12)), exact jointly with the
    walk's own step K·√T·ξ₁.
    """

    def __init__(self, coefficient: ArrayLike, interval_s: float, rng: np.random.Generator) -> None:
        self._step = np.asarray(coefficient, dtype=np.float64) * math.sqrt(interval_s)
        self._interval_s = interval_s
        self._rng = rng
        self._rate = np.zeros(self._step.size)

    def increments(self, count: int) -> Array:
        """Return the next ``count`` rows."""
        return _rate_walk(self._rng, self._rate, self._step, self._interval_s, count)


@compiled
def _rate_walk(rng: np.random.Generator, rate: Array, step: Array, interval_s: float, count: int) -> Array:
    rows = np.empty((count, step.size))
    for k in range(count):
        for c in range(step.size):
            walked = step[c] * rng.standard_normal()
            within = 0.5 * walked + step[c] / math.sqrt(12.0) * rng.standard_normal()
            rows[k, c] = interval_s * (rate[c] + within)
            rate[c] += walked
    return rows


class Quantiser:
    """An integrator read out in whole steps (c,) [y·s]: the next reading carries what one leaves; 0 leaves as is."""

    def __init__(self, step: ArrayLike) -> None:
        self._step = np.asarray(step, dtype=np.float64)
        self._left = np.zeros(self._step.size)

    def quantise(self, increments: Array) -> None:
        """Round rows (n, c) in place; every result is an exact multiple of the step."""
        _quantise(increments, self._step, self._left)


@compiled
def _quantise(increments: Array, step: Array, left: Array) -> None:
    for k in range(increments.shape[0]):
        for c in range(step.size):
            if step[c] > 0.0:
                total = left[c] + increments[k, c]
                increments[k, c] = np.rint(total / step[c]) * step[c]
                left[c] = total - increments[k, c]
