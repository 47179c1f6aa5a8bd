"""Coloured noise of one channel in the cosine basis, where its covariance is nearly diagonal, and its fit.

The family is wide: white, quantisation, random walk of the rate, and first-order Gauss–Markov processes whose
correlation times stand in a constant ratio, so that their sum takes the shape of flicker or of a single process of any
correlation time, and a mount that sways: its angle, or its rate, which has no mean. Each term's power in each bin of
coefficients is linear in its variance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, minimize

from inertial.documents import ChannelNoise
from inertial.rounding import error_spectrum
from simulators.discrepancy.fisher_scoring import climb

Array = NDArray[np.float64]

_SINGLE = 40
_RATIO = 1.2
_GM_RATIO = 3.5
SWAYS_S = 0.05  # no mount forgets its angle sooner; what does would pass for white noise
_MEAN = 0.45  # where the mean is taken to stand in frequency: a random walk's has the variance at 0.55, with a margin
_MOMENTS = 512  # at which the motion is looked at
_POINTS = 4  # at which the spectrum of rounding errors is taken within a bin
FREE_SHARE = 0.5
"""Of noise of which a model knows the size about: so much is there at least."""
_AS_SAID = 0.7  # weight, at the start, of rounding as the stated noise jolts it
ROUNDED_AT = (0.25, 0.5, 1.0, 2.0)
"""Shares of the white noise that may jolt a readout in steps."""
_LOST = 0.05  # of the white noise's power, or of a line's height over its surroundings
LEVELS = ("stated", "white", "sway", "flicker", "walk", "coloured")
STATED, WHITE, SWAY, FLICKER, WALK, WIDE = range(len(LEVELS))
"""Levels of the noise family: as the model states, or in its proportions; white and quantisation free; a mount that
sways as well (beside the model's proportions, where it gives them); or flicker as well; or a random walk; all free."""
SHAPED = frozenset({STATED, SWAY})
"""Those that go by the model's proportions where it gives them."""


@dataclass(frozen=True)
class Basis:
    """Bins of coefficients of n samples: first of each bin (b + 1,), and power per unit variance (b, terms).

    The first ``fast`` terms are white noise and rounding, the next are flicker and random walk. ``shape`` (b,): white
    noise, flicker and random walk in the proportions of a model that leaves their size free; ``least_slow`` (b,): how
    much of flicker and random walk there is at least. ``ends``: how much of what a mount adds that sways comes
    of its angle at a record's ends, over twice its variance.
    """

    bounds: NDArray[np.int64]
    counts: Array
    power: Array
    names: tuple[str, ...]
    n: int
    interval_s: float
    fast: int = 2
    shape: Array | None = None
    least_slow: Array | None = None
    white_filled: Array | float = 1.0
    ends: float = 1.0

    @property
    def frequency_hz(self) -> Array:
        """Middle of each bin."""
        middle = 0.5 * (self.bounds[:-1] + self.bounds[1:] - 1)
        return np.asarray(middle / (2.0 * self.n * self.interval_s))

    def each(self, values: Array) -> Array:
        """Return what bins (b,) have for each of their coefficients (n,)."""
        return np.repeat(values, self.counts.astype(np.int64))

    def terms(self, level: int) -> list[int]:
        """Return the terms that a level of the family leaves free."""
        sway = self._swaying()
        more = {SWAY: sway, FLICKER: [self.fast], WALK: [self.fast + 1], WIDE: range(self.fast, len(self.names))}
        return [*range(self.fast), *more.get(level, ())]

    def with_gaps(self, filled: Array) -> Basis:
        """Return the basis of values with filled gaps, which make ``filled`` (b,) of white noise's power."""
        return replace(self, power=np.column_stack([self.power[:, 0] * filled, self.power[:, 1:]]), white_filled=filled)

    def tilted_at(self, times_s: Sequence[float]) -> Basis:
        """Return an accelerometer's basis beside a mount that sways with such correlation times and no others."""
        others = [place for place in range(len(self.names)) if place not in self._swaying()]
        tilts = [self.sway(at_s, tilted=True) for at_s in times_s]
        power = np.column_stack([self.power[:, others], *(tilt / tilt.max() for tilt in tilts)])
        names = (*(self.names[place] for place in others), *(f"sway {at_s:.3g} s" for at_s in times_s))
        return replace(self, power=power, names=names)

    def with_ends(self, ends: float) -> Basis:
        """Return a gyro's basis where so much comes of a mount's angle at a record's ends, see :mod:`.sway_ends`."""
        other = cosine_basis(self.n, self.interval_s, ends=ends)
        power = self.power.copy()
        power[:, self._swaying()] = other.power[:, other._swaying()]
        return replace(self, power=power, ends=ends)

    def _swaying(self) -> list[int]:
        return [place for place, name in enumerate(self.names) if name.startswith("sway")]

    @cached_property
    def families(self) -> dict[tuple[int, bool], tuple[Array, Array]]:
        """Return of each level, with the model's proportions and without, the columns (b, k) and their medians (k,)."""
        found = {}
        for level in range(len(LEVELS)):
            free = np.ascontiguousarray(self.power[:, self.terms(level)])
            found[level, False] = free, np.median(free, axis=0)
            if self.shape is not None:
                shaped = np.column_stack([self.shape, free[:, 1:]]) if level in SHAPED else free
                found[level, True] = shaped, np.median(shaped, axis=0)
        return found

    def slow_missing(self, size: float) -> Array:
        """Return what slow noise (b,) there is at least beyond that of so much of ``shape``."""
        assert self.least_slow is not None
        return max(1.0 - size / FREE_SHARE**2, 0.0) * self.least_slow

    def stated(self, noise: ChannelNoise, floor: float, moved: Array | None = None) -> Array:
        """Return the power (b,) of a model's noise, with a floor [y·s] for the rounding of the frame.

        ``moved``: the mean motion (n,) [y]. With it, the rounding of an integral that moves by less than a step at
        random between samples is not white (:mod:`inertial.rounding`).
        """
        x = self._x()
        tau = self.interval_s
        rounding = 1.0 if moved is None or not noise.quantisation else self._rounding(noise, moved)
        flicker = noise.flicker**2 / (2.0 * math.pi * self._frequency() * tau)
        return np.asarray(
            self.white_filled * noise.white**2 / tau
            + (rounding * noise.quantisation**2 + floor**2) / 12.0 * 4.0 * (np.sin(x) ** 2 + 1.0 / self.n) / tau**2
            + flicker
            + noise.random_walk**2 * tau * (1.0 - 2.0 / 3.0 * np.sin(x) ** 2) / (4.0 * np.sin(x) ** 2)
        )

    def rounded(self, noise: ChannelNoise, moved: Array) -> Basis:
        """Return the basis for a readout in steps, as :meth:`stated` takes it, of which the model knows the size about.

        Its rounding errors are white or not as the white noise is a quarter to twice what the model says.
        """
        white_rounding = self.power[:, self.names.index("quantisation")]
        names, columns = [], []
        for share in ROUNDED_AT:
            jolted = noise.model_copy(update={"white": share * noise.white})
            columns.append(white_rounding * self._rounding(jolted, moved))
            names.append(f"rounding at {share:g} of the white noise")
        power = np.column_stack([self.power[:, : self.fast], *columns, self.power[:, self.fast :]])
        names = [*self.names[: self.fast], *names, *self.names[self.fast :]]
        return replace(self, power=power, names=tuple(names), fast=self.fast + len(columns))

    def likeliest(self, stated: Array, noise: ChannelNoise, rss: Array) -> Array:
        """Return the stated power (b,) with the mean of a :meth:`rounded` basis' rounding that fits ``rss`` (b,) best.

        A model states how large white noise is and not how it is spread: heavy tails make the lines of rounding sharp
        at the top and wide at the foot.
        """
        columns = self.power[:, self.fast - len(ROUNDED_AT) : self.fast]
        columns = columns * noise.quantisation**2 / (12.0 * self.interval_s**2)
        as_said = columns[:, ROUNDED_AT.index(1.0)]
        columns = columns * np.minimum(stated / np.maximum(as_said, 1e-300), 1.0)[:, None]
        others = stated - np.minimum(as_said, stated)
        if not rss.any():
            return np.asarray(others + columns.mean(axis=1))

        def downhill(weights: Array) -> tuple[float, Array]:
            power = others + columns @ weights
            slope = 0.5 * columns.T @ (self.counts / power - rss / power**2)
            return -_value(rss, self.counts, power), slope

        start = np.where(np.array(ROUNDED_AT) == 1.0, _AS_SAID, (1.0 - _AS_SAID) / (len(ROUNDED_AT) - 1))
        whole = LinearConstraint(np.ones(start.size), 1.0, 1.0)
        found = minimize(downhill, start, jac=True, method="SLSQP", bounds=Bounds(0.0, 1.0), constraints=[whole])
        return np.asarray(others + columns @ found.x)

    def _rounding(self, noise: ChannelNoise, moved: Array) -> Array:
        """Return the power of the rounding error (b,) over that of white rounding errors, step²/12."""
        step, tau = noise.quantisation, self.interval_s
        moved = moved[:: max(1, self.n // _MOMENTS)]
        edges = self.bounds * math.pi / self.n
        omega = edges[:-1, None] + np.diff(edges)[:, None] * (np.arange(_POINTS) + 0.5) / _POINTS
        variance = noise.white**2 * tau / step**2
        error = error_spectrum(omega.ravel(), moved * tau / step, variance).reshape(omega.shape)
        tilt = np.sin(0.5 * omega) ** 2
        return np.asarray(12.0 * np.sum(tilt * error, axis=1) / np.sum(tilt, axis=1))

    def sway(self, correlation_s: float, *, tilted: bool) -> Array:
        """Return the power (b,) that a mount of unit variance adds which forgets its angle within so long.

        As its rate [1/s], or ``tilted`` as its angle.
        """
        decay = math.exp(-self.interval_s / correlation_s)
        power = _sway(np.sin(self._x()) ** 2, decay, self.ends / self.n, tilted=tilted)
        return power if tilted else power / self.interval_s**2

    def _x(self) -> Array:
        middle = np.maximum(0.5 * (self.bounds[:-1] + self.bounds[1:] - 1), _MEAN)
        return np.asarray(0.5 * math.pi * middle / self.n)

    def _frequency(self) -> Array:
        return np.asarray(self._x() / (math.pi * self.interval_s))


def freely_rounded_hz(noise: ChannelNoise, interval_s: float) -> float:
    """Return the frequency below which rounding errors, white or not, are lost in the white noise.

    Above, an integral that moves by less than a step at random between samples has lines in its error, which come and
    go with the motion.
    """
    steps = noise.white * math.sqrt(interval_s) / noise.quantisation if noise.quantisation else math.inf
    fade = math.exp(-2.0 * (math.pi * steps) ** 2)
    if fade < _LOST:
        return math.inf
    height = (1.0 + fade) / max(1.0 - fade, 1e-9)
    return math.sqrt(12.0 * _LOST / height) * steps / (2.0 * math.pi * interval_s)


@lru_cache(maxsize=64)
def cosine_basis(n: int, interval_s: float, *, tilted: bool = False, ends: float = 1.0) -> Basis:
    """Return the bins of n coefficients, the lowest one by one, and the family's power in them.

    ``tilted``: a mount that sways acts by its angle, as on an accelerometer, and not by its rate, as on a gyro, of
    which so much comes of the ``ends``.
    """
    single = min(_SINGLE, n)
    steps = max(2, math.ceil(math.log(n / single) / math.log(_RATIO)) + 1)
    bounds = np.unique(np.concatenate([np.arange(single), np.round(np.geomspace(single, n, steps)).astype(np.int64)]))
    middle = np.maximum(0.5 * (bounds[:-1] + bounds[1:] - 1), _MEAN)
    x = 0.5 * math.pi * middle / n
    sine2 = np.sin(x) ** 2
    columns = [np.ones_like(x), 4.0 * (sine2 + 1.0 / n), 0.5 / x, (1.0 - 2.0 / 3.0 * sine2) / (4.0 * sine2)]
    names = ["white", "quantisation", "flicker", "random_walk"]
    correlation = 2.0
    while correlation < n / 8:
        decay = math.exp(-1.0 / correlation)
        columns.append((1.0 - decay**2) / ((1.0 - decay) ** 2 + 4.0 * decay * sine2))
        names.append(f"markov {correlation * interval_s:.3g} s")
        if correlation * interval_s > SWAYS_S:
            sway = _sway(sine2, decay, ends / n, tilted=tilted)
            columns.append(sway / sway.max())
            names.append(f"sway {correlation * interval_s:.3g} s")
        correlation *= _GM_RATIO
    counts = np.diff(bounds).astype(np.float64)
    return Basis(bounds, counts, np.column_stack(columns), tuple(names), n, interval_s, ends=ends)


def _sway(sine2: Array, decay: float, ends: float, *, tilted: bool) -> Array:
    """Return the power (b,), by variance of the angle, of an angle or of its change from one sample to the next.

    ``sine2`` (b,): sin² of half the frequency, which for a change is raised as its angle is a record's ends apart.
    Summed by parts, the coefficients of a difference hold the values at both ends: twice the variance of the angle,
    each two in n of the power, ``ends`` being one in n, or as much of that as counts. That variance is the mean over
    all frequencies of the angle's power.
    """
    markov = (1.0 - decay**2) / ((1.0 - decay) ** 2 + 4.0 * decay * sine2)
    variance = (1.0 + decay**2) / (1.0 - decay**2)
    raised = sine2 + variance * ends * ((1.0 - decay) / (1.0 + decay)) ** 2
    return np.asarray((1.0 if tilted else 4.0 * raised) * markov**2 / variance)


@dataclass(frozen=True)
class NoiseFit:
    """Power (b,) of the noise, log-likelihood less the penalty of its level [nats], its level."""

    power: Array
    value: float
    level: int
    penalty: float


PENALTY = (0.0, 3.0, 8.0, 12.0, 14.0, 14.0)
"""What each level costs [nats] where the model states its noise."""
PENALTY_SHAPED = (0.0, 3.0, 8.0, 11.0, 13.0, 13.0)
"""... where it states the proportions of its terms."""
PENALTY_FREE = (math.inf, 0.0, 3.0, 3.0, math.inf, 6.0)


def fit_noise(
    basis: Basis,
    rss: Array,
    freedom: Array,
    stated: Array | None,
    floor: Array,
    *,
    eased: float = 1.0,
    sways: bool = True,
    slow: bool = True,
    blocks: bool = False,
    above: float = 0.0,
) -> NoiseFit:
    """Fit the noise to sums of squares (b,) of residual coefficients with as many degrees of freedom.

    ``stated`` (b,) is the power the model states, none where its size is free; ``floor`` (b,) is never undercut.
    ``eased`` is the least share of it that may hold, see :func:`ease`. Unless the mount ``sways``, noise of that kind
    costs what flicker does. Without ``slow``, nothing is tried but white noise and rounding, or noise of the model's
    proportions and rounding. The mean of a record tells of a bias, which a random walk of one coefficient would
    swallow, and is left out; those of ``blocks`` of one tell of its slow noise. Sizes are fitted ``above`` a share of
    all frequencies.
    """
    shape = basis.shape if stated is None else None
    penalty = PENALTY if stated is not None else PENALTY_FREE if shape is None else PENALTY_SHAPED
    best: NoiseFit | None = None
    high = slice(len(rss) // 2, None)
    start = max(float(np.sum(rss[high]) / max(np.sum(freedom[high]), 1.0)), float(floor[high].max()) + 1e-300)
    first = STATED if shape is not None else WHITE
    lowest = int(np.searchsorted(basis.bounds, above * basis.n))
    for level in range(first, WIDE + 1 if slow else first + 1):
        columns, typical = basis.families[level, shape is not None]
        variances = start / np.maximum(typical, 1e-300)
        variances[1:] *= 0.1
        in_shape = basis.least_slow if shape is not None and level in SHAPED else None
        under = floor if in_shape is None else np.maximum(floor - in_shape, 0.0)
        climb(columns, rss, freedom, under, variances, max(lowest, 0 if blocks else 1))
        power = under + columns @ variances
        if in_shape is not None:
            power += basis.slow_missing(float(variances[0]))
        cost = penalty[FLICKER if level == SWAY and not sways else level]
        value = _value(rss, freedom, power) - cost
        if best is None or value > best.value:
            best = NoiseFit(power, value, level, cost)
    assert best is not None
    if stated is not None:
        power = ease(stated, power, eased)
        value = _value(rss, freedom, power)
        if value >= best.value:
            best = NoiseFit(power, value, STATED, 0.0)
    return best


def ease(stated: Array, found: Array, least: float) -> Array:
    """Return the stated power (b,), down to its share ``least`` where less was found.

    Samples that are noisier for the motion count less. In a band that the motion does not touch they have no more noise
    than others, so that what is left there is less than stated.
    """
    return np.asarray(stated * np.clip(found / stated, least, 1.0))


def whittle(rss: Array, counts: Array, power: Array) -> float:
    """Return the log-likelihood of all but the mean, which tells of a bias and not of noise."""
    return _value(rss[1:], counts[1:], power[1:])


def _value(rss: Array, freedom: Array, power: Array) -> float:
    return float(-0.5 * np.sum(freedom * np.log(power) + rss / power))
