"""Compiled work on the rows of a batch that every maker's decoder shares: readings to samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import compiled
from drivers.samples import SampleArray, sample_dtype

Floats = NDArray[np.float64]
Column = NDArray[np.float64]


def samples_of(
    sequence: NDArray[np.int64],
    time_s: Floats,
    dtheta: tuple[Floats, Floats],
    dv: tuple[Floats, Floats],
    temperature: NDArray[np.float32],
    status: NDArray[np.uint32],
) -> SampleArray:
    """Return samples; ``dtheta`` and ``dv`` are each a reading (n, 3) and what (n,) to multiply it with."""
    # Every row asked for is written. At least two are made: columns of fewer are of another type, contiguous, for which
    # all would be compiled anew.
    samples = np.empty(max(len(sequence), 2), sample_dtype(temperature.shape[1]))
    columns = [samples[name] for name in ("sequence", "time", "dv", "dtheta", "temperature", "supply", "status")]
    _fill(sequence, time_s, *dtheta, *dv, temperature, status, *columns)
    return samples[: len(sequence)]


@compiled
def _fill(
    sequence: NDArray[np.int64],
    time_s: Floats,
    gyro: Floats,
    gyro_factor: Floats,
    accel: Floats,
    accel_factor: Floats,
    celsius: NDArray[np.float32],
    conditions: NDArray[np.uint32],
    to_sequence: NDArray[np.uint32],
    to_time: Column,
    to_dv: Column,
    to_dtheta: Column,
    to_temperature: NDArray[np.float32],
    to_supply: NDArray[np.float32],
    to_status: NDArray[np.uint32],
) -> None:
    for row in range(len(sequence)):
        to_sequence[row] = np.uint32(sequence[row] & 0xFFFFFFFF)
        to_time[row] = time_s[row]
        for axis in range(3):
            to_dtheta[row, axis] = gyro[row, axis] * gyro_factor[row]
            to_dv[row, axis] = accel[row, axis] * accel_factor[row]
        for sensor in range(celsius.shape[1]):
            to_temperature[row, sensor] = celsius[row, sensor]
        to_supply[row] = np.float32(np.nan)
        to_status[row] = conditions[row]
