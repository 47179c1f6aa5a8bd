"""What samples lost under a vibration may have held.

A vibration begins and ends at rest, so that over all its samples its mean is nothing. What gaps took of it the mean of
those that came lacks, and no more than its spread is known: that of as long a part of what came.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simulators.discrepancy.compare import Scene

Array = NDArray[np.float64]

_FEWEST = 20  # parts of what came, each as long as a gap, that tell how large such a part is


def lost_vibration(scene: Scene) -> list[tuple[Array, float]]:
    """Return, of each vibration with gaps, a mean along its axis as a change of readings (n, 6), and its σ."""
    found = []
    came = scene.accelerometers_came
    for rows, axis in scene.vibrations:
        sigma = missed_mean_sigma(scene.shaken[rows] @ axis, came[rows])
        if sigma > 0.0:
            change = np.zeros((scene.time_s.size, 6))
            change[rows, :3] = axis
            found.append((change, sigma))
    return found


def missed_mean_sigma(vibration: Array, came: NDArray[np.bool_]) -> float:
    """Return σ of the mean of those samples of a vibration (n,) that ``came`` (n,), the whole's being nothing."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], came, [True]]).astype(np.int8)))
    lengths = edges[1::2] - edges[::2]
    if not lengths.size or not came.any():
        return 0.0
    total = np.concatenate([[0.0], np.cumsum(np.where(came, vibration, 0.0))])
    known = np.concatenate([[0], np.cumsum(came)])
    variance = sum(_variance_of_sum(total, known, int(length)) for length in lengths)
    return math.sqrt(variance) / int(came.sum())


def _variance_of_sum(total: Array, known: NDArray[np.int64], length: int) -> float:
    """Return the variance of the sum of so many samples in a row, or of as many shorter parts as make them up."""
    parts, part = 1, length
    while (whole := known[part:] - known[:-part] == part).sum() < _FEWEST and part > 1:
        parts += 1
        part = -(-length // parts)
    return parts * float(np.mean((total[part:] - total[:-part])[whole] ** 2))
