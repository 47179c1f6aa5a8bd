"""How fast a mount forgets its angle: the correlation time at which gyros feel it sway.

Its rate stands out of a gyro's noise at frequencies where its angle, gravity tilted, is one of several noises of an
accelerometer: so gyros tell the time, and accelerometers how large.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simulators.discrepancy.whitening import SWAYS_S, Basis, climb, whittle

Array = NDArray[np.float64]

_TIMES, _SHORTER = 40, 8.0  # tried, up to so much shorter than the record
_CERTAIN = 50.0  # nats that a sway must explain of the gyros' noise
_ROUNDS = 100


def correlation_time(gyros: Sequence[tuple[Basis, Array, Array]]) -> float | None:
    """Return the correlation time [s] of the sway that explains most of what gyros read; none if that is not much.

    Of each gyro the basis, sums of squares (b,) of what is left of its coefficients, and the power (b,) of noise that
    is there at least; there may be more of white noise and rounding.
    """
    longest_s = min(basis.n * basis.interval_s for basis, _, _ in gyros) / _SHORTER
    times = np.geomspace(SWAYS_S, max(longest_s, 2.0 * SWAYS_S), _TIMES).tolist()
    still = sum(_likelihood(*gyro, None) for gyro in gyros)
    gains = [sum(_likelihood(*gyro, at_s) for gyro in gyros) - still for at_s in times]
    best = int(np.argmax(gains))
    return times[best] if gains[best] > _CERTAIN else None


def _likelihood(basis: Basis, rss: Array, least: Array, at_s: float | None) -> float:
    """Return the log-likelihood [nats] of what a gyro reads beside a sway, or without one."""
    columns = basis.power[:, : basis.fast]
    if at_s is not None:
        columns = np.column_stack([columns, basis.sway(at_s, tilted=False)])
    variances = float(rss.sum() / basis.counts.sum()) / np.maximum(columns.max(axis=0), 1e-300)
    climb(np.ascontiguousarray(columns), rss, basis.counts, least, variances, _ROUNDS, 1)
    return whittle(rss, basis.counts, least + columns @ variances)
