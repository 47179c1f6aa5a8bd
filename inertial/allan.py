"""Overlapping Allan deviation of a channel, with the confidence of each point.

From the integral x of the readings at interval τ0 (angle or velocity), N + 1 points from N readings, at τ = m τ0:

    σ²(τ) = 1 / (2 τ² (N + 1 − 2m)) Σ (x[i+2m] − 2 x[i+m] + x[i])²

(IEEE Std 952-1997, C.1; NIST SP 1065, eq. 11). The integral is formed once, of the readings less their mean and by
compensated summation, so that a large constant part (gravity) costs no digits; it is the only array as long as the
record. The sums over it run in a fixed order: the same digits on every run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.special

from inertial.compiled import compiled

Array = npt.NDArray[np.float64]
_BLOCK, _LANES = 2048, 32  # 16 kB: the block and its two shifted copies fit the first-level cache
_TELLING = 50.0  # degrees of freedom from which neighbouring points show the slope between them


@dataclass(frozen=True)
class AllanCurve:
    """Overlapping Allan deviation.

    Attributes
    ----------
    averaging_s : (k,) averaging times τ [s]
    deviation : (k,) Allan deviation [unit of the readings]
    freedom : (k,) equivalent degrees of freedom of the variance, for the noise that the local slope shows; where few
        are left to show it, for the noise with the fewest
    terms : (k,) number of second differences averaged
    """

    averaging_s: Array
    deviation: Array
    freedom: Array
    terms: npt.NDArray[np.int64]

    def interval(self, confidence: float = 0.95) -> tuple[Array, Array]:
        """Return the ends (k,), (k,) of the interval of the true deviation: χ² with ``freedom`` (SP 1065, 5.3)."""
        tail = 0.5 * (1.0 - confidence)
        half = 0.5 * self.freedom
        low = self.deviation * np.sqrt(half / scipy.special.gammaincinv(half, 1.0 - tail))
        high = self.deviation * np.sqrt(half / scipy.special.gammaincinv(half, tail))
        return low, high


def averaging_factors(samples: int, count: int = 100) -> npt.NDArray[np.int64]:
    """Return up to ``count`` whole averaging factors m, evenly spaced in logarithm from 1 to a third of the record."""
    return np.unique(np.round(np.geomspace(1, max(samples // 3, 1), count)).astype(np.int64))


def overlapping_allan(rate: npt.ArrayLike, interval_s: float, factors: npt.ArrayLike | None = None) -> AllanCurve:
    """Return the overlapping Allan deviation of one channel.

    Parameters
    ----------
    rate : (n,) readings, each the mean over its interval [any unit]
    interval_s : sampling interval τ0 [s]
    factors : whole averaging factors m (τ = m τ0), each from 1 to n/2; default :func:`averaging_factors`

    Raises
    ------
    ValueError
        When the readings are not one finite channel, the interval is not positive or a factor is out of range.
    """
    readings = np.ascontiguousarray(rate, dtype=np.float64)
    if readings.ndim != 1 or readings.size < 2:
        raise ValueError(f"readings of one channel are (n,) with n of 2 or more, got {readings.shape}")
    if not np.isfinite(interval_s) or interval_s <= 0.0:
        raise ValueError(f"sampling interval must be positive, got {interval_s} s")
    chosen = averaging_factors(readings.size) if factors is None else np.asarray(factors)
    multiples = np.unique(chosen.astype(np.int64))
    if multiples.size == 0 or np.any(multiples != np.unique(chosen)):
        raise ValueError("averaging factors must be whole numbers")
    if multiples[0] < 1 or 2 * multiples[-1] > readings.size:
        raise ValueError(f"averaging factors must lie from 1 to {readings.size // 2}, half the record")
    integral = _integral(readings, float(readings.mean()))
    if not np.isfinite(integral[-1]):
        raise ValueError("readings hold NaN or infinity; cut them out first")
    terms = readings.size + 1 - 2 * multiples
    variance = _mean_squares(integral, multiples) / (2.0 * multiples.astype(np.float64) ** 2)
    freedom = _freedom(multiples, readings.size + 1, variance)
    return AllanCurve(np.asarray(multiples * interval_s), np.sqrt(variance), freedom, terms)


@compiled
def _integral(readings: Array, mean: float) -> Array:
    """Return (n + 1,) running sum of the readings less their mean, each element rounded once (Knuth's two-sum)."""
    integral = np.empty(readings.size + 1)
    integral[0] = 0.0
    total, lost = 0.0, 0.0
    for i in range(readings.size):
        value = readings[i] - mean
        new = total + value
        part = new - total
        lost += (total - (new - part)) + (value - part)
        total = new
        integral[i + 1] = total + lost
    return integral


@compiled
def _mean_squares(x: Array, multiples: npt.NDArray[np.int64]) -> Array:
    """Return the mean square second difference of x (n,) at each lag, in ascending order.

    A block of x serves every lag while it is in the processor's cache, and sums run side by side in lanes: the
    compiler then keeps its vector units busy without being allowed to reorder a sum.
    """
    sums = np.zeros(multiples.size)
    lanes = np.empty(_LANES)
    for start in range(0, x.size, _BLOCK):
        for k in range(multiples.size):
            m = multiples[k]
            stop = min(start + _BLOCK, x.size - 2 * m)
            if stop <= start:
                break
            lanes[:] = 0.0
            whole = start + (stop - start) // _LANES * _LANES
            for i in range(start, whole, _LANES):
                first, middle, last = x[i : i + _LANES], x[i + m : i + m + _LANES], x[i + 2 * m : i + 2 * m + _LANES]
                for lane in range(_LANES):
                    difference = last[lane] - 2.0 * middle[lane] + first[lane]
                    lanes[lane] += difference * difference
            for i in range(whole, stop):
                difference = x[i + 2 * m] - 2.0 * x[i + m] + x[i]
                lanes[0] += difference * difference
            block = 0.0
            for lane in range(_LANES):
                block += lanes[lane]
            sums[k] += block
    return sums / (x.size - 2 * multiples)


def _freedom(multiples: npt.NDArray[np.int64], points: int, variance: Array) -> Array:
    """Return equivalent degrees of freedom (NIST SP 1065, table 5) for the noise of the curve's local slope.

    Where the curve is too uncertain to tell a slope, the noise with the fewest is taken.
    """
    m, n = multiples.astype(np.float64), float(points)
    quantisation = (n + 1.0) * (n - 2.0 * m) / (2.0 * (n - m))
    white = (1.5 * (n - 1.0) / m - 2.0 * (n - 2.0) / n) * 4.0 * m**2 / (4.0 * m**2 + 5.0)
    flicker = np.where(m == 1.0, 2.0 * (n - 2.0) ** 2 / (2.3 * n - 4.9), 1.25 * n**2 / (m * (n + 3.0 * m)))
    walk = (n - 2.0) / m * ((n - 1.0) ** 2 - 3.0 * m * (n - 1.0) + 4.0 * m**2) / max(n - 3.0, 1.0) ** 2
    fewest = np.minimum(np.minimum(white, flicker), walk)
    slope = np.zeros(m.size)
    if m.size > 1:
        slope[1:] = np.diff(np.log(np.maximum(variance, 1e-300))) / np.diff(np.log(m))
        slope[0] = slope[1]
    certain = (fewest >= _TELLING) & (m.size > 1)
    by_slope = np.select([slope < -1.5, slope < -0.5, slope < 0.5], [quantisation, white, flicker], walk)
    return np.asarray(np.maximum(np.where(certain, by_slope, fewest), 1.0))
