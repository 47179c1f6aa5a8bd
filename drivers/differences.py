"""Differences from row to row of a stream that goes on from batch to batch."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def differences(values: NDArray[Any], before: float) -> NDArray[Any]:
    """Return by how much each value exceeds the one ahead of it, the first one ``before``.

    As ``np.diff`` with ``prepend``, which costs four times as much for the few rows of a live batch.
    """
    steps = np.empty_like(values)
    if len(values):
        steps[:1] = values[:1] - values.dtype.type(before)  # as arrays, which wrap without a warning
        np.subtract(values[1:], values[:-1], out=steps[1:])
    return steps
