"""Device time set against host time, by the lower envelope of the delays."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class ClockFit:
    """Host time as a line over device time: ``host = host_at_s + (1 + skew) · (device − at_s)``.

    ``host_at_s`` [s] with its 1σ ``sigma_s`` is the host's time at device time ``at_s``, the delay taken out; a
    positive ``skew`` (1σ ``skew_sigma``) means a device clock that runs slow. ``span_s`` is the time it was fitted to.
    """

    at_s: float
    host_at_s: float
    sigma_s: float
    skew: float
    skew_sigma: float
    span_s: float

    @property
    def offset_s(self) -> float:
        """Host time [s] at device time 0."""
        return self.host_at_s - (1 + self.skew) * self.at_s

    def host_time_s(self, device_time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return host times [s] of device times [s]."""
        return self.host_at_s + (1 + self.skew) * (device_time_s - self.at_s)


class HostClock:
    """Sets device time against host time by the lower envelope of the delays.

    Parameters
    ----------
    window_s : device time [s] that is looked back on; oscillators wander over longer ones.

    Notes
    -----
    Whatever happens between device and host makes host times late, never early, so that all points (device, host) lie
    on or above the true line. Close above it they are a Poisson process: n delays of density f near zero put
    Λ = n·f of them into each second of delay. The likelihood of a line below all points is then exp(Λ·a), a its height
    at mid-span, whatever delays look like further up. Mean and spread of offset and skew under that likelihood are the
    estimate and its σ. The spread shrinks as 1/n: a mean of delays would shrink as 1/√n, and about the wrong value.

    Memory is bounded: the window is cut into ``BINS`` bins of which only the lower hulls are kept, and a point off
    its bin's hull can touch no envelope. Λ comes from the least delay of each bin. Delays that hang together for
    longer than a bin make σ too small.
    """

    BINS = 300
    LEAST_BINS = 10
    BUFFERED = 512
    RESOLUTION_S = 1e-7
    """Steps of time stamps: delays are not told apart below it."""

    def __init__(self, window_s: float = 120.0) -> None:
        self._bin_s = window_s / self.BINS
        self._bins: deque[tuple[int, _Points]] = deque(maxlen=self.BINS)
        self._buffer: list[_Points] = []
        self._buffered = 0

    def restart(self) -> None:
        """Forget everything: the device's clock began anew."""
        self._bins.clear()
        self._buffer, self._buffered = [], 0

    def follow(self, device_time_s: NDArray[np.float64], host_time_s: NDArray[np.float64]) -> None:
        """Take samples' device times [s], increasing, and the host times [s] of their arrival."""
        if len(device_time_s):
            self._buffer.append((np.array(device_time_s), np.array(host_time_s)))
            self._buffered += len(device_time_s)
        if self._buffered >= self.BUFFERED:
            self._sort_in()

    def fit(self) -> ClockFit | None:
        """Return the line, or None before a thirtieth of the window has been seen."""
        self._sort_in()
        if len(self._bins) < self.LEAST_BINS:
            return None
        device_s = np.concatenate([points[0] for _, points in self._bins])
        late_s = np.concatenate([points[1] for _, points in self._bins]) - device_s
        at_s, least_s = float(device_s[0] + device_s[-1]) / 2, float(late_s.min())
        x, y = _lower_hull(device_s - at_s, late_s - least_s)
        slope, height = _best_line(x, y)
        starts = np.cumsum([0, *(len(points[0]) for _, points in self._bins)])[:-1]
        least = np.minimum.reduceat(late_s - least_s - height - slope * (device_s - at_s), starts)
        density = len(starts) * (len(starts) - 2) / max(float(least.sum()), self.RESOLUTION_S * len(starts))
        height, sigma_s, slope, slope_sigma = _posterior(x, y, density)
        return ClockFit(
            at_s, at_s + least_s + height, sigma_s, slope, slope_sigma, span_s=float(device_s[-1] - device_s[0])
        )

    def _sort_in(self) -> None:
        """Put buffered points into their bins."""
        if not self._buffer:
            return
        device_s, host_s = (np.concatenate(column) for column in zip(*self._buffer, strict=True))
        self._buffer, self._buffered = [], 0
        numbers = np.floor(device_s / self._bin_s).astype(np.int64)
        edges = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
        for low, high in pairwise(edges):
            number, points = int(numbers[low]), (device_s[low:high], host_s[low:high])
            if self._bins and self._bins[-1][0] == number:
                before = self._bins.pop()[1]
                points = (np.concatenate([before[0], points[0]]), np.concatenate([before[1], points[1]]))
            self._bins.append((number, _lower_hull(*points)))
        oldest = self._bins[-1][0] - self.BINS
        while self._bins[0][0] <= oldest:
            self._bins.popleft()


_Points = tuple[NDArray[np.float64], NDArray[np.float64]]
_LOG_NEGLIGIBLE = 40.0


def _lower_hull(x: NDArray[np.float64], y: NDArray[np.float64]) -> _Points:
    """Return the points of the lower convex hull, ``x`` increasing.

    A point on or above the chord of its neighbours is no corner of it; where all are below theirs the hull is left.
    """
    while len(x) > 2:
        rise = (y[2:] - y[:-2]) * (x[1:-1] - x[:-2])
        keep = np.concatenate([[True], (y[1:-1] - y[:-2]) * (x[2:] - x[:-2]) < rise, [True]])
        if keep.all():
            break
        x, y = x[keep], y[keep]
    return x, y


def _best_line(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float]:
    """Return slope and height at 0 of the highest line there below a lower hull: its edge over 0."""
    edge = min(max(int(np.searchsorted(x, 0.0)), 1), len(x) - 1)
    slope = float((y[edge] - y[edge - 1]) / (x[edge] - x[edge - 1]))
    return slope, float(y[edge] - slope * x[edge])


def _posterior(x: NDArray[np.float64], y: NDArray[np.float64], density: float) -> tuple[float, float, float, float]:
    """Return height at 0 with its σ, and slope with its σ, of a line below the hull under exp(density · height).

    For each slope b the height is at most g(b) = min(y − b·x), concave and straight between the slopes of the hull's
    edges; below g(b) it is exponential. The moments over b are sums on a grid where the likelihood counts.
    """
    slopes = np.diff(y) / np.diff(x)
    reach = _LOG_NEGLIGIBLE / density
    slopes = np.concatenate([[slopes[0] - reach / abs(x[0])], slopes, [slopes[-1] + reach / abs(x[-1])]])
    heights = np.concatenate([y - slopes[:-1] * x, [y[-1] - slopes[-1] * x[-1]]])
    top = int(np.argmax(heights))
    level = heights[top] - reach
    low = np.interp(level, heights[: top + 1], slopes[: top + 1])
    high = np.interp(-level, -heights[top:], slopes[top:])
    grid = np.linspace(low, high, 2001)
    most = np.interp(grid, slopes, heights)
    weights = np.exp(density * (most - heights[top]))
    weights /= weights.sum()
    slope, height = float(weights @ grid), float(weights @ most)
    slope_sigma = float(np.sqrt(weights @ (grid - slope) ** 2))
    sigma = float(np.sqrt(weights @ (most - height) ** 2 + density**-2))
    return height - 1 / density, sigma, slope, slope_sigma
