"""Whether samples come as fast as they are said to: stated time against the host's clock.

KVH users measured 962.4 Hz where 1000 was nominal. Increments of such a block are right, rates made of them with the
nominal interval are 4 % wrong, and nothing in its frames tells.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from drivers.samples import SampleArray, Status

LIMIT = 1e-3
"""Discrepancy that is a condition."""


class RateCheck:
    """Compares stated and host time of one stream, row by row, however it is cut into batches.

    Parameters
    ----------
    latency_s : by how much the host may be late [s].
    stated_rate_hz : what the samples' rate is said to be; None where their own times say it.

    Notes
    -----
    Delays only make the host late, so that the least delay of a window is near the truth. Each window of ten
    latencies, or a hundred samples, gives the drift since the window before; the median of the last sixty counts, and
    only when four in five of them drift the same way by half the limit or more. A stall, a loss or a burst moves a
    few windows and not the median.
    """

    WINDOWS = 60
    ENOUGH = 10
    AGREEING = 0.8

    def __init__(self, latency_s: float = 0.1, stated_rate_hz: float | None = None) -> None:
        self._latency_s, self._stated_rate_hz = latency_s, stated_rate_hz
        self.discrepancy = 0.0
        """How much slower than stated the samples come, as a fraction; 0 until it is known."""
        self.condition = Status(0)
        """``Status.WRONG_RATE`` while the discrepancy is beyond the limit."""
        self._drifts: deque[float] = deque(maxlen=self.WINDOWS)
        self._last_s = np.nan
        self._closed = False  # a window has been since the last judgement
        self._begin()

    def follow(self, samples: SampleArray, host_time_s: NDArray[np.float64]) -> None:
        """Judge the next samples, each with the host time [s] of its arrival."""
        if not len(samples):
            return
        stated_s = np.ascontiguousarray(samples["time"])
        if self._stated_rate_hz is not None:
            stated_s = samples["sequence"] / self._stated_rate_hz
        back = (np.flatnonzero(stated_s[1:] < stated_s[:-1]) + 1).tolist()
        if stated_s[0] < self._last_s:
            back.insert(0, 0)
        for low, high in zip([0, *back], [*back, len(stated_s)], strict=True):
            if low in back:
                self._begin()
            if high > low:
                self._window(stated_s[low:high], host_time_s[low:high])
        self._last_s = float(stated_s[-1])
        if self._closed:
            self._judge()

    def _begin(self) -> None:
        """Begin anew: stated time went back."""
        self._opened_s = np.nan
        self._width_s = np.nan
        self._best = (np.inf, 0.0)
        self._previous: tuple[float, float] | None = None

    def _window(self, stated_s: NDArray[np.float64], host_s: NDArray[np.float64]) -> None:
        """Take rows whose stated time does not go back."""
        delays = host_s - stated_s
        low = 0
        if np.isnan(self._opened_s):
            self._opened_s = float(stated_s[0])
        if np.isnan(self._width_s):
            later = int(np.searchsorted(stated_s, self._opened_s, side="right"))
            if later == len(stated_s):
                self._best = min(self._best, (float(delays[0]), self._opened_s))
                return
            self._width_s = max(10 * self._latency_s, 100 * float(stated_s[later] - self._opened_s))
        while low < len(stated_s):
            high = int(np.searchsorted(stated_s, self._opened_s + self._width_s))
            if high > low:
                row = low + int(np.argmin(delays[low:high]))
                self._best = min(self._best, (float(delays[row]), float(stated_s[row])))
            if high < len(stated_s):
                self._close()
                self._opened_s = float(stated_s[high])
            low = max(high, low)

    def _close(self) -> None:
        """End a window."""
        delay_s, at_s = self._best
        if self._previous is not None:
            later_s, stated_s = delay_s - self._previous[0], at_s - self._previous[1]
            if stated_s > 0 and later_s + stated_s > 0:  # bare bytes come at no host time at all
                self._drifts.append(later_s / stated_s)
        self._previous, self._best = (delay_s, at_s), (np.inf, 0.0)
        self._closed = True

    def _judge(self) -> None:
        """Say what the windows closed so far tell."""
        self._closed = False
        if len(self._drifts) < self.ENOUGH:
            return
        drifts = sorted(self._drifts)
        middle = len(drifts) // 2
        self.discrepancy = (drifts[middle] + drifts[-1 - middle]) / 2
        sign = math.copysign(1.0, self.discrepancy)
        along = sum(drift * sign > LIMIT / 2 for drift in drifts) / len(drifts)
        wrong = abs(self.discrepancy) > LIMIT and along >= self.AGREEING
        self.condition = Status.WRONG_RATE if wrong else Status(0)
