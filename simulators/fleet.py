"""A fleet in storage: terms of many like blocks drifting by planted laws, checked now and then, some of them shocked.

The truth follows laws of its own, among them some that :mod:`inertial.ageing` cannot represent; it is drawn on a fine
grid far beyond the last check, so that a forecast can be held against when each block really leaves its limit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from inertial.ageing import TermHistories

Array = NDArray[np.float64]

STEPS_A_MONTH = 8
LAWS: dict[str, Callable[[Array], Array]] = {
    "linear": lambda t: t / 12.0,
    "logarithmic": lambda t: np.log1p(t / 6.0) / np.log1p(2.0),
    "square_root": lambda t: np.sqrt(t / 12.0),
    "saturating": lambda t: (1.0 - np.exp(-t / 30.0)) / (1.0 - np.exp(-0.4)),
    "growing": lambda t: (t / 12.0) ** 1.3,
    "stretched": lambda t: np.expm1(-np.sqrt(t / 30.0)) / np.expm1(-np.sqrt(12.0 / 30.0)),
}
"""Drift by months in storage, 1 after a year. The fitted family only comes near to the powers, and to what relaxes as a
stretched exponential (Kohlrausch)."""


@dataclass(frozen=True)
class TermLaw:
    """How one term drifts; sizes in one unit throughout (SI, or anything else).

    ``mean``, ``spread`` of the drift after a year; ``tails``: degrees of freedom of the spread's Student t (none:
    normal); ``walk`` a √month; ``relaxation_months``: the walk is pulled back so (none: it is free); ``offset`` of the
    calibration, ``scatter`` from check to check, ``sigma`` of a check, stated.
    """

    law: str = "logarithmic"
    mean: float = 0.0
    spread: float = 10.0
    offset: float = 1.0
    walk: float = 0.15
    scatter: float = 0.3
    sigma: float = 1.0
    tails: float | None = None
    relaxation_months: float | None = None


@dataclass(frozen=True)
class FleetTerm:
    """One term of all blocks: what the checks say, and the truth (blocks, times) on ``truth_months``."""

    histories: TermHistories
    truth_months: Array
    truth: Array

    def leaves_months(self, limit: float) -> Array:
        """Return when each block's truth is first outside ±limit from its last check on, months from there."""
        return np.array([self._leaves(block, limit) for block in range(self.histories.blocks)])

    def _leaves(self, block: int, limit: float) -> float:
        last = float(self.histories.months[self.histories.offsets[block + 1] - 1])
        later = self.truth_months >= last - 1e-9
        months, beyond = self.truth_months[later] - last, np.abs(self.truth[block, later]) - limit
        if beyond.max() < 0.0:
            return np.inf
        first = int(np.argmax(beyond >= 0.0))
        nodes = slice(max(first - 1, 0), first + 1)  # the truth goes straight from one to the other
        return float(np.interp(0.0, beyond[nodes], months[nodes]))


@dataclass(frozen=True)
class Shock:
    """A step of a block's term between check ``check − 1`` and ``check``."""

    block: int
    check: int
    size: float


def simulate_term(
    law: TermLaw,
    blocks: int,
    check_months: Array,
    horizon_months: float,
    rng: np.random.Generator,
    shocks: tuple[Shock, ...] = (),
    kind: Literal["stated", "varied"] = "varied",
) -> FleetTerm:
    """Simulate one term of a fleet.

    Parameters
    ----------
    law
        How it drifts.
    blocks, check_months
        How many, and when each is checked (months since calibration, increasing).
    horizon_months
        How far the truth goes.
    shocks
        Steps, each midway between two checks.
    kind
        ``varied``: the checks' σ differ between half and one and a half of the stated one, as reference and stay do.
    """
    grid = np.arange(round(horizon_months * STEPS_A_MONTH) + 1) / STEPS_A_MONTH
    normal = rng.standard_normal(blocks) if law.tails is None else _student(law.tails, blocks, rng)
    truth = rng.standard_normal((blocks, 1)) * law.offset
    truth = truth + (law.mean + law.spread * normal)[:, None] * LAWS[law.law](grid)
    truth = truth + _walk(law, blocks, len(grid), rng)
    for shock in shocks:
        when = 0.5 * (check_months[shock.check - 1] + check_months[shock.check])
        truth[shock.block, grid > when] += shock.size
    shape = (blocks, len(check_months))
    sigma = law.sigma * (rng.uniform(0.5, 1.5, shape) if kind == "varied" else np.ones(shape))
    at_checks = np.array([np.interp(check_months, grid, row) for row in truth])
    noise = rng.standard_normal(shape) * sigma + rng.standard_normal(shape) * law.scatter
    value = at_checks + noise
    histories = TermHistories.of([(check_months, value[b], sigma[b]) for b in range(blocks)])
    return FleetTerm(histories, grid, truth)


def _student(freedom: float, count: int, rng: np.random.Generator) -> Array:
    """Draw a Student t scaled to unit variance."""
    return np.asarray(rng.standard_t(freedom, count) * np.sqrt((freedom - 2.0) / freedom))


def _walk(law: TermLaw, blocks: int, count: int, rng: np.random.Generator) -> Array:
    kicks = rng.standard_normal((blocks, count)) * law.walk / np.sqrt(STEPS_A_MONTH)
    kicks[:, 0] = 0.0
    if law.relaxation_months is None:
        return np.cumsum(kicks, axis=1)
    keep = np.exp(-1.0 / STEPS_A_MONTH / law.relaxation_months)
    walk = np.zeros((blocks, count))
    for k in range(1, count):
        walk[:, k] = keep * walk[:, k - 1] + kicks[:, k]
    return walk
