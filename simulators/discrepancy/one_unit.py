"""Whether sensors of a triad share the unit of those that tell theirs: whoever mistakes one mistakes all, mostly.

A sensor that hardly feels its input cannot tell by what factor it is off. Its noise can: it is as many times larger.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from inertial.documents import CHANNELS, Noise

Array = NDArray[np.float64]

_NEAR = 1.0 / 3.0  # of a factor's logarithm, by which noise may be other than its share


def sharing(factor: float, told: Sequence[int], noise: Array, proportions: Array) -> list[int]:
    """Return which of three sensors have noise larger by a factor, as those that are ``told`` by their input have.

    ``noise`` (3,) is what each has, in ``proportions`` (3,) if all had the same unit.
    """
    larger = np.log(noise / proportions)
    off = np.abs(larger - np.mean(larger[list(told)]))
    return [c for c in range(3) if off[c] < _NEAR * abs(np.log(factor))]


def proportions_of(noise: Noise, first: int) -> Array:
    """Return the white noise of a triad's sensors (3,) as a model states it; alike where it does not."""
    white = np.array([getattr(noise, name).white for name in CHANNELS[first : first + 3]])
    return white if np.all(white > 0.0) else np.ones(3)
