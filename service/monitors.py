"""What the sequencer watches in the samples: stuck channels, flags of the block, and whether it has settled.

Each monitor is fed every batch and answers one question. Times are block seconds.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.samples import SampleArray, Status
from inertial.documents import CHANNELS

MG_MPS2 = 9.80665e-3
DPH_RADPS = math.pi / 180 / 3600
INVALID = (
    Status.SELF_TEST_FAILED
    | Status.INTEGRITY
    | Status.INVALID_ACCEL_X
    | Status.INVALID_ACCEL_Y
    | Status.INVALID_ACCEL_Z
    | Status.INVALID_GYRO_X
    | Status.INVALID_GYRO_Y
    | Status.INVALID_GYRO_Z
)
OVERRANGE = Status.OVERLOAD | Status.OUT_OF_RANGE
Vector = NDArray[np.float64]


def channels(samples: SampleArray) -> Vector:
    """Return the increments as (n, 6), in the order of :data:`inertial.documents.CHANNELS`."""
    return np.concatenate([samples["dv"], samples["dtheta"]], axis=1)


class StuckMonitor:
    """Finds a channel that repeats one value exactly for longer than ``limit_s``."""

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._value = np.full(6, np.nan)
        self._since_s = np.full(6, np.nan)

    def feed(self, samples: SampleArray) -> list[str]:
        """Take a batch; return the names of the channels that are stuck at its end."""
        if len(samples) == 0:
            return []
        values, times = channels(samples), samples["time"]
        changed = values != np.vstack([self._value, values[:-1]])
        newest = len(values) - 1 - np.argmax(changed[::-1], axis=0)
        self._since_s = np.where(changed.any(axis=0), times[newest], self._since_s)
        self._value = values[-1]
        stuck = times[-1] - self._since_s >= self._limit_s
        return [CHANNELS[channel] for channel in np.flatnonzero(stuck)]


class FlagMonitor:
    """Tells conditions that the block itself reports for ``limit_s`` without a break."""

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._clear_s = math.nan

    def feed(self, samples: SampleArray) -> list[str]:
        """Take a batch; return the named conditions once they have lasted."""
        if len(samples) == 0:
            return []
        times = samples["time"]
        clear = np.flatnonzero((samples["status"] & INVALID) == 0)
        if len(clear):
            self._clear_s = float(times[clear[-1]])
        elif math.isnan(self._clear_s):
            self._clear_s = float(times[0])
        if times[-1] - self._clear_s < self._limit_s:
            return []
        return [str(flag.name) for flag in Status if flag & INVALID and flag & int(samples["status"][-1])]


@dataclass(frozen=True)
class Settled:
    """Evidence of settling: drift over the window against its limit, each with its own 1σ."""

    gathered_s: float
    settled: bool
    text: str


class SettlingMonitor:
    """Judges drift of temperature and sensors by straight lines through block means.

    The window is cut into twelve parts; a line through their means gives the slope and, from what is left about the
    line, its σ. Settled: every slope is below its limit, or below 3σ of what noise alone would give, so that a noisy
    block can settle and a quiet one has to.
    """

    PARTS = 12

    def __init__(self, window_s: float, temperature_cpmin: float, accel_mps2_pmin: float, gyro_radps_pmin: float):
        self._part_s = window_s / self.PARTS
        self._limits = np.array([accel_mps2_pmin] * 3 + [gyro_radps_pmin] * 3 + [temperature_cpmin])
        self._parts: list[Vector]
        self.reset()

    def reset(self) -> None:
        """Begin the window again."""
        self._parts = []
        self._origin_s = self._last_s = math.nan
        self._open(0)

    def feed(self, samples: SampleArray) -> Settled:
        """Take a batch and judge the last full window; a part without any samples begins the window again."""
        if len(samples) and math.isnan(self._origin_s):
            self._origin_s = float(samples["time"][0])
        numbers = np.floor((samples["time"] - self._origin_s) / self._part_s + 1e-9).astype(int)
        edges = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(samples)]
        for first, last in itertools.pairwise(edges):
            if last > first:
                self._take(int(numbers[first]), samples[first:last])
        return self._judge()

    def _open(self, number: int) -> None:
        self._number, self._sum, self._count = number, np.zeros(7), 0

    def _take(self, number: int, samples: SampleArray) -> None:
        """Add rows of one part of the window, closing the part before."""
        if number != self._number:
            follows = number == self._number + 1 and self._count > 0
            self._parts = [*self._parts, self._sum / self._count][-self.PARTS :] if follows else []
            self._open(number)
        interval_s = _typical_interval_s(samples, self._last_s)
        if interval_s is not None:
            temperature = np.nan_to_num(samples["temperature"]).mean(axis=1)
            self._sum += np.column_stack([channels(samples) / interval_s, temperature]).sum(axis=0)
            self._count += len(samples)
        self._last_s = float(samples["time"][-1])

    def _judge(self) -> Settled:
        gathered_s = len(self._parts) * self._part_s
        if len(self._parts) < self.PARTS:
            return Settled(gathered_s, False, "gathering")
        minutes = (np.arange(self.PARTS) - (self.PARTS - 1) / 2) * self._part_s / 60
        means = np.array(self._parts)
        slope = minutes @ means / (minutes @ minutes)
        left = means - means.mean(axis=0) - np.outer(minutes, slope)
        sigma = np.sqrt((left**2).sum(axis=0) / (self.PARTS - 2) / (minutes @ minutes))
        excess = np.abs(slope) / np.maximum(self._limits, 3 * sigma)
        worst = int(np.argmax(excess))
        return Settled(gathered_s, bool(excess[worst] <= 1), _describe(worst, slope, self._limits))


def _typical_interval_s(samples: SampleArray, before_s: float) -> float | None:
    """Median time between rows; a batch of one row uses the row before it."""
    times = samples["time"] if math.isnan(before_s) else np.concatenate([[before_s], samples["time"]])
    return float(np.median(np.diff(times))) if len(times) > 1 else None


def _describe(worst: int, slope: Vector, limits: Vector) -> str:
    name, unit, scale = (
        (CHANNELS[worst], "mg/min", MG_MPS2)
        if worst < 3
        else (CHANNELS[worst], "deg/h/min", DPH_RADPS)
        if worst < 6
        else ("temperature", "°C/min", 1.0)
    )
    return f"{name} drifts {slope[worst] / scale:+.3g} {unit} (limit {limits[worst] / scale:.3g})"
