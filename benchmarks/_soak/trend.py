"""Whether a measured level grows: its slope with a σ that knows how slowly the level forgets.

Readings of memory in use are anything but independent: a level, once reached, stays for many readings. A straight line
through them with the textbook σ would find "growth" in every wander. The readings are therefore averaged over spans
and the line is fitted by generalised least squares with first-order autoregressive errors (Prais and Winsten 1954),
the correlation estimated from the residuals with Kendall's (1954) correction for short series. Spans of one life of
the process share a level; every life has a level of its own, all lives share the slope. Where neighbours correlate by
0.8 and there are fewer than a hundred spans, growth is still found a little too often (a tenth of the time at 5 %): it
errs on the side of alarm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]
ROUNDS = 10
LARGEST_CORRELATION = 0.99


@dataclass(frozen=True)
class Trend:
    """Slope per unit of time with its 1σ, the correlation of neighbours, and the degrees of freedom."""

    slope: float
    sigma: float
    correlation: float
    freedom: int

    @property
    def p_value(self) -> float:
        """Probability of a slope at least so far from zero when there is none (Student's t, two-sided)."""
        return float(2.0 * stats.t.sf(abs(self.slope) / self.sigma, self.freedom))

    def upper(self, confidence: float = 0.95) -> float:
        """Slope that is not exceeded with this confidence."""
        return float(self.slope + stats.t.ppf(confidence, self.freedom) * self.sigma)


def trend_of(lives: list[tuple[Array, Array]]) -> Trend | None:
    """Return the common slope of several lives, each its times and levels at equal spacing; None: too few to tell."""
    lives = [(np.asarray(time, float), np.asarray(level, float)) for time, level in lives if len(time) >= 3]
    count = sum(len(time) for time, _ in lives)
    if count - len(lives) - 2 < 3:
        return None
    correlation = 0.0
    for _ in range(ROUNDS):
        slope, sigma, residuals = _fit(lives, correlation)
        found = _correlation(residuals, count)
        if abs(found - correlation) < 1e-4:
            break
        correlation = found
    return Trend(slope, sigma, correlation, count - len(lives) - 2)  # the correlation costs one as well


def spans(time: Array, level: Array, width: float) -> tuple[Array, Array]:
    """Return the means of time and level over spans of equal width, an unfinished last one left out."""
    number = np.floor((time - time[0]) / width).astype(int)
    whole = [np.flatnonzero(number == one) for one in range(number[-1])]
    whole = [rows for rows in whole if len(rows)]
    return np.array([time[rows].mean() for rows in whole]), np.array([level[rows].mean() for rows in whole])


def _fit(lives: list[tuple[Array, Array]], correlation: float) -> tuple[float, float, list[Array]]:
    """Return slope, its σ, and the residuals by life, before whitening."""
    rows, values, plain = [], [], []
    for number, (time, level) in enumerate(lives):
        design = np.zeros((len(time), len(lives) + 1))
        design[:, number], design[:, -1] = 1.0, time - time.mean()
        plain.append(design)
        rows.append(_whiten(design, correlation))
        values.append(_whiten(level[:, None], correlation)[:, 0])
    design, value = np.vstack(rows), np.concatenate(values)
    inverse = np.linalg.inv(design.T @ design)
    fitted = inverse @ design.T @ value
    left = value - design @ fitted
    variance = float(left @ left) / max(len(value) - design.shape[1] - 1, 1)
    residuals = [level - before @ fitted for before, (_, level) in zip(plain, lives, strict=True)]
    return float(fitted[-1]), float(np.sqrt(variance * inverse[-1, -1])), residuals


def _whiten(rows: Array, correlation: float) -> Array:
    first = rows[:1] * np.sqrt(1.0 - correlation**2)
    return np.vstack([first, rows[1:] - correlation * rows[:-1]])


def _correlation(residuals: list[Array], count: int) -> float:
    """Return the lag-one correlation of the residuals, corrected for the shortness of the series."""
    across = sum(float(one[1:] @ one[:-1]) for one in residuals)
    along = sum(float(one @ one) for one in residuals)
    raw = across / along if along > 0 else 0.0
    return float(np.clip(raw + (1.0 + 4.0 * raw) / count, 0.0, LARGEST_CORRELATION))  # (1 + 4ρ)/n with a line removed
