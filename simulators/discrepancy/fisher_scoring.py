"""The variances of noise terms that are most likely, by Fisher scoring in which none becomes negative.

Each round takes the step to the top of a parabola that has the slope of Whittle's likelihood (Arkiv för Matematik 2,
1953) and the information in the terms, where variances may not go below zero; half of it, or less, where that would
lead down. M. R. Osborne, Fisher's method of scoring, International Statistical Review 60 (1992). Terms of noise are
nearly alike: steps that only multiply each variance are nats below the top after hundreds of rounds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from inertial.compiled import compiled

Array = NDArray[np.float64]

_ROUNDS, _SWEEPS, _HALVINGS = 60, 200, 12
_TOP_NATS = 1e-3  # that the last round gained
_SETTLED_NATS = 1e-7  # that the last sweep over the terms moved any of them by
_SLACK = 1e-9  # of its information that keeps a term from one just like it


@compiled
def climb(basis: Array, rss: Array, freedom: Array, floor: Array, variances: Array, first: int) -> None:
    """Raise Whittle's likelihood to the top by the variances of terms, which change in place and stay 0 or more.

    Parameters
    ----------
    basis : (b, k) power of each term by its variance
    rss, freedom : (b,) sums of squares of coefficients, and how many they are
    floor : (b,) power that is there beside the terms
    variances : (k,) where to begin
    first : bin before which none counts
    """
    value = _likelihood(basis, rss, freedom, floor, variances, first)
    for _ in range(_ROUNDS):
        slope, information = _slope_and_information(basis, rss, freedom, floor, variances, first)
        step = _step(slope, information, variances)
        gained = 0.0
        for halving in range(_HALVINGS):
            trial = np.maximum(variances + step / 2.0**halving, 0.0)
            gained = _likelihood(basis, rss, freedom, floor, trial, first) - value
            if gained > 0.0:
                variances[:] = trial
                value += gained
                break
        if not gained > _TOP_NATS:
            break


@compiled
def _likelihood(basis: Array, rss: Array, freedom: Array, floor: Array, variances: Array, first: int) -> float:
    value = 0.0
    for b in range(first, basis.shape[0]):
        power = floor[b]
        for j in range(basis.shape[1]):
            power += basis[b, j] * variances[j]
        value -= 0.5 * (freedom[b] * np.log(power) + rss[b] / power)
    return value


@compiled
def _slope_and_information(
    basis: Array, rss: Array, freedom: Array, floor: Array, variances: Array, first: int
) -> tuple[Array, Array]:
    """Return twice the slope (k,) of the likelihood, and twice the Fisher information (k, k) of the variances."""
    terms = basis.shape[1]
    slope, information = np.zeros(terms), np.zeros((terms, terms))
    for b in range(first, basis.shape[0]):
        power = floor[b]
        for j in range(terms):
            power += basis[b, j] * variances[j]
        beyond, weight = (rss[b] / power - freedom[b]) / power, freedom[b] / power**2
        for i in range(terms):
            slope[i] += basis[b, i] * beyond
            for j in range(i + 1):
                information[i, j] += weight * basis[b, i] * basis[b, j]
    for i in range(terms):
        information[i, i] *= 1.0 + _SLACK
        for j in range(i):
            information[j, i] = information[i, j]
    return slope, information


@compiled
def _step(slope: Array, information: Array, variances: Array) -> Array:
    """Return the step (k,) to the top of a parabola where no variance is negative, term by term in turn."""
    terms = slope.size
    step, left = np.zeros(terms), slope.copy()
    for _ in range(_SWEEPS):
        largest = 0.0
        for i in range(terms):
            if information[i, i] > 0.0:
                change = max(step[i] + left[i] / information[i, i], -variances[i]) - step[i]
                if change != 0.0:
                    step[i] += change
                    largest = max(largest, change**2 * information[i, i])
                    for j in range(terms):
                        left[j] -= information[j, i] * change
        if largest < _SETTLED_NATS:
            break
    return step
