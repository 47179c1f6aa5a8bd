"""The law by which terms drift in storage: one family from exponential saturation over powers and linear to growth.

The rate of drift falls by ``decline`` of itself a year, as it is after a year; ``bend`` says how that goes on::

    h'(t) ∝ exp(−decline·(12 + τ)/12·(x^bend − 1)/bend),   x = (t + τ)/(12 + τ),   h(0) = onset, h(12) = 1

================== ========= ===========================================================
law                bend      decline
================== ========= ===========================================================
linear             any       0
power, tᵖ          0         1 − p, τ → 0: below 0 it grows faster than linearly
log(1 + t/τ)       0         12/(12 + τ)
1 − exp(−t/T)      1         12/T; below 0 it is exponential growth
settles, then      below 0   above 0
linear
================== ========= ===========================================================

Each of these lies inside the family, but for the pure power: it is at τ → 0, where what the first weeks bring has no
end. Therefore ``onset``, the share of the first year that comes at once: it takes in what a τ that is a little too
large leaves over, and elsewhere is 0. Above ``bend`` = 1 a drift ends sooner than exponentially.

A power of time in the rate's logarithm is the stretched exponential (Kohlrausch) by which glassy and polymer parts
relax; as bend → 0 it is the power law of the rate.

No law is known to hold where nothing was checked. Beyond the ages that were, the rate goes off the law by a power of
time, ``stray``, in proportion to how many times older a block is (:meth:`DriftLaw.growth_beyond`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inertial.compiled import compiled

Array = NDArray[np.float64]

YEAR_MONTHS = 12.0


@dataclass(frozen=True)
class DriftLaw:
    """A law: ``decline`` a year, ``bend``, ``onset``, τ [months], ``law_months``, and its ``stray``."""

    decline: float
    bend: float
    onset: float
    law_months: float
    stray: float = 0.0

    def growth(self, months: Array) -> Array:
        """Return h at ages [months] of at least 0: 1 after a year."""
        ages = np.asarray(months, dtype=np.float64)
        later = _growth(ages.ravel(), self.decline, self.bend, self.law_months).reshape(ages.shape)
        return np.asarray(self.onset + (1.0 - self.onset) * later)

    def growth_beyond(self, months: Array, known_months: float) -> Array:
        """Continue h beyond the ages at which its law is known: h' is (age/known)^stray times the law's there.

        Parameters
        ----------
        months
            Ages [months] (…, n), increasing along the last axis; at the first of each row h is the law's.
        known_months
            The age [months] up to which it is known.

        Returns
        -------
        h (…, n), in units of the first year's drift.
        """
        ages = np.asarray(months, dtype=np.float64)
        lawful = self.growth(ages)
        middle = 0.5 * (ages[..., 1:] + ages[..., :-1])
        steps = np.diff(lawful, axis=-1) * np.maximum(middle / known_months, 1.0) ** self.stray
        first = lawful[..., :1]
        return np.concatenate([first, first + np.cumsum(steps, axis=-1)], axis=-1)


PANELS = 128
"""Of Simpson's rule, even in ln(t + τ), between which h goes by its cubic: right to 1e-6 and better."""
STEEPEST = 100.0
"""Of ln h': growth beyond it is out of any limit at once, and would overflow."""


@compiled
def _growth(months: Array, decline: float, bend: float, law_months: float) -> Array:
    year = YEAR_MONTHS + law_months
    first = math.log(law_months)
    panel = (math.log(max(YEAR_MONTHS, months.max()) + law_months) - first) / PANELS
    # The slope of h by u = ln(t + τ), at the ends and in the middle of every panel.
    slope = np.empty(2 * PANELS + 1)
    for k in range(2 * PANELS + 1):
        u = first + 0.5 * k * panel
        x = u - math.log(year)
        stretched = x if abs(bend * x) < 1e-9 else math.expm1(bend * x) / bend
        slope[k] = math.exp(min(u - decline * year / YEAR_MONTHS * stretched, STEEPEST))
    height = np.zeros(PANELS + 1)
    for k in range(PANELS):
        height[k + 1] = height[k] + panel / 6.0 * (slope[2 * k] + 4.0 * slope[2 * k + 1] + slope[2 * k + 2])
    at_a_year = _between(math.log(year), first, panel, height, slope)
    grown = np.empty(len(months))
    for i in range(len(months)):
        grown[i] = _between(math.log(months[i] + law_months), first, panel, height, slope) / at_a_year
    return grown


@compiled
def _between(u: float, first: float, panel: float, height: Array, slope: Array) -> float:
    """Return h, unscaled, at u: the cubic that has height and slope at both ends of its panel."""
    place = (u - first) / panel
    k = min(max(int(place), 0), PANELS - 1)
    s = place - k
    rest = 1.0 - s
    ends = height[k] * rest * rest * (1.0 + 2.0 * s) + height[k + 1] * s * s * (3.0 - 2.0 * s)
    found: float = ends + panel * s * rest * (slope[2 * k] * rest - slope[2 * k + 2] * s)
    return found
