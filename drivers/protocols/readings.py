"""From frames of other makers to samples: frames to tables of bytes, readings to increments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from drivers.protocols.base import Decoded, Frame, FrameRun
from drivers.protocols.timelines import Placed
from drivers.protocols.unpack import samples_of
from drivers.samples import SampleArray, Status

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]

ACCEL_INVALID = Status.INVALID_ACCEL_X | Status.INVALID_ACCEL_Y | Status.INVALID_ACCEL_Z
GYRO_INVALID = Status.INVALID_GYRO_X | Status.INVALID_GYRO_Y | Status.INVALID_GYRO_Z
ACCEL_AXES = np.array([Status.INVALID_ACCEL_X, Status.INVALID_ACCEL_Y, Status.INVALID_ACCEL_Z], np.uint32)
GYRO_AXES = np.array([Status.INVALID_GYRO_X, Status.INVALID_GYRO_Y, Status.INVALID_GYRO_Z], np.uint32)
STANDARD_GRAVITY_MPS2 = 9.80665


def table(frames: Sequence[Frame], indices: NDArray[np.intp], skip: int, length: int) -> Bytes:
    """Return bytes ``skip`` to ``skip + length`` of the frames at ``indices`` as the rows of (n, length)."""
    if isinstance(frames, FrameRun):
        rows: Bytes = sliding_window_view(frames.data, length)[frames.starts[indices] + skip]
        return rows
    joined = bytearray().join([frames[index].data[skip : skip + length] for index in indices.tolist()])
    return np.frombuffer(joined, np.uint8).reshape(-1, length)  # writable, as compiled code tells the two apart


def first_bytes(frames: Sequence[Frame], place: int = 0) -> Bytes:
    """Return the byte at ``place`` of every frame."""
    if isinstance(frames, FrameRun):
        found: Bytes = frames.data[frames.starts + place]
        return found
    return np.frombuffer(bytes([frame.data[place] for frame in frames]), np.uint8)


def arrivals(frames: Sequence[Frame]) -> Floats:
    """Return when the last byte of every frame came [s]."""
    if isinstance(frames, FrameRun):
        return frames.host_time_s
    return np.array([frame.host_time_s for frame in frames], np.float64)


def repeats(rows: Bytes, before: bytes) -> NDArray[np.bool_]:
    """Return which rows are byte for byte the row before, the first one compared with ``before``."""
    same = np.zeros(len(rows), np.bool_)
    if len(rows):
        same[0] = rows[0].tobytes() == before
        alike = np.flatnonzero(rows[1:, -1] == rows[:-1, -1]) + 1  # few: checksums end here
        same[alike] = (rows[alike] == rows[alike - 1]).all(axis=1)
    return same


@dataclass(slots=True)
class Readings:
    """What a run of like frames reads, one row a frame, before it is known when.

    ``gyro`` (n, 3) is [rad/s] where ``gyro_is_rate``, else [rad] turned in the interval; ``accel`` likewise [m/s²] or
    [m/s]. ``temperature`` (n, k) [°C], ``status`` (n,) of :class:`~drivers.samples.Status`.
    """

    frame: NDArray[np.intp]
    host_s: Floats
    gyro: Floats
    accel: Floats
    temperature: NDArray[np.floating[Any]]
    status: NDArray[np.uint32]
    count: NDArray[np.int64]
    stamp: NDArray[np.int64]
    same: NDArray[np.bool_]
    gyro_is_rate: bool = True
    accel_is_rate: bool = True

    def __len__(self) -> int:
        return len(self.frame)

    def rows(self, which: slice) -> Readings:
        """Return some of the rows."""
        return replace(self, **{name: getattr(self, name)[which] for name in _COLUMNS})

    def behind(self, earlier: Readings) -> Readings:
        """Return both in one, the earlier rows first and dated to the first frame at hand."""
        columns: dict[str, Any] = {}
        for name in _COLUMNS:
            columns[name] = np.concatenate([getattr(earlier, name), getattr(self, name)])
        columns["frame"][: len(earlier)] = 0
        return replace(self, **columns)

    def drop_what_is_no_number(self) -> None:
        """Put zeros for values that are not finite, and mark their axes invalid."""
        for values, axes in ((self.gyro, GYRO_AXES), (self.accel, ACCEL_AXES)):
            lost = ~(np.abs(values) < _ABSURD)
            if lost.any():
                values[lost] = 0.0
                self.status |= np.where(lost, axes, np.uint32(0)).sum(axis=1, dtype=np.uint32)

    def samples(self, placed: Placed) -> SampleArray:
        """Return the samples; rates are multiplied by the measured interval."""
        whole = np.ones(len(self))
        interval_s = np.ascontiguousarray(placed.interval_s)
        return samples_of(
            placed.sequence,
            placed.time_s,
            (np.ascontiguousarray(self.gyro), interval_s if self.gyro_is_rate else whole),
            (np.ascontiguousarray(self.accel), interval_s if self.accel_is_rate else whole),
            np.ascontiguousarray(self.temperature, np.float32),
            self.status if placed.measured else self.status | np.uint32(Status.START_UP),
        )


_COLUMNS = ("frame", "host_s", "gyro", "accel", "temperature", "status", "count", "stamp", "same")
_ABSURD = 1e9
"""No reading [SI] of this size is one; a damaged or fuzzed float may be anything."""


def add(decoded: Decoded, readings: Readings, placed: Placed) -> None:
    """Append samples to what a run of frames says."""
    samples = readings.samples(placed)
    decoded.samples = np.concatenate([decoded.samples, samples]) if len(decoded.samples) else samples
    decoded.frame_of_sample = np.concatenate([decoded.frame_of_sample, readings.frame])


def floats(values: NDArray[Any]) -> Floats:
    """Return values in double precision; what is no number is none here either, and no cause for a warning."""
    with np.errstate(invalid="ignore"):
        return values.astype(np.float64)


def flags(mask: NDArray[np.bool_], condition: int) -> NDArray[np.uint32]:
    """Return the condition where the mask holds, 0 elsewhere."""
    return np.where(mask, np.uint32(condition), np.uint32(0))


def axis_flags(bad: NDArray[np.bool_], axes: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return the conditions of the bad axes (n, 3), one word a row."""
    words: NDArray[np.uint32] = np.where(bad, axes, np.uint32(0)).sum(axis=1, dtype=np.uint32)
    return words


def encoding_intervals_s(samples: SampleArray, fallback_s: float) -> Floats:
    """Return the interval of every sample [s] for an encoder of rates; ``fallback_s`` where one row tells none."""
    frames = np.diff(samples["sequence"]).astype(np.int32)
    elapsed = np.diff(samples["time"])
    good = (frames > 0) & (elapsed > 0)
    if not good.any():
        return np.full(len(samples), fallback_s)
    interval_s = np.where(good, elapsed / np.where(good, frames, 1), np.nan)
    typical = float(np.median(interval_s[good]))
    return np.concatenate([[typical], np.where(good, interval_s, typical)])
