"""How fast a mount forgets its angle, and how large that is: the correlation time at which gyros feel it sway.

Its rate stands out of a gyro's noise at frequencies where its angle, gravity tilted, is one of several noises of an
accelerometer: so gyros tell the time, and accelerometers how large.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulators.discrepancy.fisher_scoring import climb
from simulators.discrepancy.whitening import SWAYS_S, Basis, whittle

Array = NDArray[np.float64]

_TIMES = 40  # tried
_SHORTER = 8.0  # than a record, or it is drift
_CERTAIN = 50.0  # nats that a sway must explain of the gyros' noise


def times_to_try(bases: Iterable[Basis], count: int) -> list[float]:
    """Return so many correlation times [s] in a constant ratio that a sway may have in records of such bases."""
    longest_s = min(basis.n * basis.interval_s for basis in bases) / _SHORTER
    return list(map(float, np.geomspace(SWAYS_S, max(longest_s, 2.0 * SWAYS_S), count)))


@dataclass(frozen=True)
class FeltSway:
    """A sway as gyros tell it: its correlation time [s], and the angle's σ [rad] that each of them feels."""

    correlation_s: float
    angle_rad: tuple[float, ...]


def felt_sway(gyros: Sequence[tuple[Basis, Array, Array]]) -> FeltSway | None:
    """Return the sway that explains most of what gyros read; none if that is not much.

    By Whittle's likelihood. Of each gyro the basis, sums of squares (b,) of what is left of its coefficients, and the
    power (b,) of noise that is there at least; there may be more of white noise and rounding.
    """
    times = times_to_try((basis for basis, _, _ in gyros), _TIMES)
    still = sum(_likelihood(*gyro, None)[0] for gyro in gyros)
    tried = [[_likelihood(*gyro, at_s) for gyro in gyros] for at_s in times]
    gains = [sum(nats for nats, _ in each) - still for each in tried]
    best = int(np.argmax(gains))
    if gains[best] <= _CERTAIN:
        return None
    return FeltSway(times[best], tuple(math.sqrt(variance) for _, variance in tried[best]))


def _likelihood(basis: Basis, rss: Array, least: Array, at_s: float | None) -> tuple[float, float]:
    """Return the log-likelihood [nats] of what a gyro reads beside a sway, or without one; the angle's variance."""
    columns = basis.power[:, : basis.fast]
    if at_s is not None:
        columns = np.column_stack([columns, basis.sway(at_s, tilted=False)])
    variances = float(rss.sum() / basis.counts.sum()) / np.maximum(columns.max(axis=0), 1e-300)
    climb(np.ascontiguousarray(columns), rss, basis.counts, least, variances, 1)
    return whittle(rss, basis.counts, least + columns @ variances), float(variances[-1])
