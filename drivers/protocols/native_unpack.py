"""Native data frames to samples in compiled code, from where they stand among other bytes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import compiled, compiled_inline
from drivers.crc import Bytes, little_u32
from drivers.protocols.native import (
    DTHETA_LSB_RAD,
    DV_LSB_MPS,
    NO_SUPPLY,
    NO_TEMPERATURE,
    TEMPERATURE_LSB_C,
    TEMPERATURES,
)
from drivers.samples import SampleArray, sample_dtype

# Offsets in the frame, docs/native-protocol.md.
_KIND, _SEQUENCE, _TIME, _DV, _DTHETA, _TEMPERATURE, _SUPPLY, _STATUS = 5, 8, 12, 20, 32, 44, 50, 52
_PER_VOLT = np.float32(1e3)
_TEMPERATURE_LSB = np.float32(TEMPERATURE_LSB_C)
_NAN = np.float32(np.nan)
Column = NDArray[np.float64]


def unpack(data: Bytes, starts: NDArray[np.int64]) -> SampleArray:
    """Return the samples of the data frames that begin at ``starts``, as ``decode_samples`` would."""
    # Every row asked for is written. At least two are made: columns of fewer are of another type, contiguous, for which
    # all would be compiled anew.
    samples = np.empty(max(len(starts), 2), sample_dtype(TEMPERATURES))
    columns = [samples[name] for name in ("sequence", "time", "dv", "dtheta", "temperature", "supply", "status")]
    _unpack(data, starts, *columns)
    return samples[: len(starts)]


def rows_of_kind(data: Bytes, starts: NDArray[np.int64], kind: int) -> NDArray[np.intp]:
    """Return which of the frames that begin at ``starts`` are of a kind."""
    if _count_kind(data, starts, kind) == len(starts):
        return np.arange(len(starts))
    return np.flatnonzero(data[starts + _KIND] == kind)


@compiled
def _count_kind(data: Bytes, starts: NDArray[np.int64], kind: int) -> int:
    count = 0
    for row in range(len(starts)):
        count += data[starts[row] + _KIND] == kind
    return count


@compiled_inline
def _i32(data: Bytes, start: int) -> np.int32:
    return np.int32(little_u32(data, start))


@compiled_inline
def _u16(data: Bytes, start: int) -> np.uint16:
    return np.uint16(data[start]) | np.uint16(np.uint16(data[start + 1]) << np.uint16(8))


@compiled
def _unpack(
    data: Bytes,
    starts: NDArray[np.int64],
    sequence: NDArray[np.uint32],
    time: Column,
    dv: Column,
    dtheta: Column,
    temperature: NDArray[np.float32],
    supply: NDArray[np.float32],
    status: NDArray[np.uint32],
) -> None:
    for row in range(len(starts)):
        at = starts[row]
        sequence[row] = little_u32(data, at + _SEQUENCE)
        low, high = little_u32(data, at + _TIME), little_u32(data, at + _TIME + 4)
        time[row] = np.float64(np.uint64(low) | (np.uint64(high) << np.uint64(32))) / 1e6
        for axis in range(3):
            dv[row, axis] = _i32(data, at + _DV + 4 * axis) * DV_LSB_MPS
            dtheta[row, axis] = _i32(data, at + _DTHETA + 4 * axis) * DTHETA_LSB_RAD
        for sensor in range(TEMPERATURES):
            counts = np.int16(_u16(data, at + _TEMPERATURE + 2 * sensor))
            temperature[row, sensor] = _NAN if counts == NO_TEMPERATURE else np.float32(counts) * _TEMPERATURE_LSB
        millivolts = _u16(data, at + _SUPPLY)
        supply[row] = _NAN if millivolts == NO_SUPPLY else np.float32(millivolts) / _PER_VOLT
        status[row] = little_u32(data, at + _STATUS)
