"""The Kalman filter of the drift model of :mod:`inertial.ageing`, one block at a time.

State: offset, slope, walk. A check sees offset + h·slope + walk. ``sizes`` are mean, spread², offset², walk², scatter²
and the rate [1/month] at which the walk is pulled back, ``jump`` the variance of a step before each check, mostly 0: a
step stays, and therefore is the offset's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from inertial.compiled import compiled

Array = NDArray[np.float64]


Belief = tuple[float, float, float, float, float, float, float, float, float]
"""State (3), then its covariances aa, ss, ww, as, aw, sw. A tuple, which stays in registers."""


@compiled
def begin(sizes: Array) -> Belief:
    """Return the belief at the laboratory."""
    return (0.0, sizes[0], 0.0, sizes[2], sizes[1], 0.0, 0.0, 0.0, 0.0)


@compiled
def pulled(elapsed: float, rate: float) -> tuple[float, float]:
    """Return what share of a walk is left after ``elapsed`` months, and the variance that came in, of a unit walk."""
    pull = 2.0 * rate * elapsed
    return np.exp(-0.5 * pull), elapsed * (-np.expm1(-pull) / pull if pull > 0.0 else 1.0)


@compiled
def take(
    belief: Belief,
    walked: tuple[float, float],
    jump: float,
    growth: float,
    value: float,
    variance: float,
    sizes: Array,
) -> tuple[Belief, float, float]:
    """Take in one check; ``walked``: since the one before (:func:`pulled`).

    Returns
    -------
    The belief after it, its innovation and the variance of that.
    """
    a, s, w, aa, ss, ww, cross_as, aw, sw = belief
    left, came = walked
    w, aw, sw = w * left, aw * left, sw * left
    ww = ww * left * left + sizes[3] * came
    aa += jump
    ga = aa + growth * cross_as + aw
    gs = cross_as + growth * ss + sw
    gw = aw + growth * sw + ww
    f = ga + growth * gs + gw + variance + sizes[4]
    v = value - a - growth * s - w
    weight = 1.0 / f
    ka, ks, kw = ga * weight, gs * weight, gw * weight
    after = (
        *(a + ka * v, s + ks * v, w + kw * v),
        *(aa - ka * ga, ss - ks * gs, ww - kw * gw),
        *(cross_as - ka * gs, aw - ka * gw, sw - ks * gw),
    )
    return after, v, f


@compiled
def log_likelihood(
    offsets: NDArray[np.int64],
    months: Array,
    growth: Array,
    value: Array,
    variance: Array,
    jump: Array,
    sizes: Array,
) -> float:
    """Return the log likelihood of all checks of all blocks; a check just behind a step of unknown size is free."""
    total = 0.0
    elapsed, walked = 0.0, pulled(0.0, sizes[5])
    for block in range(len(offsets) - 1):
        belief = begin(sizes)
        before = 0.0
        for i in range(offsets[block], offsets[block + 1]):
            if months[i] - before != elapsed:  # mostly it is a month again
                elapsed = months[i] - before
                walked = pulled(elapsed, sizes[5])
            belief, v, f = take(belief, walked, jump[i], growth[i], value[i], variance[i], sizes)
            before = months[i]
            if jump[i] == 0.0:
                total -= 0.5 * (np.log(2.0 * np.pi * f) + v * v / f)
    return total


@compiled
def innovations(
    months: Array, growth: Array, value: Array, variance: Array, jump: Array, sizes: Array
) -> tuple[Array, Array]:
    """Return what each check of a block says beyond what was foretold, and 1σ of that."""
    innovation, deviation = np.empty(len(value)), np.empty(len(value))
    belief = begin(sizes)
    before = 0.0
    for i in range(len(value)):
        walked = pulled(months[i] - before, sizes[5])
        belief, v, f = take(belief, walked, jump[i], growth[i], value[i], variance[i], sizes)
        before = months[i]
        innovation[i], deviation[i] = v, np.sqrt(f)
    return innovation, deviation


@compiled
def step_responses(months: Array, growth: Array, variance: Array, jump: Array, sizes: Array) -> Array:
    """Return what a unit step before check k adds to the innovation of check i of a block, in row k and column i."""
    count = len(months)
    responses = np.zeros((count, count))
    silent = sizes.copy()
    silent[0] = 0.0
    for k in range(count):
        belief = begin(silent)
        before = 0.0
        for i in range(count):
            value = 1.0 if i >= k else 0.0
            walked = pulled(months[i] - before, sizes[5])
            belief, v, _ = take(belief, walked, jump[i], growth[i], value, variance[i], silent)
            before = months[i]
            responses[k, i] = v
    return responses


@compiled
def last_beliefs(
    offsets: NDArray[np.int64],
    months: Array,
    growth: Array,
    value: Array,
    variance: Array,
    jump: Array,
    sizes: Array,
) -> Array:
    """Return the belief (blocks, 9) at each block's last check."""
    last = np.empty((len(offsets) - 1, 9))
    for block in range(len(offsets) - 1):
        belief = begin(sizes)
        before = 0.0
        for i in range(offsets[block], offsets[block + 1]):
            walked = pulled(months[i] - before, sizes[5])
            belief, _, _ = take(belief, walked, jump[i], growth[i], value[i], variance[i], sizes)
            before = months[i]
        last[block] = np.array(belief)
    return last
