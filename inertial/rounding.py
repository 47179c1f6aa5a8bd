"""What an integrator read out in whole steps adds to its increments.

The readout rounds the integral, so an increment is the true one plus the difference of two rounding errors. Their
variance is step²/12 each; white they are only when the noise moves the integral by a good part of a step between
samples. Otherwise successive errors are related: with the integral moving by μ steps a sample on average and σ steps
at random, the sawtooth's harmonic h of size 1/(π h) turns by 2π h μ and fades by exp(−2π² h² σ²) (B. Widrow and
I. Kollár, *Quantization Noise*, 2008, ch. 20). A laser gyro without dither is such an instrument.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.fft import dct

from inertial.compiled import compiled

Array = npt.NDArray[np.float64]

_HARMONICS, _FADED = 8, 1e-4
_DRAWS = 16  # records simulated
LOOKED_AT = 1 << 16  # readings are enough to show a lattice
_OFF_LATTICE = 0.02  # rms distance from the lattice, in steps; readings on none have 0.29
_COARSE = 20.0  # last places of a frame that a step must have to be told from them
_TOGETHER = 3.0  # last places within which two increments are one
_TO_FRAME = 1e-3  # of a step that a frame's own finer one is taken to be where nobody says
_SURE = 0.25  # of a step that its own uncertainty may put an increment off


def increment_step(increments: Array, last_place: float | None = None) -> tuple[float, float, float] | None:
    """Find the lattice on which increments lie.

    It need not pass through zero: what is compensated after the readout shifts it.

    Parameters
    ----------
    increments : (n,) readings times interval [y·s]
    last_place : step in which the frame counts [y·s]; a lattice not much coarser is the frame's own. None: it is not
        known, and the readings are of a block at rest, so that neighbours much closer than others are the frame's.

    Returns
    -------
    step, its 1σ, and the lattice's origin [y·s], or None where the increments lie on no lattice that shows.
    """
    values = np.unique(increments)
    if values.size < 2 or (last_place is None and values.size > increments.size // 4):
        return None
    gaps = np.diff(values)
    if last_place is None:
        gaps[gaps < 0.05 * gaps.max()] = np.inf
    else:
        gaps[gaps < max(_TOGETHER * last_place, 1e-9 * float(np.abs(values).max()))] = np.inf
    step = float(gaps.min())
    error = _TO_FRAME * step if last_place is None else last_place
    if not _COARSE * error <= step < np.inf:
        return None
    least = np.flatnonzero(gaps <= step + error)
    # One step apart and amid the others: from the thin ends of their range no small number of steps leads on.
    amid = least[np.argmin(np.abs(values[least] - np.median(increments)))]
    beyond = values - values[amid]
    index = _counted(beyond, step, error)
    step, origin = (float(c) for c in np.polyfit(index, values, 1))
    residual = values - origin - step * index
    rms = float(np.sqrt(np.mean(residual**2)))
    if rms > _OFF_LATTICE * step + (last_place or 0.0):
        return None
    return step, rms / float(np.std(index) * np.sqrt(values.size)) + 1e-6 * step, origin


def _counted(beyond: Array, step: float, error: float) -> Array:
    """Return how many steps each value is beyond another: small numbers first, which tell the step for larger ones."""
    rounding = error
    while True:
        near = np.abs(beyond) * error <= _SURE * step**2
        counts = np.round(beyond[near] / step)
        step = float(beyond[near] @ counts / (counts @ counts))
        finer = rounding / float(np.abs(counts).max())
        if near.all() or finer > 0.5 * error:
            return np.asarray(np.round(beyond / step))
        error = finer


def rounded_steps(advance: Array, sigma: float, random: np.random.Generator) -> Array:
    """Return one draw of the whole steps (n,) that are read of an integral that moves by ``advance`` (n,) a sample.

    And by ``sigma`` at random, both in steps; where between two thresholds it begins is random too.
    """
    total = random.random() + np.cumsum(advance + sigma * random.standard_normal(advance.size))
    return np.asarray(np.diff(np.rint(total), prepend=0.0))


def power_scatter(advance: Array, sigma: float, bounds: npt.NDArray[np.int64]) -> Array:
    """Return by how much the power of increments scatters from record to record, over what Gaussian noise's does.

    An integral that stays near one threshold for long crosses it many times, one between two of them never. So errors
    of a readout whose step the noise seldom crosses come in swarms. By simulation, seeded.

    Parameters
    ----------
    advance : (n,) mean motion of the integral [steps per sample]
    sigma : of its random motion [steps per sample]
    bounds : (b + 1,) bins of cosine coefficients

    Returns
    -------
    (b,) ratio of the variances of the power in each bin.
    """
    random, counts, powers = np.random.default_rng(advance.size), np.diff(bounds), []
    for _ in range(_DRAWS):
        power = np.square(dct(rounded_steps(advance, sigma, random) - advance, norm="ortho"))
        powers.append(np.add.reduceat(power, bounds[:-1]) / counts)
    mean = np.maximum(np.mean(powers, axis=0), np.finfo(np.float64).tiny)
    return np.asarray(0.5 * counts * np.var(powers, axis=0, ddof=1) / mean**2)


def error_covariance(lags: Array, advance: Array, variance: float) -> Array:
    """Return the covariance of the rounding errors of readings some samples apart, in units of step².

    Parameters
    ----------
    lags : (m,) how many samples apart
    advance : (b,) mean motion of the integral [steps per sample], over which the covariance is averaged
    variance : of its random motion [steps² per sample]
    """
    total = np.where(lags == 0.0, 1.0 / 12.0, 0.0)
    apart = lags != 0.0
    for h in range(1, _HARMONICS + 1):
        fade = np.exp(-2.0 * np.pi**2 * h**2 * variance * lags[apart])
        if fade.max(initial=0.0) < _FADED:
            break
        turned = np.cos(2.0 * np.pi * h * np.outer(lags[apart], advance)).mean(axis=1)
        total[apart] += turned * fade / (2.0 * np.pi**2 * h**2)
    return total


@compiled
def error_spectrum(omega: Array, advance: Array, variance: float) -> Array:
    """Return the spectrum of the rounding error, variance per coefficient in units of step².

    Parameters
    ----------
    omega : (m,) angular frequency [rad per sample]
    advance : (b,) mean motion of the integral [steps per sample], over which the spectrum is averaged
    variance : of its random motion [steps² per sample]
    """
    total = np.full(omega.size, 1.0 / 12.0)
    along, across = np.cos(omega), np.sin(omega)
    for h in range(1, _HARMONICS + 1):
        size = 1.0 / (2.0 * np.pi**2 * h**2)
        fade = np.exp(-2.0 * np.pi**2 * h**2 * variance)
        if fade < _FADED:
            break
        for stretch in range(advance.size):
            turn = 2.0 * np.pi * h * advance[stretch]
            real, imaginary = 2.0 * fade * np.cos(turn), 2.0 * fade * np.sin(turn)
            for i in range(omega.size):
                middle, off = 1.0 + fade**2 - real * along[i], imaginary * across[i]
                line = (1.0 - fade**2) * middle / ((middle - off) * (middle + off))
                total[i] += size * (line - 1.0) / advance.size
    return total
