"""Cosine spectrum of one channel's readings, and the variance each noise term gives its coefficients.

The record's cosine transform (DCT-II, orthonormal) takes it apart into coefficients ``k`` at the frequencies
``f = k / (2 n τ0)``. Their variances are known exactly for every term, ends of the record included, and they are
independent for all terms but flicker (correlation below 0.12, among the first few only), so that no window, trend
removal or choice of averaging enters. With ``x = π f τ0``, ``τ0`` the sampling interval and mean rates over each
interval as readings:

================  =========  =================================================================  =================
term              parameter  variance of a coefficient                                          Allan variance
================  =========  =================================================================  =================
quantisation      step q     ``q²/12 · (4 sin²x + (4/n) cos²x) / τ0²``                          ``q²/(4 τ²)``
white             N          ``N² / τ0``                                                        ``N²/τ``
flicker           B          ``B² sin²x / (2 π³) Σ_m |f τ0 + m|⁻³``, less 2/(π² k) for the ends  ``(2 ln2/π) B²``
random walk       K          ``K² τ0 (1 − ⅔ sin²x) / (4 sin²x)``                                ``K² τ/3``
ramp              R          its transform, as a mean and not as a variance                     ``R² τ²/2``
================  =========  =================================================================  =================

These are the terms of IEEE Std 952-1997 annex C: two-sided rate spectra ``N²``, ``B²/(2π f)``, ``K²/(2π f)²``, as
they come out averaged over an interval and sampled, and white angle noise of σ ``q/√12``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.linalg
import scipy.special

from inertial.rounding import LOOKED_AT, error_spectrum, increment_step

Array = npt.NDArray[np.float64]

QUANTISATION, WHITE, FLICKER, WALK = range(4)
SINGLE = 64  # first coefficients, kept one by one; those above are pooled in bins
_BIN_RATIO = 1.05
_LONGEST_TRANSFORM = 1 << 20
_POINTS = 4  # at which a spectrum with lines is sampled within a bin
_STRETCHES = 8  # over which the mean motion is taken to be constant


@dataclass(frozen=True)
class Rounding:
    """Lattice of the increments: step and its 1σ [y·s], mean motion of the integral by stretch [steps per sample]."""

    step: float
    sigma: float
    advance: Array


@dataclass(frozen=True)
class Spectrum:
    """Cells of the cosine spectrum: the lowest coefficients one by one, the others pooled in bins of equal ratio."""

    power: Array  # (c,) mean square of the coefficients [y²]
    single: Array  # (c,) the coefficient itself where a cell holds one, else 0
    freedom: Array  # (c,) independent squares in the mean
    fraction: Array  # (c,) of all coefficients of the record
    omega: Array  # (c, 4) angular frequencies across a cell [rad per sample of its band]
    group: Array  # (c,) readings averaged to one sample of its band
    basis: Array  # (c, 4) variance per unit q², N², B², K²
    ramp: Array  # (c,) coefficient of a ramp of 1 y/s, 0 where pooled
    slope: float  # [y/s] ramp taken out of the record beforehand
    kurtosis: float  # fourth cumulant of the angle noise of the readings [(y·s)⁴]
    interval_s: float
    rounding: Rounding | None


def cosine_spectrum(readings: Array, interval_s: float) -> Spectrum:
    """Return the binned cosine spectrum; a long record goes in two bands so that memory stays bounded.

    The low band is the whole record averaged in groups (which leaves every term's formula as it is, with a longer
    interval), the high band the mean over segments at full rate.
    """
    n = readings.size
    group = -(-n // _LONGEST_TRANSFORM)
    low = readings[: n // group * group].reshape(-1, group).mean(axis=1) if group > 1 else readings
    tau = group * interval_s
    low = low - low.mean()
    centred = np.arange(low.size) - 0.5 * (low.size - 1)
    slope = float(centred @ low / (centred @ centred)) / tau
    coefficients = scipy.fft.dct(low - slope * tau * centred, norm="ortho", overwrite_x=True)
    last = low.size if group == 1 else low.size // 4
    bands = [_cells(coefficients**2, 1.0, 1, last, low.size, interval_s, group)]
    if group > 1:
        length = min(n, max(1 << 16, 1024 * group))
        # the same frequency, last / (2 n_low tau), as a coefficient of the segments
        first = round(last * length / (low.size * group))
        bands.append(_cells(_mean_periodogram(readings, length), n // length, first, length, length, interval_s, 1))
    power, freedom, fraction, omega, groups, basis = (np.concatenate(parts) for parts in zip(*bands, strict=True))
    count = min(SINGLE, last - 1)
    single, ramp = np.zeros_like(power), np.zeros_like(power)
    single[:count] = coefficients[1 : count + 1]
    ramp[:count] = _ramp_transform(count, low.size, tau)
    kurtosis = _fourth_cumulant(readings) * interval_s**4
    lattice = _rounding(readings, interval_s)
    return Spectrum(power, single, freedom, fraction, omega, groups, basis, ramp, slope, kurtosis, interval_s, lattice)


def rounded_basis(spectrum: Spectrum, white: float) -> Array:
    """Return the basis (c, 4) for a readout that rounds an integral moved by white noise N [y/√Hz] among others."""
    rounding = spectrum.rounding
    assert rounding is not None
    basis = spectrum.basis.copy()
    variance = white**2 * spectrum.interval_s / rounding.step**2
    for group in np.unique(spectrum.group):
        cells = spectrum.group == group
        omega = spectrum.omega[cells]
        error = error_spectrum(omega.ravel(), rounding.advance * group, variance * group).reshape(omega.shape)
        tilt = np.sin(0.5 * omega) ** 2
        basis[cells, QUANTISATION] *= 12.0 * np.sum(tilt * error, axis=1) / np.sum(tilt, axis=1)
    return basis


def _rounding(readings: Array, interval_s: float) -> Rounding | None:
    found = increment_step(readings[:LOOKED_AT] * interval_s)
    if found is None:
        return None
    step, sigma, origin = found
    length = readings.size // _STRETCHES
    means = readings[: length * _STRETCHES].reshape(_STRETCHES, length).mean(axis=1)
    return Rounding(step, sigma, (means * interval_s - origin) / step)


def _mean_periodogram(readings: Array, length: int) -> Array:
    total = np.zeros(length)
    segments = readings.size // length
    for index in range(segments):
        part = readings[index * length : (index + 1) * length]
        total += scipy.fft.dct(part - part.mean(), norm="ortho", overwrite_x=True) ** 2
    return total / segments


def _cells(
    periodogram: Array, segments: float, first: int, last: int, n: int, interval_s: float, group: int
) -> tuple[Array, ...]:
    """Pool coefficients ``first … last − 1``: mean square, freedom, share, frequencies, readings a sample, basis."""
    starts, counts, omega, basis = _layout(first, last, n, group * interval_s)
    power = np.add.reduceat(periodogram[first:last], starts) / counts
    return power, counts * segments, counts / n, omega, np.full(counts.size, float(group)), basis


@lru_cache(maxsize=4)
def _layout(first: int, last: int, n: int, tau: float) -> tuple[npt.NDArray[np.int64], Array, Array, Array]:
    """Return bins of equal ratio, the lowest coefficients single: first of each, size, frequencies, mean basis."""
    single_end = min(SINGLE + 1, last) if first == 1 else first
    steps = int(np.ceil(np.log(last / single_end) / np.log(_BIN_RATIO))) + 1
    pooled = np.round(np.geomspace(single_end, last, steps)).astype(np.int64)
    bounds = np.unique(np.concatenate([np.arange(first, single_end), pooled]))
    counts = np.diff(bounds).astype(np.float64)
    starts = bounds[:-1] - first
    basis = np.add.reduceat(_basis(np.arange(first, last), n, tau), starts, axis=0) / counts[:, None]
    across = bounds[:-1, None] - 0.5 + counts[:, None] * (np.arange(_POINTS) + 0.5) / _POINTS
    return starts, counts, np.pi * across / n, basis


def _basis(k: npt.NDArray[np.int64], n: int, tau: float) -> Array:
    """Return (m, 4): variance of coefficient k [y²] per unit q², N², B², K² (module docstring)."""
    x = np.pi * k / (2.0 * n)
    sine2 = np.sin(x) ** 2
    cycles = k / (2.0 * n)
    quantisation = (4.0 * sine2 + 4.0 / n * (1.0 - sine2)) / (12.0 * tau**2)
    aliases = scipy.special.zeta(3.0, cycles) + scipy.special.zeta(3.0, 1.0 - cycles)
    flicker = sine2 * aliases / (2.0 * np.pi**3) * _flicker_edge(k)
    walk = tau * (1.0 - 2.0 / 3.0 * sine2) / (4.0 * sine2)
    return np.column_stack([quantisation, np.full(k.size, 1.0 / tau), flicker, walk])


def _flicker_edge(k: npt.NDArray[np.int64]) -> Array:
    """Return by how much the record's ends lower flicker in coefficient k: 1 − 2/(π² k) but for the first few."""
    ratio = 1.0 - 2.0 / (np.pi**2 * k)
    table = _flicker_edge_table()
    few = k <= table.size
    ratio[few] = table[k[few] - 1]
    return np.asarray(ratio)


@lru_cache(maxsize=1)
def _flicker_edge_table() -> Array:
    """Return the first 32 ratios exactly, from the generalised covariance t² ln t of integrated flicker."""
    n, few = 1024, 32
    lag = np.arange(-1.0, n + 1.0)
    curve = lag**2 * np.log(np.maximum(np.abs(lag), 1.0))
    covariance = -np.diff(curve, 2) / (2.0 * np.pi)
    k = np.arange(1, few + 1)
    rows = np.sqrt(2.0 / n) * np.cos(np.pi * k[:, None] * (np.arange(n) + 0.5) / n)
    exact = np.einsum("ki,ki->k", rows, scipy.linalg.matmul_toeplitz(covariance, rows.T).T)
    cycles = k / (2.0 * n)
    aliases = scipy.special.zeta(3.0, cycles) + scipy.special.zeta(3.0, 1.0 - cycles)
    return np.asarray(exact / (np.sin(np.pi * cycles) ** 2 * aliases / (2.0 * np.pi**3)))


def _ramp_transform(count: int, n: int, tau: float) -> Array:
    """Return coefficients 1 … count of a ramp of 1 y/s: only the odd ones differ from zero."""
    k = np.arange(1, count + 1)
    x = np.pi * k / (2.0 * n)
    return np.asarray(np.where(k % 2 == 1, -np.sqrt(2.0 / n) * np.cos(x) / (2.0 * np.sin(x) ** 2) * tau, 0.0))


def _fourth_cumulant(readings: Array) -> float:
    """Return the fourth cumulant per interval⁴ of independent angle noise that differs into the readings.

    From the readings' differences, which drop what is slow and hold that noise three times, as 1, −2, 1: of the
    fourth cumulants of all else, Gaussian, nothing is left. In blocks, so that memory stays bounded.
    """
    count, square, fourth = 0, 0.0, 0.0
    for start in range(0, readings.size, 1 << 18):
        difference2 = np.diff(readings[start : start + (1 << 18)]) ** 2
        count += difference2.size
        square += float(difference2.sum())
        fourth += float((difference2**2).sum())
    return (fourth / count - 3.0 * (square / count) ** 2) / 18.0
