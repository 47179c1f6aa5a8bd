"""Records of known noise, made without any of the code that identifies it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def record(
    rng: np.random.Generator,
    n: int,
    interval_s: float,
    *,
    quantisation: float = 0.0,
    white: float = 0.0,
    flicker: float = 0.0,
    random_walk: float = 0.0,
    ramp: float = 0.0,
    mean: float = 0.0,
) -> Array:
    """Return (n,) readings [y] of a channel whose terms are those of :class:`inertial.noise.NoiseFit`."""
    rate = mean + ramp * interval_s * np.arange(n)
    rate = rate + white / np.sqrt(interval_s) * rng.standard_normal(n)
    if random_walk > 0.0:
        # mean over each interval of a Wiener process stepped 4 times within it
        steps = random_walk * np.sqrt(interval_s / 4.0) * rng.standard_normal(4 * n)
        rate += np.cumsum(steps).reshape(n, 4).mean(axis=1)
    if flicker > 0.0:
        rate += flicker * _one_over_f(rng, n, interval_s)
    if quantisation > 0.0:
        angle = np.concatenate([[0.0], np.cumsum(rate * interval_s)]) + rng.uniform(0.0, quantisation)
        rate = np.diff(np.round(angle / quantisation)) * quantisation / interval_s
    return np.asarray(rate)


def _one_over_f(rng: np.random.Generator, n: int, interval_s: float) -> Array:
    """Return noise of two-sided spectrum 1/(2πf), the cut of a periodic record eight times as long (FFT synthesis)."""
    length = 8 * n
    frequency = np.fft.rfftfreq(length, interval_s)
    amplitude = np.zeros(frequency.size)
    amplitude[1:] = np.sqrt(length / (2.0 * np.pi * frequency[1:] * interval_s))
    spectrum = (
        amplitude * np.exp(2j * np.pi * rng.random(frequency.size)) * np.sqrt(rng.exponential(size=frequency.size))
    )
    return np.asarray(np.fft.irfft(spectrum, length)[:n])
