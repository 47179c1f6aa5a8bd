"""How the terms of like blocks drift in storage: one hierarchical linear Gaussian model a term, over all blocks.

Check i of block b, ``t`` months after its laboratory calibration, finds the term::

    y = o_b + s_b·h(t) + w_b(t) + e + ε
    o_b ~ N(0, offset²)          what the calibration itself left
    s_b ~ N(mean, spread²)       the block's own rate under the population's drift law h, in units of a year
    w_b                          random walk, walk²·t: what no law says
    e ~ N(0, scatter²)           from one check to the next (turn-on, temperature)
    ε ~ N(0, σ²)                 the check's own 1σ, from the covariance of its result

Law: h(t) = ((1 + t/τ)^λ − 1)/λ, scaled to h(12) = 1: linear (λ = 1), logarithmic (λ → 0), near to saturating (λ < 0)
or growing (λ > 1). The axes of one kind of sensor share the law, for it is one mechanism, and have sizes of their own:
x drifts less than y and z. The likelihood is exact (a Kalman filter a block). Nothing is fixed at its best value: law
and sizes are drawn from their posterior by a Metropolis chain, so that what few blocks leave open stands in the
forecast.

Source: the model form is that of linear growth curves with random coefficients (Laird & Ware 1982); filtering as in
Durbin & Koopman, *Time Series Analysis by State Space Methods*; the chain as in Gelman, Roberts & Gilks 1996.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from inertial.ageing_filter import log_likelihood
from inertial.compiled import compiled

Array = NDArray[np.float64]

MONTH_DAYS = 30.4375
YEAR_MONTHS = 12.0
JUMP = 1e3
"""σ of a step of unknown size, in median σ of the checks: so wide that it says nothing."""
DRAWS, APART, BURN_IN = 64, 12, 150
"""Draws of the posterior that are handed on, sweeps of the chain between two of them, and before the first."""
JUMP_SCALE = 2.38
"""Of a proposal, over the root of its dimensions: the best for a Gaussian (Gelman, Roberts & Gilks 1996)."""
LAW_MEAN, LAW_SIGMA = np.array([0.3, math.log(8.0)]), np.array([1.0, 1.0])
"""Prior of λ and ln τ [months]."""
SIZE_MEAN = np.array([0.0, math.log(3.0), 0.0, math.log(0.1), math.log(0.3)])
SIZE_SIGMA = np.array([30.0, 2.0, 1.5, 1.5, 1.5])
"""Prior of mean, ln spread, ln offset, ln walk, ln scatter, in units of the checks' median σ; walk a √month."""
FARTHEST = 6.0
"""Prior σ beyond which nothing is looked for."""
STEP = 0.02
"""Of numeric derivatives."""
SEED = 20140293


@dataclass(frozen=True)
class TermHistories:
    """One term of many blocks. Rows of block b: ``offsets[b]`` to ``offsets[b + 1]``, in order of time.

    ``months`` since the laboratory calibration, ``value`` and its 1σ ``sigma`` in SI, ``stepped``: between this check
    and the one before (or the calibration) lies a step of unknown size.
    """

    offsets: NDArray[np.int64]
    months: Array
    value: Array
    sigma: Array
    stepped: NDArray[np.bool_]

    @classmethod
    def of(cls, blocks: Sequence[tuple[Array, Array, Array]]) -> TermHistories:
        """Return the histories of blocks, each given as months, values and σ."""
        lengths = [len(months) for months, _, _ in blocks]
        offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
        months, value, sigma = (
            np.concatenate([np.asarray(block[k], dtype=np.float64) for block in blocks]) for k in range(3)
        )
        return cls(offsets, months, value, sigma, np.zeros(len(months), dtype=np.bool_))

    @property
    def jump(self) -> Array:
        """Return the variance of a step before each check: so large that it says nothing, or 0."""
        return np.where(self.stepped, (JUMP * self.unit) ** 2, 0.0)

    @property
    def blocks(self) -> int:
        """Return how many there are."""
        return len(self.offsets) - 1

    @property
    def unit(self) -> float:
        """Return the median σ of the checks: the unit in which sizes are fitted."""
        return float(np.median(self.sigma))

    def rows(self, block: int) -> slice:
        """Return the rows of one block."""
        return slice(int(self.offsets[block]), int(self.offsets[block + 1]))


@dataclass(frozen=True)
class Sizes:
    """The population: λ, τ; in SI ``mean`` and ``spread`` of the drift in the first year, ``walk`` a √month."""

    exponent: float
    law_months: float
    mean: float
    spread: float
    offset: float
    walk: float
    scatter: float

    @property
    def row(self) -> Array:
        """Return mean, spread², offset², walk², scatter², as the filter takes them."""
        return np.array([self.mean, self.spread**2, self.offset**2, self.walk**2, self.scatter**2])

    def growth(self, months: Array) -> Array:
        """Return h at ages [months], 1 after a year."""
        return np.asarray(_growth(np.asarray(months, dtype=np.float64), self.exponent, self.law_months))


@dataclass(frozen=True)
class PopulationFit:
    """What a fleet says of one term: the ``best`` sizes, and equally weighted ``draws`` of the posterior.

    Draw d of each axis of a kind has the same law.
    """

    best: Sizes
    draws: tuple[Sizes, ...]


@compiled
def _growth(months: Array, exponent: float, law_months: float) -> Array:
    aged: Array = np.log1p(months / law_months)
    year = np.log1p(12.0 / law_months)
    if abs(exponent) >= 1e-9:
        aged, year = np.expm1(exponent * aged), np.expm1(exponent * year)
    grown: Array = aged / year
    return grown


class _Axis:
    """Log posterior density of one term at (λ, ln τ, its five sizes), without the law's own prior."""

    def __init__(self, histories: TermHistories) -> None:
        unit = histories.unit
        self._unit = unit
        self._offsets, self._months = histories.offsets, histories.months
        self._values = histories.value / unit, (histories.sigma / unit) ** 2, histories.jump / unit**2

    def __call__(self, point: Array) -> float:
        deviation = (point[2:] - SIZE_MEAN) / SIZE_SIGMA
        if np.any(np.abs(deviation[1:]) > FARTHEST):
            return -math.inf
        sizes = np.concatenate([point[2:3], np.exp(2.0 * point[3:])])
        growth = _growth(self._months, float(point[0]), math.exp(point[1]))
        likelihood = log_likelihood(self._offsets, self._months, growth, *self._values, sizes)
        return likelihood - 0.5 * float(deviation @ deviation)

    def sizes(self, point: Array) -> Sizes:
        """Return a point in SI."""
        exponent, log_months, mean, *rest = point.tolist()
        sizes = (math.exp(value) * self._unit for value in rest)
        return Sizes(exponent, math.exp(log_months), mean * self._unit, *sizes)


class _Kind:
    """Log posterior of all axes of a kind at (λ, ln τ, five sizes for each axis)."""

    def __init__(self, terms: Sequence[TermHistories]) -> None:
        self.axes = [_Axis(term) for term in terms]
        own = len(SIZE_MEAN)
        self._places = [np.r_[0:2, 2 + own * k : 2 + own * (k + 1)] for k in range(len(terms))]
        self.start = np.concatenate([LAW_MEAN, *[SIZE_MEAN] * len(terms)])

    def of_axis(self, point: Array, axis: int) -> Array:
        """Return what of a point concerns one axis."""
        return np.asarray(point[self._places[axis]])

    def own_places(self, axis: int) -> NDArray[np.int64]:
        """Return where in a point an axis has its sizes."""
        return np.asarray(self._places[axis][2:])

    def heights(self, point: Array) -> Array:
        """Return the parts of the log posterior: one for each axis, then the law's prior."""
        deviation = (point[:2] - LAW_MEAN) / LAW_SIGMA
        if np.any(np.abs(deviation) > FARTHEST):
            return np.full(len(self.axes) + 1, -math.inf)
        own = [axis(self.of_axis(point, number)) for number, axis in enumerate(self.axes)]
        return np.array([*own, -0.5 * float(deviation @ deviation)])

    def __call__(self, point: Array) -> float:
        """Return their sum."""
        return float(np.sum(self.heights(point)))

    def gradient(self, point: Array) -> Array:
        """Return the slope by central differences, an axis at a time: nothing of one axis concerns another's sizes."""
        slope = np.zeros(len(point))
        slope[:2] = -(point[:2] - LAW_MEAN) / LAW_SIGMA**2
        for number, axis in enumerate(self.axes):
            here = self.of_axis(point, number)
            for own, place in enumerate(self._places[number]):
                shift = STEP * (np.arange(len(here)) == own)
                slope[place] += (axis(here + shift) - axis(here - shift)) / (2.0 * STEP)
        return slope

    def depth(self, point: Array) -> float:
        """Return minus the log posterior: what is lowest at the peak."""
        return -self(point)

    def depth_slope(self, point: Array) -> Array:
        """Return its slope."""
        return np.negative(self.gradient(point))

    def curvature(self, point: Array) -> Array:
        """Return minus the second derivatives, likewise, from differences of the slope."""
        count = len(point)
        shifts = STEP * np.eye(count)
        rows = [(self.gradient(point - shift) - self.gradient(point + shift)) / (2.0 * STEP) for shift in shifts]
        return 0.5 * np.asarray(np.array(rows) + np.array(rows).T)


def best_sizes(terms: Sequence[TermHistories]) -> list[Sizes]:
    """Return each axis's sizes at the peak of the posterior: all that a search for steps needs."""
    posterior = _Kind(terms)
    peak = _peak(posterior)
    return [axis.sizes(posterior.of_axis(peak, number)) for number, axis in enumerate(posterior.axes)]


def fit_population(terms: Sequence[TermHistories]) -> list[PopulationFit]:
    """Fit the terms of one kind of sensor (its axes): sizes of their own, the law in common.

    Parameters
    ----------
    terms
        The axes' histories, of the same blocks or not.

    Returns
    -------
    One fit a term. The same histories give the same fit.
    """
    posterior = _Kind(terms)
    peak = _peak(posterior)
    draws = _drawn(posterior, peak, np.random.default_rng(SEED))
    return [
        PopulationFit(
            axis.sizes(posterior.of_axis(peak, number)),
            tuple(axis.sizes(posterior.of_axis(draw, number)) for draw in draws),
        )
        for number, axis in enumerate(posterior.axes)
    ]


def _peak(posterior: _Kind) -> Array:
    below, slope = posterior.depth, posterior.depth_slope
    found = minimize(below, posterior.start, jac=slope, method="BFGS", options={"gtol": 0.05})
    return np.asarray(found.x)


def _drawn(posterior: _Kind, peak: Array, rng: np.random.Generator) -> list[Array]:
    """Return draws of a Metropolis chain that starts at the peak.

    A sweep moves the sizes of each axis, then the law with all sizes along the ridge that the curvature at the peak
    tells of. Shapes and sizes of the moves are from that curvature as well.
    """
    curvature = posterior.curvature(peak)
    values, vectors = np.linalg.eigh(curvature)
    precision = (vectors * np.maximum(values, SIZE_SIGMA.max() ** -2.0)) @ vectors.T
    own = [posterior.own_places(axis) for axis in range(len(posterior.axes))]
    roots = [_root(np.linalg.inv(precision[np.ix_(places, places)])) for places in own]
    law_root = _root(np.linalg.inv(precision)[:2, :2])
    ridge = np.vstack([np.eye(2), -np.linalg.solve(precision[2:, 2:], precision[2:, :2])])
    point, heights = peak.copy(), posterior.heights(peak)
    draws = []
    for sweep in range(1, BURN_IN + DRAWS * APART + 1):
        for axis, places in enumerate(own):
            moved = point.copy()
            moved[places] += roots[axis] @ rng.standard_normal(len(places))
            height = posterior.axes[axis](posterior.of_axis(moved, axis))
            if math.log(rng.random()) < height - heights[axis]:
                point, heights[axis] = moved, height
        moved = point + ridge @ (law_root @ rng.standard_normal(2))
        proposed = posterior.heights(moved)
        if math.log(rng.random()) < float(np.sum(proposed) - np.sum(heights)):
            point, heights = moved, proposed
        if sweep > BURN_IN and (sweep - BURN_IN) % APART == 0:
            draws.append(point.copy())
    return draws


def _root(covariance: Array) -> Array:
    return np.asarray(np.linalg.cholesky(covariance)) * JUMP_SCALE / math.sqrt(len(covariance))


def with_steps(histories: TermHistories, rows: Sequence[int]) -> TermHistories:
    """Return the same histories with steps of unknown size just before these rows."""
    stepped = np.zeros(len(histories.value), dtype=np.bool_)
    stepped[list(rows)] = True
    return replace(histories, stepped=stepped)
