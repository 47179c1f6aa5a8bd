"""The Kalman filter of the drift model of :mod:`inertial.ageing`, one block at a time.

State: offset, slope, walk. A check sees offset + h·slope + walk. ``sizes`` are mean, spread², offset², walk², scatter²,
``jump`` the variance of a step before each check, mostly 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from inertial.compiled import compiled

Array = NDArray[np.float64]


@compiled
def begin(sizes: Array) -> Array:
    """Return the belief at the laboratory: state (3), then its covariances aa, ss, ww, as, aw, sw."""
    return np.array([0.0, sizes[0], 0.0, sizes[2], sizes[1], 0.0, 0.0, 0.0, 0.0])


@compiled
def take(
    belief: Array, elapsed: float, jump: float, growth: float, value: float, variance: float, sizes: Array
) -> tuple[float, float]:
    """Take in one check, ``elapsed`` months after the one before; return its innovation and the variance of that."""
    belief[5] += sizes[3] * elapsed + jump
    ga = belief[3] + growth * belief[6] + belief[7]
    gs = belief[6] + growth * belief[4] + belief[8]
    gw = belief[7] + growth * belief[8] + belief[5]
    f = ga + growth * gs + gw + variance + sizes[4]
    v = value - belief[0] - growth * belief[1] - belief[2]
    gain = v / f
    belief[0] += ga * gain
    belief[1] += gs * gain
    belief[2] += gw * gain
    belief[3] -= ga * ga / f
    belief[4] -= gs * gs / f
    belief[5] -= gw * gw / f
    belief[6] -= ga * gs / f
    belief[7] -= ga * gw / f
    belief[8] -= gs * gw / f
    return v, f


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
    for block in range(len(offsets) - 1):
        belief = begin(sizes)
        before = 0.0
        for i in range(offsets[block], offsets[block + 1]):
            v, f = take(belief, months[i] - before, jump[i], growth[i], value[i], variance[i], sizes)
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
        v, f = take(belief, months[i] - before, jump[i], growth[i], value[i], variance[i], sizes)
        before = months[i]
        innovation[i], deviation[i] = v, np.sqrt(f)
    return innovation, deviation


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
            take(belief, months[i] - before, jump[i], growth[i], value[i], variance[i], sizes)
            before = months[i]
        last[block] = belief
    return last
