"""How the terms of like blocks drift in storage: one hierarchical linear Gaussian model a term, over all blocks.

Check i of block b, ``t`` months after its laboratory calibration, finds the term::

    y = o_b + s_b·h(t) + w_b(t) + e + ε
    o_b ~ N(0, offset²)          what the calibration itself left
    s_b ~ N(mean, spread²)       the block's own rate under the population's drift law h, in units of a year
    w_b                          random walk, what no law says: dw = −w/relaxation·dt + walk·dB, from 0
    e ~ N(0, scatter²)           from one check to the next (turn-on, temperature)
    ε ~ N(0, σ²)                 the check's own 1σ, from the covariance of its result

The law h is one of :mod:`inertial.ageing_law`. What the walk gathers is pulled back within its relaxation (an
Ornstein–Uhlenbeck process); one much longer than the histories leaves the walk free. The axes of one kind of sensor
share law and relaxation, for it is one mechanism, and have sizes of their own: x drifts less than y and z. The
likelihood is exact (a Kalman filter a block). Nothing is fixed at its best value: law and sizes are drawn from their
posterior by a Metropolis chain, so that what few blocks leave open stands in the forecast.

Source: the model form is that of linear growth curves with random coefficients (Laird & Ware 1982); filtering as in
Durbin & Koopman, *Time Series Analysis by State Space Methods*; the chain as in Gelman, Roberts & Gilks 1996.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import ndtri

from inertial.ageing_filter import log_likelihood
from inertial.ageing_law import DriftLaw

Array = NDArray[np.float64]

MONTH_DAYS = 30.4375
JUMP = 1e3
"""σ of a step of unknown size, in median σ of the checks: so wide that it says nothing."""
DRAWS, APART, BURN_IN, SHARED_MOVES = 64, 24, 300, 4
"""Draws of the posterior that are handed on, sweeps of the chain between two of them and before the first; moves of
what the axes share in a sweep, for that hangs together most."""
JUMP_SCALE = 2.38
"""Of a proposal, over the root of its dimensions: the best for a Gaussian (Gelman, Roberts & Gilks 1996)."""
SHARED_MEAN = np.array([0.4, 0.4, 0.0, math.log(3.5), math.log(60.0)])
SHARED_SIGMA = np.array([1.0, 0.7, 0.1, 1.5, 1.5])
"""Prior of what the axes share: the law's decline, bend, onset and ln τ [months], to which power (bend 0) and
exponential (1) are alike; and ln relaxation [months], of which two years of checks say next to nothing: 90 % of it lies
between five months, hardly a walk, and sixty years, a free one."""
STRAY_MEAN, STRAY_SIGMA = -0.15, 0.3
"""Power of time by which the rate goes off the fitted law beyond the ages that were checked: what drifts in storage
settles rather than not. Chosen so that 90 % intervals of fleets by nine laws hold 90 % of the truth: docs/ageing.md."""
KNOWN_TO = 0.9
"""Quantile of the blocks' ages up to which their law is taken to be known."""
BEND, SHARED = 1, len(SHARED_MEAN)
BENDS = np.array([[0.2, SHARED_MEAN[BEND], SHARED_SIGMA[BEND]], [0.45, 0.0, 0.15], [0.35, 1.0, 0.2]])
"""Prior of the bend: share, mean, σ of its parts. A fifth is what the bend may be at all; the rest lies about the
powers of time (and the logarithm) and about the exponential, which are what storage is known to do. Two years of checks
leave a ridge of bend and τ whose forecasts are years apart; all of them lean to one side of it where the laws with a
name have no weight of their own."""
SIZE_MEAN = np.array([0.0, math.log(3.0), 0.0, math.log(0.1), math.log(0.3)])
SIZE_SIGMA = np.array([30.0, 2.0, 1.5, 1.5, 1.5])
"""Prior of mean, ln spread, ln offset, ln walk, ln scatter, in units of the checks' median σ; walk a √month."""
FARTHEST = 6.0
"""Prior σ beyond which nothing is looked for."""
STEP = 1e-3
"""Of numeric derivatives."""
START_DECLINES, START_RELAXATIONS = (-0.4, 0.0, 0.4, 0.8, 1.6), (10.0, 1000.0)
START_SPREADS, START_WALKS = (1.0, 3.0, 10.0, 30.0, 100.0), (0.1, 1.0)
"""Where the search for the peak may begin; sizes in units of the checks' median σ."""
STARTS = 8
"""Of the search for the peak, at most, each where the last one lost its way: what it learnt of the curvature far from
the peak may mislead it nearer by."""
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
    def known_months(self) -> float:
        """Return the age up to which the law of these blocks is known: one that some of them are beyond."""
        ages = self.months[self.offsets[1:] - 1]
        return float(np.quantile(ages, KNOWN_TO, method="inverted_cdf"))

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
    """The population: its drift ``law``; in SI ``mean`` and ``spread`` of the first year, ``walk`` a √month.

    The walk is pulled back within ``relaxation_months``; infinite: it is free.
    """

    law: DriftLaw
    mean: float
    spread: float
    offset: float
    walk: float
    scatter: float
    relaxation_months: float

    @property
    def row(self) -> Array:
        """Return mean, spread², offset², walk², scatter² and the walk's pull [1/month], as the filter takes them."""
        squares = np.square([self.spread, self.offset, self.walk, self.scatter])
        return np.array([self.mean, *squares, 1.0 / self.relaxation_months])


@dataclass(frozen=True)
class PopulationFit:
    """What a fleet says of one term: the ``best`` sizes, and equally weighted ``draws`` of the posterior.

    Draw d of each axis of a kind has the same law and relaxation.
    """

    best: Sizes
    draws: tuple[Sizes, ...]


class _Axis:
    """Log posterior density of one term at (what axes share, its five sizes), without the prior of the former."""

    def __init__(self, histories: TermHistories) -> None:
        unit = histories.unit
        self._unit = unit
        self._offsets, self._months = histories.offsets, histories.months
        self._ages, self._age = np.unique(histories.months, return_inverse=True)
        self._values = histories.value / unit, (histories.sigma / unit) ** 2, histories.jump / unit**2

    def __call__(self, point: Array) -> float:
        own = point[SHARED:]
        deviation = (own - SIZE_MEAN) / SIZE_SIGMA
        if np.any(np.abs(deviation[1:]) > FARTHEST):
            return -math.inf
        sizes = np.array([own[0], *np.exp(2.0 * own[1:]), math.exp(-point[SHARED - 1])])
        growth = _law(point).growth(self._ages)[self._age]
        likelihood = log_likelihood(self._offsets, self._months, growth, *self._values, sizes)
        return likelihood - 0.5 * float(deviation @ deviation)

    def sizes(self, point: Array) -> Sizes:
        """Return a point in SI."""
        mean = float(point[SHARED]) * self._unit
        spread, offset, walk, scatter = (np.exp(point[SHARED + 1 :]) * self._unit).tolist()
        return Sizes(_law(point), mean, spread, offset, walk, scatter, math.exp(point[SHARED - 1]))

    def point(self, sizes: Sizes) -> Array:
        """Return sizes in SI as a point."""
        own = [sizes.spread, sizes.offset, sizes.walk, sizes.scatter]
        law = [sizes.law.decline, sizes.law.bend, sizes.law.onset]
        times = np.log([sizes.law.law_months, sizes.relaxation_months])
        return np.array([*law, *times, sizes.mean / self._unit, *np.log(np.array(own) / self._unit)])


def _starts(shared: Array) -> Iterator[Array]:
    """Yield points of one axis with this law and relaxation, spread and walk between small and large."""
    mean, _, offset, _, scatter = SIZE_MEAN
    for spread, walk in itertools.product(START_SPREADS, START_WALKS):
        yield np.array([*shared, mean, math.log(spread), offset, math.log(walk), scatter])


def _law(point: Array) -> DriftLaw:
    decline, bend, onset, log_months, _ = point[:SHARED].tolist()
    return DriftLaw(decline, bend, onset, math.exp(log_months))


def _prior(shared: Array) -> tuple[float, Array]:
    """Return the log prior density of what the axes share, up to a constant, and its slope."""
    deviation = (shared - SHARED_MEAN) / SHARED_SIGMA
    if np.any(np.abs(deviation) > FARTHEST):
        return -math.inf, np.zeros(SHARED)
    share, mean, sigma = BENDS.T
    apart = (shared[BEND] - mean) / sigma
    parts = share / sigma * np.exp(-0.5 * apart**2)
    slope = -deviation / SHARED_SIGMA
    slope[BEND] = -float(parts @ (apart / sigma)) / float(parts.sum())
    deviation[BEND] = 0.0
    return math.log(parts.sum()) - 0.5 * float(deviation @ deviation), slope


class _Kind:
    """Log posterior of all axes of a kind at (what they share, five sizes for each axis)."""

    def __init__(self, terms: Sequence[TermHistories]) -> None:
        self.axes = [_Axis(term) for term in terms]
        own = len(SIZE_MEAN)
        self._places = [np.r_[0:SHARED, SHARED + own * k : SHARED + own * (k + 1)] for k in range(len(terms))]

    def start(self) -> Array:
        """Return the best of a few coarse points: from a law far off, the way to the peak of a long history is lost."""
        best, height = SHARED_MEAN, -math.inf
        for decline, relaxation in itertools.product(START_DECLINES, START_RELAXATIONS):
            shared = np.array([decline, *SHARED_MEAN[1:-1], math.log(relaxation)])
            own = [max(_starts(shared), key=axis) for axis in self.axes]
            point = np.concatenate([shared, *[one[SHARED:] for one in own]])
            if (here := self(point)) > height:
                best, height = point, here
        return best

    def of_axis(self, point: Array, axis: int) -> Array:
        """Return what of a point concerns one axis."""
        return np.asarray(point[self._places[axis]])

    def own_places(self, axis: int) -> NDArray[np.int64]:
        """Return where in a point an axis has its sizes."""
        return np.asarray(self._places[axis][SHARED:])

    def sizes(self, point: Array) -> list[Sizes]:
        """Return every axis's sizes at a point."""
        return [axis.sizes(self.of_axis(point, number)) for number, axis in enumerate(self.axes)]

    def point(self, sizes: Sequence[Sizes]) -> Array:
        """Return the point at which the axes have these sizes, with one law and relaxation."""
        own = [axis.point(one) for axis, one in zip(self.axes, sizes, strict=True)]
        return np.concatenate([own[0][:SHARED], *[point[SHARED:] for point in own]])

    def heights(self, point: Array) -> Array:
        """Return the parts of the log posterior: one for each axis, then the prior of what they share."""
        prior = _prior(point[:SHARED])[0]
        if prior == -math.inf:
            return np.full(len(self.axes) + 1, -math.inf)
        own = [axis(self.of_axis(point, number)) for number, axis in enumerate(self.axes)]
        return np.array([*own, prior])

    def __call__(self, point: Array) -> float:
        """Return their sum."""
        return float(np.sum(self.heights(point)))

    def gradient(self, point: Array) -> Array:
        """Return the slope by central differences, an axis at a time: nothing of one axis concerns another's sizes."""
        slope = np.zeros(len(point))
        slope[:SHARED] = _prior(point[:SHARED])[1]
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


def best_sizes(terms: Sequence[TermHistories], near: Sequence[Sizes] | None = None) -> list[Sizes]:
    """Return each axis's sizes at the peak of the posterior: all that a search for steps needs.

    ``near``: where to begin looking; it saves time and changes nothing else.
    """
    posterior = _Kind(terms)
    return posterior.sizes(_peak(posterior, near))


def fit_population(terms: Sequence[TermHistories], near: Sequence[Sizes] | None = None) -> list[PopulationFit]:
    """Fit the terms of one kind of sensor (its axes): sizes of their own, law and relaxation in common.

    Parameters
    ----------
    terms
        The axes' histories, of the same blocks or not.
    near
        Where to begin looking for the peak.

    Returns
    -------
    One fit a term. The same histories give the same fit.
    """
    posterior = _Kind(terms)
    peak = _peak(posterior, near)
    draws = _stray([posterior.sizes(draw) for draw in _drawn(posterior, peak, np.random.default_rng(SEED))])
    best = [_straying(one, STRAY_MEAN) for one in posterior.sizes(peak)]
    return [PopulationFit(one, tuple(draw[number] for draw in draws)) for number, one in enumerate(best)]


def _stray(draws: Sequence[Sequence[Sizes]]) -> list[list[Sizes]]:
    """Return draws whose laws stray, each as likely by as much; the same for all axes of a draw."""
    quantiles = ndtri((np.arange(len(draws)) + 0.5) / len(draws))
    strays = STRAY_MEAN + STRAY_SIGMA * np.random.default_rng([SEED, 1]).permutation(quantiles)
    return [[_straying(one, float(stray)) for one in draw] for draw, stray in zip(draws, strays, strict=True)]


def _straying(sizes: Sizes, stray: float) -> Sizes:
    return replace(sizes, law=replace(sizes.law, stray=stray))


def _peak(posterior: _Kind, near: Sequence[Sizes] | None) -> Array:
    below, slope = posterior.depth, posterior.depth_slope
    start = posterior.start() if near is None else posterior.point(near)
    for _ in range(STARTS):
        found = minimize(below, start, jac=slope, method="BFGS", options={"gtol": 0.2})
        start = np.asarray(found.x)
        if found.success:
            break
    return start


def _drawn(posterior: _Kind, peak: Array, rng: np.random.Generator) -> list[Array]:
    """Return draws of a Metropolis chain that starts at the peak.

    A sweep moves the sizes of each axis, then what they share with all sizes along the ridge that the curvature at the
    peak tells of. Shapes and sizes of the moves are from that curvature as well.
    """
    curvature = posterior.curvature(peak)
    values, vectors = np.linalg.eigh(curvature)
    precision = (vectors * np.maximum(values, SIZE_SIGMA.max() ** -2.0)) @ vectors.T
    own = [posterior.own_places(axis) for axis in range(len(posterior.axes))]
    roots = [_root(np.linalg.inv(precision[np.ix_(places, places)])) for places in own]
    shared_root = _root(np.linalg.inv(precision)[:SHARED, :SHARED])
    ridge = np.vstack([np.eye(SHARED), -np.linalg.solve(precision[SHARED:, SHARED:], precision[SHARED:, :SHARED])])
    point, heights = peak.copy(), posterior.heights(peak)
    draws = []
    for sweep in range(1, BURN_IN + DRAWS * APART + 1):
        for axis, places in enumerate(own):
            moved = point.copy()
            moved[places] += roots[axis] @ rng.standard_normal(len(places))
            height = posterior.axes[axis](posterior.of_axis(moved, axis))
            if math.log(rng.random()) < height - heights[axis]:
                point, heights[axis] = moved, height
        for _ in range(SHARED_MOVES):
            reach = 2.0 ** rng.standard_normal()  # the ridge is bent: no one size of move suits all of it
            moved = point + ridge @ (shared_root @ rng.standard_normal(SHARED)) * reach
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
