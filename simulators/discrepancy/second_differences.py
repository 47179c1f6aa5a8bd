"""Second differences of block means, which tell noise from a course that bends now and then, and a mean without those.

Of white noise of variance σ² a sample they have the variance 6 σ²/block. No median: of readings in coarse steps it is
zero as soon as half of the differences are.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm, trim1

Array = NDArray[np.float64]

_LARGEST = 0.1  # share that is left out
_LIMIT = float(norm.ppf(1.0 - 0.5 * _LARGEST))
MEAN_SIZE = math.sqrt(2.0 / math.pi) * (1.0 - math.exp(-0.5 * _LIMIT**2)) / (1.0 - _LARGEST)
"""Ordinary mean of the sizes of standard normal variables, E(|z|; |z| < limit)."""
MEAN_SQUARE = float(chi2.cdf(_LIMIT**2, 3)) / (1.0 - _LARGEST)
"""... and of their squares."""


def second_differences(values: Array, block: int) -> Array:
    """Return the second differences of block means (m, …) of values (n, …)."""
    count = len(values) // block
    return np.asarray(np.diff(values[: count * block].reshape(count, block, *values.shape[1:]).mean(axis=1), 2, axis=0))


def ordinary_mean(sizes: Array) -> Array:
    """Return the mean (…) of sizes (m, …) but the largest tenth, which are systematic."""
    return np.asarray(trim1(sizes, _LARGEST, axis=0).mean(axis=0))
