"""The variances of noise terms that are most likely, by Fisher scoring in which none becomes negative.

Each round goes to the top of a parabola that has the slope of Whittle's likelihood (Arkiv för Matematik 2, 1953) and
the information in the terms, where variances may not go below zero; half the way, or less, where that would lead down.
M. R. Osborne, Fisher's method of scoring, International Statistical Review 60 (1992). Terms of noise are nearly alike:
steps that only multiply each variance, or change one after the other, are nats below the top after hundreds of rounds.
So the top is found by the active set of C. L. Lawson & R. J. Hanson, Solving Least Squares Problems (1974), chapter 23.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from inertial.compiled import compiled

Array = NDArray[np.float64]

_ROUNDS, _HALVINGS = 60, 12
_TOP_NATS = 1e-3  # that the last round gained
_ENTERS_NATS = 1e-12  # that a term must promise to be there at all
_SLACK = 1e-9  # of its information that keeps a term from one just like it
_LEAST = 1e-14  # of its information that is its own, or rounding leaves nothing


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
        step = top(slope + _product(information, variances), information, variances) - variances
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
def top(target: Array, information: Array, start: Array) -> Array:
    """Return where target · x - x · information · x / 2 is largest of all x that are nowhere negative.

    Parameters
    ----------
    target : (k,)
    information : (k, k) symmetric, positive definite
    start : (k,) not negative; what is positive of it is taken to stay so at first
    """
    at, there = start.copy(), start > 0.0
    for _ in range(_ROUNDS):
        _to_top_within(at, there, target, information)
        left = target - _product(information, at)
        best, most = -1, _ENTERS_NATS
        for i in range(at.size):
            if not there[i] and left[i] > 0.0 and left[i] ** 2 > most * information[i, i] > 0.0:
                best, most = i, left[i] ** 2 / information[i, i]
        if best < 0:
            break
        there[best] = True
    return at


@compiled
def _to_top_within(at: Array, there: NDArray[np.bool_], target: Array, information: Array) -> None:
    """Go to the top of all that is ``there``, without what would become negative on the way; both change in place."""
    while True:
        aim = _solution(there, target, information)
        share, first = 1.0, -1
        for i in range(at.size):
            if there[i] and aim[i] < 0.0 and at[i] < share * (at[i] - aim[i]):
                share, first = at[i] / (at[i] - aim[i]), i
        at += share * (aim - at)
        if first < 0:
            break
        there[first], at[first] = False, 0.0


@compiled
def _solution(there: NDArray[np.bool_], target: Array, information: Array) -> Array:
    """Return the solution (k,) of the normal equations of what is ``there`` by Cholesky's factor; elsewhere nothing."""
    ids = np.flatnonzero(there)
    factor, solution = np.zeros((ids.size, ids.size)), np.zeros(there.size)
    for i in range(ids.size):
        for j in range(i + 1):
            shared = information[ids[i], ids[j]]
            for k in range(j):
                shared -= factor[i, k] * factor[j, k]
            if j < i:
                factor[i, j] = shared / factor[j, j]
            else:
                factor[i, i] = np.sqrt(max(shared, _LEAST * information[ids[i], ids[i]]))
    for i in range(ids.size):
        left = target[ids[i]]
        for k in range(i):
            left -= factor[i, k] * solution[ids[k]]
        solution[ids[i]] = left / factor[i, i]
    for i in range(ids.size - 1, -1, -1):
        left = solution[ids[i]]
        for k in range(i + 1, ids.size):
            left -= factor[k, i] * solution[ids[k]]
        solution[ids[i]] = left / factor[i, i]
    return solution


@compiled
def _product(matrix: Array, vector: Array) -> Array:
    """Return a product (k,) summed up in one order on every machine."""
    product = np.zeros(vector.size)
    for i in range(vector.size):
        for j in range(vector.size):
            product[i] += matrix[i, j] * vector[j]
    return product
