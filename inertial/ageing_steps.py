"""Tell a step (a shock in transport) from slow drift, at a stated rate of false alarms.

Under the drift model of :mod:`inertial.ageing` the whitened innovations ν of a block's checks are independent and of
unit variance, and a unit step just before check k adds a known response u_k to them. When check j has come, the
likelihood ratio of a step of free size there is z²/2 with z = Σν·u_k/√Σu_k², sums up to j: standard normal where there
is no step.

Each new check is a look, and each look tries steps that ``AFTER`` checks have followed. A look may spend the stated
rate times the time since the look before; of that, the six terms get equal parts. The threshold of one z follows from
what it may spend by the Hunter–Worsley bound for the union of dependent events: P(|z| > c) − P(|z| > c, |z'| > c'), z'
the most correlated statistic that came before. So all looks, terms and candidate times together stay below the stated
rate.

Source: Worsley 1982, *An improved Bonferroni inequality and applications*, Biometrika 69.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import erfc, ndtri, roots_legendre

from inertial.ageing import JUMP, Array, Sizes, TermHistories
from inertial.ageing_filter import innovations, step_responses
from inertial.ageing_law import YEAR_MONTHS

AFTER = {1: 0.02, 2: 0.02, 3: 0.03, 4: 0.90, 12: 0.03}
"""Checks that a candidate step has behind it, and the share of a look's allowance that such candidates get: most for
the fourth, by which a step is to be found; some for large steps at once and for small ones late."""
FALSE_ALARMS_PER_BLOCK_YEAR = 0.01
LEAST_SHARE = 20.0
"""No threshold lies below that of so many times its own allowance: where to begin looking for it."""
_NODES, _WEIGHTS = roots_legendre(24)
_REACH = 6.0  # of the integral over z beyond the threshold, in 1/c


@dataclass(frozen=True)
class Step:
    """A step between check ``check − 1`` and ``check`` of a block's history (rows counted from its first).

    ``found_at``: the check with which it was found. ``size`` and ``sigma`` in SI, from all checks up to the latest;
    ``z`` and ``threshold`` as it was found.
    """

    check: int
    found_at: int
    size: float
    sigma: float
    z: float
    threshold: float


def find_steps(histories: TermHistories, sizes: Sizes, allowance: float) -> list[list[Step]]:
    """Return the steps of every block in one term, as they would have been found check by check.

    Parameters
    ----------
    histories
        Of one term; what they say of steps already known does not count.
    sizes
        The population's, for this term.
    allowance
        False alarms a year that one term of one block may raise.
    """
    return [_steps_of_block(_Checks.of(histories, block, sizes), allowance) for block in range(histories.blocks)]


def predicted_sigma(histories: TermHistories, sizes: Sizes, block: int, check: int) -> float:
    """Return 1σ [SI] with which a block's history foretells its check: the check's own σ with the drift's scatter."""
    checks = _Checks.of(histories, block, sizes)
    return float(checks.innovations()[1][check])


@dataclass(frozen=True)
class _Checks:
    """One block's history in one term, with the sizes and the steps that are known."""

    months: Array
    growth: Array
    value: Array
    variance: Array
    jump: Array
    sizes: Array

    @classmethod
    def of(cls, histories: TermHistories, block: int, sizes: Sizes) -> _Checks:
        """Return a block's, without steps."""
        rows = histories.rows(block)
        months = histories.months[rows]
        variance = histories.sigma[rows] ** 2
        return cls(months, sizes.law.growth(months), histories.value[rows], variance, np.zeros(len(months)), sizes.row)

    def with_jumps(self, checks: Sequence[int]) -> _Checks:
        """Return the same with steps of unknown size before these checks."""
        jump = np.zeros(len(self.months))
        jump[list(checks)] = JUMP**2 * float(np.median(self.variance))
        return replace(self, jump=jump)

    def innovations(self) -> tuple[Array, Array]:
        """Return innovations and their σ."""
        return innovations(self.months, self.growth, self.value, self.variance, self.jump, self.sizes)

    def whitened(self) -> tuple[Array, Array]:
        """Return whitened innovations (n,) and their responses (n, n) to a unit step before each check."""
        innovation, deviation = self.innovations()
        seen = np.where(self.jump > 0.0, 0.0, 1.0 / deviation)  # the first check behind a free step says nothing
        responses = step_responses(self.months, self.growth, self.variance, self.jump, self.sizes)
        return innovation * seen, responses * seen


def _steps_of_block(checks: _Checks, allowance: float) -> list[Step]:
    """Return a block's steps; each one found is given a free size, and the search goes on behind it."""
    found: list[Step] = []
    while (step := _first(checks.with_jumps([one.check for one in found]), allowance, found)) is not None:
        found.append(step)
    places = [step.check for step in found]
    return [_measured(step, checks.with_jumps([place for place in places if place != step.check])) for step in found]


def _first(checks: _Checks, allowance: float, known: Sequence[Step]) -> Step | None:
    """Return the first step that a look after the last known one finds."""
    looks = _Looks(*checks.whitened(), allowance, checks.months)
    start = known[-1].found_at + 1 if known else 2
    found = (looks.step_at(look) for look in looks.worth_while(start))
    return next((step for step in found if step is not None), None)


class _Looks:
    """The statistics of every look at one history."""

    def __init__(self, whitened: Array, responses: Array, allowance: float, months: Array) -> None:
        self._responses = responses
        self._squares = np.cumsum(responses**2, axis=1)
        told = self._squares > 1e-9 * self._squares.max(initial=1e-300)
        root = np.sqrt(np.where(told, self._squares, 1.0))
        self._scores = np.abs(np.where(told, np.cumsum(responses * whitened, axis=1) / root, 0.0))
        look = np.arange(len(months))
        shared = sum(share * (look >= after) for after, share in AFTER.items())
        years = np.diff(months, prepend=months[:1]) / YEAR_MONTHS
        self._spend = allowance * years / np.maximum(shared, min(AFTER.values()))

    def worth_while(self, start: int) -> list[int]:
        """Return the looks from ``start`` on in which some statistic is high enough to be worth a threshold."""
        near = np.zeros(len(self._spend), dtype=np.bool_)
        for after, share in AFTER.items():
            looks = np.arange(max(start, after), len(near))
            near[looks] |= self._scores[looks - after + 1, looks] > _bonferroni(
                LEAST_SHARE * share * self._spend[looks]
            )
        return np.flatnonzero(near).tolist()

    def step_at(self, look: int) -> Step | None:
        """Return the step that a look finds: of several candidates the one farthest above its threshold."""
        found = []
        for after, share in AFTER.items():
            check, spend = look - after + 1, share * float(self._spend[look])
            if check >= 1 and self._scores[check, look] > _bonferroni(LEAST_SHARE * spend):
                threshold = _threshold(spend, self._parents(look, check, after))
                found.append(Step(check, look, 0.0, 0.0, float(self._scores[check, look]), threshold))
        over = [step for step in found if step.z > step.threshold]
        return max(over, key=lambda step: step.z - step.threshold, default=None)

    def _parents(self, look: int, check: int, after: int) -> list[tuple[float, float]]:
        """Return (what it may spend, |correlation|) of statistics that came before.

        Same number of checks behind it at the look before; same step with fewer checks; same look with fewer checks.
        """
        earlier = [(look - 1, check - 1, after)]
        earlier += [(look - (after - fewer), check, fewer) for fewer in AFTER if fewer < after]
        earlier += [(look, look - fewer + 1, fewer) for fewer in AFTER if fewer < after]
        return [
            (AFTER[number] * float(self._spend[past]), self._correlation(check, look, candidate, past))
            for past, candidate, number in earlier
            if candidate >= 1 and past >= 2 and self._squares[candidate, past] > 0.0
        ]

    def _correlation(self, check: int, look: int, candidate: int, past: int) -> float:
        common = float(self._responses[check, : past + 1] @ self._responses[candidate, : past + 1])
        return min(abs(common) / math.sqrt(self._squares[check, look] * self._squares[candidate, past]), 0.999)


def _threshold(spend: float, parents: Sequence[tuple[float, float]]) -> float:
    """Return c: P(|z| > c), less what the most telling of the earlier events has in common with it, is ``spend``.

    The earlier thresholds are taken at their highest, the plain Bonferroni ones, which errs to the safe side.
    """
    low, high = (float(end) for end in _bonferroni(np.array([LEAST_SHARE, 1.0]) * spend))
    events = [(float(_bonferroni(np.array(other))), correlation) for other, correlation in parents]
    for _ in range(12):
        middle = 0.5 * (low + high)
        common = max((_both(middle, other, correlation) for other, correlation in events), default=0.0)
        above = float(erfc(middle / math.sqrt(2.0))) - common > spend
        low, high = (middle, high) if above else (low, middle)
    return high


def _bonferroni(probability: Array | float) -> Array:
    """Return c at which P(|z| > c) of a standard normal is this much."""
    return np.asarray(-ndtri(0.5 * np.minimum(1.0, probability)))


def _both(c: float, other: float, correlation: float) -> float:
    """Return P(|x| > c, |y| > other) of two standard normals."""
    reach = _REACH / max(c, 1.0)
    x = c + 0.5 * reach * (_NODES + 1.0)
    weights = 0.5 * reach * _WEIGHTS * np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)
    width = math.sqrt(2.0 * (1.0 - correlation**2))
    beyond = 0.5 * erfc((other - correlation * x) / width) + 0.5 * erfc((other + correlation * x) / width)
    return float(2.0 * weights @ beyond)


def _measured(step: Step, checks: _Checks) -> Step:
    """Return a step with its size from all checks, given checks in which the other steps are free."""
    whitened, responses = checks.whitened()
    response = responses[step.check]
    information = float(response @ response)
    return replace(step, size=float(response @ whitened) / information, sigma=information**-0.5)
