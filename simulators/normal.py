"""Standard normal noise: its density, and by how much it reaches beyond a limit in the mean."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

Array = NDArray[np.float64]


def density(z: Array) -> Array:
    """Return φ(z)."""
    return np.asarray(np.exp(-0.5 * np.square(z)) / math.sqrt(2.0 * math.pi))


def beyond(z: Array) -> Array:
    """Return E[max(z + n, 0)] of standard normal n."""
    return np.asarray(z * ndtr(z) + density(z))
