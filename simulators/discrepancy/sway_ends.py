"""The angle of a mount that sways at a record's ends: no power of its rate, but two numbers that gyros hold.

A gyro's rate beside such a mount is the change of an angle that forgets itself. Summed by parts, each of its slow
coefficients holds the first angle and the last, with one sign or the other: taken for power, which adds up by squares,
what begins or ends with the record and adds up alike in all of them would stand out of it. What comes of turns is
power: a block that is turned meanwhile feels the angle come back about another axis.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from simulators.motion import Turn

Array = NDArray[np.float64]


def end_rates(count: int, interval_s: float, correlation_s: float) -> Array:
    """Return the mean rates (2, count) [1/s] beside a unit of angle where the first of so many samples begins.

    And where the last one ends. Given its value at one moment, the angle that two equal lags make of white noise has
    the mean (1 + t/τ)·exp(-t/τ) about it.
    """
    after = np.arange(count + 1) * interval_s / correlation_s
    first = np.diff((1.0 + after) * np.exp(-after)) / interval_s
    return np.stack([first, -first[::-1]])


def turned_ends(turns: Iterable[Turn], correlation_s: float) -> Array:
    """Return how much turns of a block add to each gyro's slow coefficients (3,), over what both ends would.

    A gyro across the axis of a turn at a rate ω takes up ω times the angle about the third axis. With x = T/τ the
    integral of a unit angle over T has the variance 2·τ²·(2·x - 3 + (x + 3)·exp(-x)), half of which a coefficient
    holds in the mean over times of the turn, where it holds all of an end.
    """
    ends = np.zeros(3)
    for turn in turns:
        lasts = (turn.end_s - turn.start_s) / correlation_s
        integral_s2 = 2.0 * correlation_s**2 * (2.0 * lasts - 3.0 + (lasts + 3.0) * np.exp(-lasts))
        axis = np.asarray(turn.axis) / np.linalg.norm(turn.axis)
        across = 1.0 - axis**2 if turn.frame == "body" else np.full(3, 2.0 / 3.0)
        ends += 0.25 * across * turn.rate_radps**2 * integral_s2
    return ends
