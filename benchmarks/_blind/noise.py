"""Sensor noise in the time domain, and the spectra by which the oracle weighs it.

Spectra are two-sided and per hertz: white N², flicker B²/(2πf), random walk K²/(2πf)², quantisation
4(q²/12)·sin²(πf·dt)/dt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

_PER_DECADE = 4
_LONGEST_S = 2000.0
_SHORTEST_INTERVALS = 0.45
"""Of the fastest process: its sampled spectrum goes on as 1/f to half the rate."""


@dataclass(frozen=True)
class Spectrum:
    """One channel's noise: N [y/√Hz], B [y], K [y/√s], step q [y·s], and an optional Gauss-Markov process."""

    white: float = 0.0
    flicker: float = 0.0
    random_walk: float = 0.0
    quantisation: float = 0.0
    markov_sigma: float = 0.0
    markov_s: float = 1.0

    def density(self, frequency_hz: np.ndarray, dt: float) -> np.ndarray:
        """Two-sided density [y²/Hz]."""
        w = 2 * np.pi * frequency_hz
        slow = self.flicker**2 / w + self.random_walk**2 / w**2
        markov = 2 * self.markov_sigma**2 * self.markov_s / (1 + (w * self.markov_s) ** 2)
        return self.white**2 + slow + markov + self.quantisation**2 / 3 * np.sin(w * dt / 2) ** 2 / dt

    def sample(self, rng: np.random.Generator, count: int, dt: float, *, tails: str = "") -> np.ndarray:
        """Return rates without quantisation, which is a readout; ``tails`` makes the white part heavy-tailed."""
        out = self.white / np.sqrt(dt) * _white(rng, count, tails)
        out += self.random_walk * np.sqrt(dt) * np.cumsum(rng.standard_normal(count))
        if self.flicker:
            low, high = np.log10(_SHORTEST_INTERVALS * dt), np.log10(_LONGEST_S)
            constants = np.logspace(low, high, round(_PER_DECADE * (high - low)))
            share = self.flicker * np.sqrt(np.log(constants[1] / constants[0]) / np.pi)
            for constant in constants:
                out += markov(rng, count, dt, share, constant)
        if self.markov_sigma:
            out += markov(rng, count, dt, self.markov_sigma, self.markov_s)
        return out


def _white(rng: np.random.Generator, count: int, tails: str) -> np.ndarray:
    """Unit-variance white noise: Gaussian, Student's t of 4 degrees, or one sample in a hundred six times as large."""
    if tails == "student":
        return rng.standard_t(4, count) / np.sqrt(2)
    if tails == "outliers":
        return rng.standard_normal(count) * np.where(rng.random(count) < 0.01, 6.0, 1.0) / np.sqrt(0.99 + 0.36)
    return rng.standard_normal(count)


def markov(rng: np.random.Generator, count: int, dt: float, sigma: float, constant_s: float) -> np.ndarray:
    """Stationary first-order Gauss-Markov process."""
    keep = np.exp(-dt / constant_s)
    drive = rng.standard_normal(count) * sigma * np.sqrt(1 - keep**2)
    drive[0] = sigma * rng.standard_normal()
    return lfilter([1.0], [1.0, -keep], drive)


def sway(rng: np.random.Generator, count: int, dt: float, sigma: float, constant_s: float) -> np.ndarray:
    """Smooth random angle: white noise through two equal lags; its two-sided spectrum is 4σ²T/(1 + (2πfT)²)²."""
    keep, lead = np.exp(-dt / constant_s), round(12 * constant_s / dt)
    drive = rng.standard_normal(count + lead)
    out = lfilter([1.0], [1.0, -2 * keep, keep**2], drive)[lead:]
    gain = np.sqrt((1 + keep**2) / (1 - keep**2) ** 3)
    return out * sigma / gain


def quantise(rate: np.ndarray, dt: float, step: float, start: float) -> np.ndarray:
    """Rates from differences of the integral rounded to whole steps; ``start`` is its fraction at the beginning."""
    total = np.concatenate([[start * step], start * step + np.cumsum(rate * dt)])
    return np.diff(np.rint(total / step)) * step / dt
