"""Noise of one channel identified from its own record: quantisation, white, flicker, random walk and ramp.

What is fitted is the power spectrum, not the Allan curve, whose points are correlated. The record's cosine transform
(DCT-II, orthonormal) takes it apart into coefficients ``k`` at the frequencies ``k / (2 n τ0)`` whose variances are
known exactly for every term and which are independent for all of them but flicker (correlation below 0.12, and only
among the first few), so that no window, trend removal or choice of averaging enters. With ``x = π f τ0``, ``τ0`` the
sampling interval, and mean rates over each interval as the readings, the variances per unit parameter are

================  ==========  ==================================================================  ====================
term              parameter   variance of coefficient                                             Allan variance at τ
================  ==========  ==================================================================  ====================
quantisation      step q      ``q²/12 · (4 sin²x + (4/n) cos²x) / τ0²``                           ``q²/(4τ²)``
white             N           ``N² / τ0``                                                         ``N²/τ``
flicker           B           ``B² sin²x / (2π³ τ0 …) Σ|f+m/τ0|⁻³``: ``B²/(2πf)`` averaged        ``(2 ln2/π) B²``
random walk       K           ``K² τ0 (1 − ⅔ sin²x) / (4 sin²x)``                                 ``K² τ/3``
ramp              R           its transform, as a mean and not as a variance                      ``R² τ²/2``
================  ==========  ==================================================================  ====================

These are the terms of IEEE Std 952-1997 annex C: two-sided rate spectra ``N²``, ``B²/(2π f)``, ``(K/2π)²/f²``,
and white angle noise of σ ``q/√12``. Flicker's Allan floor is ``√(2 ln2/π) B = 0.664 B``.

Variances are never negative; each parameter's interval comes from its profile likelihood with all others free, and it
is *seen* when the record refuses its absence by more than :data:`SEEN_SIGMA`. Intervals of seen parameters allow for
having been looked at only because they were seen.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.linalg
import scipy.optimize
import scipy.special

from inertial.compiled import compiled
from inertial.documents import ChannelNoise, Noise

Array = npt.NDArray[np.float64]

SEEN_SIGMA = 3.0
"""Likelihood ratio (as a normal deviate) from which a parameter counts as seen."""
MINIMUM_SAMPLES = 64
_QUANTISATION, _WHITE, _FLICKER, _WALK = range(4)
_SINGLE = 64  # first coefficients, kept one by one; those above are pooled in bins
_BIN_RATIO = 1.05
_LONGEST_TRANSFORM = 1 << 20
_FLICKER_ALLAN = 2.0 * np.log(2.0) / np.pi
_NORMAL_975 = 1.959963984540054
_MISFIT_SIGMA = 6.0  # misfit beyond what chance gives, from which the spectrum is not a sum of the terms
_DROPPED = 3.0  # a cell this many times above what would be clipped says nothing about the terms
_MODEL_TRUST = 0.3  # relative 1σ of the terms' sum as a model of such a spectrum


@dataclass(frozen=True)
class NoiseTerm:
    """One parameter: best value, 1σ, 95 % interval, and whether the record shows it at all."""

    value: float
    sigma: float
    interval95: tuple[float, float]
    seen: bool


@dataclass(frozen=True)
class NoiseFit:
    """Noise of one channel; y is the channel's unit, m/s² or rad/s.

    Attributes
    ----------
    quantisation : step of the increments [y·s]
    white : angle or velocity random walk [y/√Hz]
    flicker : bias instability [y], the Allan floor divided by 0.664
    random_walk : rate random walk [y/√s]
    ramp : rate ramp [y/s], signed
    misfit : mean squared standardised residual of the spectrum; 1 when the five terms explain it
    interval_s, samples : the record's
    """

    quantisation: NoiseTerm
    white: NoiseTerm
    flicker: NoiseTerm
    random_walk: NoiseTerm
    ramp: NoiseTerm
    misfit: float
    interval_s: float
    samples: int

    def allan_deviation(self, averaging_s: npt.ArrayLike) -> Array:
        """Return the Allan deviation [y] of the fitted terms at averaging times [s] (IEEE Std 952-1997, C.1)."""
        tau = np.asarray(averaging_s, dtype=np.float64)
        variance = (
            self.quantisation.value**2 / (4.0 * tau**2)
            + self.white.value**2 / tau
            + _FLICKER_ALLAN * self.flicker.value**2
            + self.random_walk.value**2 * tau / 3.0
            + self.ramp.value**2 * tau**2 / 2.0
        )
        return np.asarray(np.sqrt(variance))


@dataclass(frozen=True)
class _Spectrum:
    """Cells of the cosine spectrum: pooled power, its freedom, each term's variance in it, and the ramp's transform."""

    power: Array  # (c,) mean square of the coefficients
    single: Array  # (c,) the coefficient itself where a cell holds one, else 0
    freedom: Array  # (c,)
    fraction: Array  # (c,) of all coefficients
    basis: Array  # (c, 4) variance per unit q², N², B², K²
    ramp: Array  # (c,) coefficient of a unit ramp, 0 where pooled
    slope: float  # [y/s] ramp taken out of the record beforehand
    kurtosis: float  # fourth cumulant of the readings
    interval_s: float


def identify_noise(rate: npt.ArrayLike, interval_s: float) -> NoiseFit:
    """Fit the five noise terms of IEEE Std 952 to one channel at rest.

    Parameters
    ----------
    rate : (n,) readings [m/s² or rad/s], each the mean over its interval (increment divided by interval)
    interval_s : sampling interval [s]

    Returns
    -------
    NoiseFit
        Terms not seen carry their most likely value (often 0) and an interval that starts at 0.

    Raises
    ------
    ValueError
        When the record is too short, not finite, not one channel, or constant.
    """
    readings = _checked(rate, interval_s)
    if np.ptp(readings) == 0.0:
        raise ValueError("all readings are equal: the channel is stuck or its increments are too coarse to show noise")
    return _Fit(_spectrum(readings, interval_s)).report(interval_s, readings.size)


def noise_of_block(accel_mps2: npt.ArrayLike, gyro_radps: npt.ArrayLike, interval_s: float) -> Noise:
    """Find the noise of all six channels from a record at rest, to weight an estimate with.

    Most likely values; the white noise is never below what the record can exclude (a channel whose quantisation hides
    it gets its 95 % upper limit), so that σ built from it is not optimistic. A constant channel gets zeros.

    Parameters
    ----------
    accel_mps2, gyro_radps : (n, 3) readings
    interval_s : sampling interval [s]
    """
    accel, gyro = np.asarray(accel_mps2, dtype=np.float64), np.asarray(gyro_radps, dtype=np.float64)
    if accel.ndim != 2 or accel.shape[1] != 3 or gyro.shape != accel.shape:
        raise ValueError(f"accel and gyro must both be (n, 3), got {accel.shape} and {gyro.shape}")
    found = {
        f"{kind}_{axis}": _channel_noise(data[:, column], interval_s)
        for kind, data in (("accel", accel), ("gyro", gyro))
        for column, axis in enumerate("xyz")
    }
    return Noise(**found)


def _channel_noise(rate: Array, interval_s: float) -> ChannelNoise:
    readings = _checked(rate, interval_s)
    if np.ptp(readings) == 0.0:
        return ChannelNoise()
    fit = _Fit(_spectrum(readings, interval_s))
    quantisation, white, flicker, walk = (float(np.sqrt(v)) for v in fit.best)
    if fit.significance(_WHITE) < SEEN_SIGMA:
        white = fit.limit(_WHITE, -_NORMAL_975)
    quantisation = float(np.hypot(quantisation, fit.excess_step()))
    return ChannelNoise(white=white, flicker=flicker, random_walk=walk, quantisation=quantisation)


def _checked(rate: npt.ArrayLike, interval_s: float) -> Array:
    readings = np.asarray(rate, dtype=np.float64)
    if readings.ndim != 1:
        raise ValueError(f"readings of one channel are (n,), got {readings.shape}")
    if readings.size < MINIMUM_SAMPLES:
        raise ValueError(f"{readings.size} readings are too few to identify noise; give {MINIMUM_SAMPLES} or more")
    if not np.isfinite(interval_s) or interval_s <= 0.0:
        raise ValueError(f"sampling interval must be positive, got {interval_s} s")
    if not np.isfinite(np.sum(readings)):
        raise ValueError("readings hold NaN or infinity; cut them out first")
    return readings


# ---- the spectrum -----------------------------------------------------------------------------------------------


def _spectrum(readings: Array, interval_s: float) -> _Spectrum:
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
    bands = [_cells(coefficients**2, 1.0, 1, last, low.size, tau)]
    if group > 1:
        length = min(n, max(1 << 16, 1024 * group))
        # the same frequency, last / (2 n_low tau), as a coefficient of the segments
        first = round(last * length / (low.size * group))
        bands.append(_cells(_mean_periodogram(readings, length), n // length, first, length, length, interval_s))
    power, freedom, fraction, basis = (np.concatenate(parts) for parts in zip(*bands, strict=True))
    count = min(_SINGLE, last - 1)
    single, ramp = np.zeros_like(power), np.zeros_like(power)
    single[:count] = coefficients[1 : count + 1]
    ramp[:count] = _ramp_transform(count, low.size, tau)
    return _Spectrum(power, single, freedom, fraction, basis, ramp, slope, _fourth_cumulant(readings), interval_s)


def _mean_periodogram(readings: Array, length: int) -> Array:
    total = np.zeros(length)
    segments = readings.size // length
    for index in range(segments):
        part = readings[index * length : (index + 1) * length]
        total += scipy.fft.dct(part - part.mean(), norm="ortho", overwrite_x=True) ** 2
    return total / segments


def _cells(periodogram: Array, segments: float, first: int, last: int, n: int, tau: float) -> tuple[Array, ...]:
    """Pool coefficients ``first … last − 1``: mean square, freedom, share of all coefficients, basis."""
    starts, counts, basis = _layout(first, last, n, tau)
    power = np.add.reduceat(periodogram[first:last], starts) / counts
    return power, counts * segments, counts / n, basis


@lru_cache(maxsize=4)
def _layout(first: int, last: int, n: int, tau: float) -> tuple[npt.NDArray[np.int64], Array, Array]:
    """Return bins of equal ratio, the lowest coefficients single: first of each, size of each, mean basis (c, 4)."""
    single_end = min(_SINGLE + 1, last) if first == 1 else first
    steps = int(np.ceil(np.log(last / single_end) / np.log(_BIN_RATIO))) + 1
    pooled = np.round(np.geomspace(single_end, last, steps)).astype(np.int64)
    bounds = np.unique(np.concatenate([np.arange(first, single_end), pooled]))
    counts = np.diff(bounds).astype(np.float64)
    starts = bounds[:-1] - first
    basis = np.add.reduceat(_basis(np.arange(first, last), n, tau), starts, axis=0) / counts[:, None]
    return starts, counts, basis


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
    """Return the fourth cumulant of the readings' differences halved, in blocks so that memory stays bounded."""
    moments = np.zeros(3)
    origin = float(readings[0])
    mean = float(np.mean(readings)) - origin
    for start in range(0, readings.size, 1 << 18):
        square = (readings[start : start + (1 << 18)] - origin - mean) ** 2
        moments += square.size, square.sum(), (square**2).sum()
    variance = moments[1] / moments[0]
    return float(moments[2] / moments[0] - 3.0 * variance**2)


# ---- the likelihood ---------------------------------------------------------------------------------------------


@compiled
def _evaluate(
    v: Array, power: Array, single: Array, freedom: Array, basis: Array, ramp: Array, given_ramp: bool, slope: float
) -> tuple[float, Array, Array, float, float]:
    """Return log-likelihood, score (4,), Fisher information (4, 4), ramp estimate and its information.

    With ``given_ramp`` the ramp is ``slope``; else it is integrated out under a flat prior (restricted likelihood).
    """
    score = np.zeros(4)
    fisher = np.zeros((4, 4))
    weight = 0.0
    moment = 0.0
    for c in range(power.size):
        if ramp[c] != 0.0:
            s = basis[c, 0] * v[0] + basis[c, 1] * v[1] + basis[c, 2] * v[2] + basis[c, 3] * v[3]
            weight += ramp[c] * ramp[c] / s
            moment += ramp[c] * single[c] / s
    given_ramp = given_ramp or weight == 0.0
    estimate = slope if given_ramp else moment / weight
    log_likelihood = 0.0 if given_ramp else -0.5 * np.log(weight)
    pull = np.zeros(4)
    for c in range(power.size):
        s = basis[c, 0] * v[0] + basis[c, 1] * v[1] + basis[c, 2] * v[2] + basis[c, 3] * v[3]
        residual2 = power[c] + estimate * ramp[c] * (estimate * ramp[c] - 2.0 * single[c])
        leverage = 0.0 if given_ramp else ramp[c] * ramp[c] / (s * weight)
        ratio = residual2 / s
        log_likelihood -= 0.5 * freedom[c] * (np.log(s) + ratio)
        for i in range(4):
            gi = basis[c, i] / s
            score[i] += 0.5 * gi * (freedom[c] * (ratio - 1.0) + leverage)
            pull[i] += gi * leverage
            for j in range(i + 1):
                fisher[i, j] += 0.5 * gi * basis[c, j] / s * (freedom[c] - 2.0 * leverage)
    for i in range(4):
        for j in range(i + 1):
            fisher[i, j] += 0.5 * pull[i] * pull[j]
            fisher[j, i] = fisher[i, j]
    return log_likelihood, score, fisher, estimate, weight


@compiled
def _solve(a: Array, b: Array) -> None:
    """Solve a x = b, a symmetric positive definite, by elimination in place; x is left in b."""
    m = b.size
    for c in range(m):
        for r in range(c + 1, m):
            factor = a[r, c] / a[c, c]
            for q in range(c, m):
                a[r, q] -= factor * a[c, q]
            b[r] -= factor * b[c]
    for c in range(m - 1, -1, -1):
        for q in range(c + 1, m):
            b[c] -= a[c, q] * b[q]
        b[c] /= a[c, c]


@compiled
def _bounded_step(v: Array, score: Array, fisher: Array, fixed: int) -> tuple[Array, float]:
    """Return the Fisher-scoring target: the quadratic model's maximum over v ≥ 0, ``fixed`` held (−1: none)."""
    scale = np.empty(4)
    for i in range(4):
        scale[i] = 1.0 / np.sqrt(fisher[i, i])
    gain_best = 0.0
    best = v.copy()
    for mask in range(16):
        if fixed >= 0 and mask >> fixed & 1:
            continue
        free = np.empty(4, np.int64)
        m = 0
        delta = np.zeros(4)
        for i in range(4):
            if mask >> i & 1:
                free[m] = i
                m += 1
            elif i != fixed:
                delta[i] = -v[i] / scale[i]
        a = np.zeros((m, m))
        b = np.zeros(m)
        for r in range(m):
            i = free[r]
            b[r] = score[i] * scale[i]
            for j in range(4):
                b[r] -= fisher[i, j] * scale[i] * scale[j] * delta[j]
            for q in range(m):
                a[r, q] = fisher[i, free[q]] * scale[i] * scale[free[q]]
            a[r, r] += 1e-10
        if m > 0:
            _solve(a, b)
            for r in range(m):
                delta[free[r]] = b[r]
        feasible = True
        gain = 0.0
        for i in range(4):
            if i != fixed and v[i] + delta[i] * scale[i] < 0.0:
                # a parameter held at zero lands there only to rounding
                feasible = feasible and not (mask >> i & 1)
            gain += score[i] * scale[i] * delta[i]
            for j in range(4):
                gain -= 0.5 * delta[i] * fisher[i, j] * scale[i] * scale[j] * delta[j]
        if feasible and gain > gain_best:
            gain_best = gain
            for i in range(4):
                best[i] = v[i] if i == fixed else max(v[i] + delta[i] * scale[i], 0.0)
    return best, gain_best


@compiled
def _maximise(
    start: Array,
    fixed: int,
    power: Array,
    single: Array,
    freedom: Array,
    basis: Array,
    ramp: Array,
    given_ramp: bool,
    slope: float,
) -> tuple[Array, float]:
    """Climb from ``start`` (variances, ``fixed`` held at its start) by bounded Fisher scoring with step halving."""
    v = start.copy()
    value, score, fisher, _, _ = _evaluate(v, power, single, freedom, basis, ramp, given_ramp, slope)
    for _ in range(100):
        target, gain = _bounded_step(v, score, fisher, fixed)
        if gain < 1e-9:
            break
        moved = False
        step = 1.0
        for _ in range(30):
            trial = v + step * (target - v)
            trial_value, s, f, _, _ = _evaluate(trial, power, single, freedom, basis, ramp, given_ramp, slope)
            if trial_value > value:
                v, value, score, fisher, moved = trial, trial_value, s, f, True
                break
            step *= 0.5
        if not moved:
            break
    return v, value


class _Fit:
    """The maximum of the likelihood and its profiles."""

    def __init__(self, spectrum: _Spectrum) -> None:
        self._use(spectrum)
        self.best, self.value = self._global()
        self.misfit = self._misfit()
        self.excess = np.zeros_like(spectrum.power)
        if self.misfit > 1.0 + _MISFIT_SIGMA * np.sqrt(2.0 / spectrum.power.size):
            self._set_excess_aside(spectrum)

    def _use(self, spectrum: _Spectrum) -> None:
        self._spectrum = spectrum
        self._cells = (spectrum.power, spectrum.single, spectrum.freedom, spectrum.basis, spectrum.ramp)

    def _misfit(self) -> float:
        """Return the mean deviance of a cell: 1 (1.27 for cells of one coefficient) when the model holds."""
        ratio = self._spectrum.power / (self._spectrum.basis @ self.best)
        return float(np.mean(self._spectrum.freedom * (ratio - 1.0 - np.log(np.maximum(ratio, 1e-300)))))

    def _set_excess_aside(self, spectrum: _Spectrum) -> None:
        """Fit the floor under resonances and lines (a vehicle's sway, a dither) that the five terms cannot make.

        Such a spectrum is no sum of power laws, and counting every coefficient as an independent witness would let a
        resonance with many of them decide what the noise is at frequencies where it has none. Each cell is trusted
        to :data:`_MODEL_TRUST`, and what stands out above the fit by more than 2.5 σ of that is set aside (Huber).
        """
        freedom = np.minimum(spectrum.freedom, 2.0 / _MODEL_TRUST**2)
        floor = np.quantile(spectrum.power[:, None] / spectrum.basis, 0.05, axis=0)
        tops = [self._clipped(replace(spectrum, freedom=freedom), start) for start in (self.best, floor)]
        _, clipped, self.best, self.value = min(tops, key=lambda top: top[0])
        self._use(clipped)
        self.excess = np.maximum(spectrum.power - np.minimum(clipped.power, clipped.basis @ self.best), 0.0)
        self.excess[clipped.power == spectrum.power] = 0.0

    def _clipped(self, spectrum: _Spectrum, start: Array) -> tuple[float, _Spectrum, Array, float]:
        """Refit with what stands out clipped or dropped until that settles; mean absolute log residual, fit."""
        allowed = 1.0 + 2.5 * np.sqrt(2.0 / spectrum.freedom)
        clipped, best, value = spectrum, start, -np.inf
        for _ in range(60):
            level = spectrum.basis @ best
            ratio = np.maximum(spectrum.power, 1e-300) / level
            kept = np.minimum(1.0, allowed / ratio)
            dropped = ratio > _DROPPED * allowed
            clipped = replace(
                spectrum,
                power=spectrum.power * kept,
                single=spectrum.single * np.sqrt(kept),
                freedom=np.where(dropped, 1e-6, spectrum.freedom),
                ramp=np.where(dropped, 0.0, spectrum.ramp),
            )
            self._use(clipped)
            best, value = self._climb(best)
            if np.max(np.abs(np.log(spectrum.basis @ best / level))) < 1e-2:
                break
        ratio = np.maximum(spectrum.power, 1e-300) / (spectrum.basis @ best)
        return float(np.mean(np.minimum(np.abs(np.log(ratio)), np.log(_DROPPED)))), clipped, best, value

    def excess_step(self) -> float:
        """Return the step [y·s] of a quantisation whose angle noise equals that of the pooled cells' excess."""
        spectrum = self._spectrum
        share = spectrum.fraction * self.excess / spectrum.basis[:, _QUANTISATION]
        return float(np.sqrt(np.sum(share[_SINGLE:])))

    def _global(self) -> tuple[Array, float]:
        """Start from each term explaining all, and from all together: the likelihood can have more than one top."""
        spectrum = self._spectrum
        scaled = np.maximum(spectrum.power, 1e-12 * spectrum.power.max())[:, None] / spectrum.basis
        whole = spectrum.freedom @ scaled / spectrum.freedom.sum()
        starts = (whole, np.exp(np.mean(np.log(scaled), axis=0)), np.min(scaled, axis=0))
        return max((self._climb(start) for start in starts), key=lambda top: top[1])

    def _climb(self, start: Array, fixed: int = -1, slope: float | None = None) -> tuple[Array, float]:
        v, value = _maximise(start, fixed, *self._cells, slope is not None, 0.0 if slope is None else slope)
        return np.asarray(v), float(value)

    def profile(self, term: int, variance: float) -> float:
        """Return the signed root of the likelihood ratio between the best fit and ``variance`` of one term."""
        start = np.maximum(self.best, 1e-6 * self._spread())
        start[term] = variance
        _, value = self._climb(start, term)
        root = np.sqrt(max(2.0 * (self.value - value), 0.0))
        return float(np.copysign(root, self.best[term] - variance))

    def _spread(self) -> Array:
        fisher = _evaluate(self.best, *self._cells, False, 0.0)[2]
        return np.asarray(1.0 / np.sqrt(np.diag(fisher)))

    def significance(self, term: int) -> float:
        """Return by how many σ the record refuses the absence of a term."""
        return self.profile(term, 0.0) if self.best[term] > 0.0 else 0.0

    def limit(self, term: int, root: float) -> float:
        """Return the parameter (not its square) where the profile's signed root is ``root``; 0 where it never is."""
        best = float(np.sqrt(self.best[term]))
        if root >= 0.0:
            if self.significance(term) <= root:
                return 0.0
            low, high = 0.0, best
        else:
            step = float(np.sqrt(self._spread()[term]))
            low, high = best, best + step
            while self.profile(term, high**2) > root:
                low, high = high, best + 2.0 * (high - best)
        return float(
            scipy.optimize.brentq(lambda p: self.profile(term, p**2) - root, low, high, xtol=1e-12 * high, rtol=1e-4)
        )

    def report(self, interval_s: float, samples: int) -> NoiseFit:
        """Return values with their intervals."""
        terms = [self._term(term, samples) for term in range(4)]
        return NoiseFit(*terms, self._ramp_term(), self.misfit, interval_s, samples)

    def _term(self, term: int, samples: int) -> NoiseTerm:
        sharpness = self._sharpness(samples) if term == _QUANTISATION else 1.0
        significance = self.significance(term) * sharpness
        lowest = _root_after_selection(significance)
        interval = (self.limit(term, lowest / sharpness), self.limit(term, -_NORMAL_975 / sharpness))
        sigma = 0.5 * (self.limit(term, -1.0 / sharpness) - self.limit(term, 1.0 / sharpness))
        return NoiseTerm(float(np.sqrt(self.best[term])), sigma, interval, significance >= SEEN_SIGMA)

    def _sharpness(self, samples: int) -> float:
        """Return by how much quantisation is known better than Gaussian noise of its size would be.

        Rounding errors are uniform: their square scatters less (excess kurtosis −1.2), and the cumulant enters the
        estimate of their variance alone. How much of it is there is taken from the readings' own fourth cumulant.
        """
        spectrum, v = self._spectrum, self.best[_QUANTISATION]
        free = self.best > 0.0
        if not free[_QUANTISATION] or self.excess.any():
            return 1.0
        fisher = _evaluate(self.best, *self._cells, False, 0.0)[2][np.ix_(free, free)]
        relative = np.linalg.inv(fisher * np.outer(self.best[free], self.best[free]))[0, 0]
        kurtosis = spectrum.kurtosis * spectrum.interval_s**4 / (2.0 * (v / 12.0) ** 2)
        return float(np.sqrt(relative / (relative + np.clip(kurtosis, -1.2, 0.0) / samples)))

    def _ramp_term(self) -> NoiseTerm:
        """Return the ramp, averaged over what flicker and random walk may be.

        A ramp shows in the same few lowest coefficients as they do; taking them at their most likely values, often 0,
        would promise too much. Each pair (B, K) of a grid gives a normal distribution of the ramp, weighted by its
        restricted likelihood and by a prior ∝ 1/(B + B₀)(K + K₀), with B₀, K₀ as large as all else in coefficient 1.
        """
        weight, centre, sigma = self._ramp_mixture()

        def tail(slope: float) -> float:
            return float(weight @ scipy.special.ndtr((slope - centre) / sigma))

        def quantile(deviate: float) -> float:
            ends = centre + deviate * sigma
            low, high = float(ends.min()), float(ends.max())
            probability = float(scipy.special.ndtr(deviate))
            if high - low <= 1e-9 * sigma.max():
                return low
            return float(scipy.optimize.brentq(lambda slope: tail(slope) - probability, low, high))

        negative = min(tail(0.0), 1.0 - tail(0.0))
        significance = -float(scipy.special.ndtri(max(negative, 1e-300)))
        value = quantile(0.0)
        sign = 1.0 if value > 0.0 else -1.0
        ends = (quantile(-sign * _root_after_selection(significance)), quantile(sign * _NORMAL_975))
        spread = 0.5 * (quantile(1.0) - quantile(-1.0))
        return NoiseTerm(value, spread, (min(ends), max(ends)), significance >= SEEN_SIGMA)

    def _ramp_mixture(self) -> tuple[Array, Array, Array]:
        """Return weights, means and σ [y/s] of the ramp over a grid of flicker and random walk."""
        spectrum = self._spectrum
        rest = spectrum.basis[:, :_FLICKER] @ self.best[:_FLICKER]
        scale = np.sqrt(np.maximum(rest[0], 1e-3 * spectrum.power[:_SINGLE].max()) / spectrum.basis[0, _FLICKER:])
        grids = [self._amplitudes(term, float(scale[term - _FLICKER])) for term in (_FLICKER, _WALK)]
        density = [np.gradient(grid) / (grid + unit) for grid, unit in zip(grids, scale, strict=True)]
        prior = np.outer(*density).ravel()
        log_likelihood, centre, information = np.empty((3, prior.size))
        v = self.best.copy()
        for index, (flicker, walk) in enumerate(itertools.product(*grids)):
            v[_FLICKER], v[_WALK] = flicker**2, walk**2
            log_likelihood[index], _, _, centre[index], information[index] = _evaluate(v, *self._cells, False, 0.0)
        weight = prior * np.exp(log_likelihood - log_likelihood.max())
        return weight / weight.sum(), spectrum.slope + centre, 1.0 / np.sqrt(information)

    def _amplitudes(self, term: int, unit: float) -> Array:
        """Return a grid of one parameter over all that its likelihood does not exclude by 6 σ."""
        top = max(unit, 2.0 * self.limit(term, -6.0))
        return np.concatenate([[0.0], np.geomspace(1e-2 * min(unit, top), top, 31)])


def _root_after_selection(significance: float) -> float:
    """Return the signed root at the lower end of the 95 % interval of a term that was looked at because seen.

    Given that the deviate exceeded the threshold, a root r has the upper tail Φ(−r)/Φ(excess − r), which is set to
    2.5 %. Far above the threshold that is 1.96; just above it the interval reaches to zero, as it must: terms too
    small to be seen are seen only when chance makes them look large.
    """
    excess = significance - SEEN_SIGMA
    if excess < 0.0:
        return _NORMAL_975
    log_ndtr = scipy.special.log_ndtr

    def tail(root: float) -> float:
        return float(log_ndtr(-root) - log_ndtr(excess - root) - np.log(0.025))

    if tail(significance) > 0.0:
        return significance
    return float(scipy.optimize.brentq(tail, _NORMAL_975 - 1e-9, significance))
