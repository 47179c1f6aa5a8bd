"""The angle of a mount that sways at a record's ends: no power of its rate, but two numbers that gyros hold.

A gyro's rate beside such a mount is the change of an angle that forgets itself. Summed by parts, each of its slow
coefficients holds the first angle and the last, with one sign or the other: taken for power, which adds up by squares,
what begins or ends with the record and adds up alike in all of them would stand out of it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def end_rates(count: int, interval_s: float, correlation_s: float) -> Array:
    """Return the mean rates (2, count) [1/s] beside a unit of angle where the first of so many samples begins.

    And where the last one ends. Given its value at one moment, the angle that two equal lags make of white noise has
    the mean (1 + t/τ)·exp(-t/τ) about it.
    """
    after = np.arange(count + 1) * interval_s / correlation_s
    first = np.diff((1.0 + after) * np.exp(-after)) / interval_s
    return np.stack([first, -first[::-1]])
