"""Normal datagrams of the STIM300 to counts in compiled code."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import compiled, compiled_inline

Bytes = NDArray[np.uint8]
Words = NDArray[np.uint32]
TEMPERATURES = 6
_TEMPERATURE_LSB_C = np.float32(2.0**-8)


class Counts:
    """What rows of one content hold.

    ``axes`` (n, 6) are the counts of gyros and accelerometers, ``celsius`` (n, 6) the temperatures [°C] of gyros x, y,
    z, accelerometers x, y, z, NaN where not sent, ``status`` (n,) the named conditions, ``counter`` (n,) and
    ``latency_us`` (n,) what they are called.

    Parameters
    ----------
    rows : (n, length) datagrams.
    has_accel : whether accelerometers follow the gyros.
    temperature_at : where temperatures begin, 0 where there are none.
    gyro_words, accel_words : (256,) conditions of each status byte.
    """

    def __init__(
        self, rows: Bytes, has_accel: bool, temperature_at: int, gyro_words: Words, accel_words: Words
    ) -> None:
        count = len(rows)
        self.axes = np.zeros((count, 6))
        self.celsius = np.full((count, TEMPERATURES), np.nan, np.float32)
        self.status = np.empty(count, np.uint32)
        self.counter, self.latency_us = np.empty(count, np.int64), np.empty(count, np.int64)
        into = (self.axes, self.celsius, self.status, self.counter, self.latency_us)
        _unpack(rows, has_accel, temperature_at, gyro_words, accel_words, *into)


@compiled_inline
def _axes(rows: Bytes, row: int, at: int, first: int, axes: NDArray[np.float64]) -> None:
    """Read three numbers of 24 bits."""
    for axis in range(3):
        place = at + 3 * axis
        high = np.int64(np.int8(rows[row, place]))
        axes[row, first + axis] = high * 65536 + np.int64(rows[row, place + 1]) * 256 + np.int64(rows[row, place + 2])


@compiled
def _unpack(
    rows: Bytes,
    has_accel: bool,
    temperature_at: int,
    gyro_words: Words,
    accel_words: Words,
    axes: NDArray[np.float64],
    celsius: NDArray[np.float32],
    status: Words,
    counter: NDArray[np.int64],
    latency_us: NDArray[np.int64],
) -> None:
    tail = rows.shape[1] - 7
    for row in range(len(rows)):
        _axes(rows, row, 1, 0, axes)
        word = gyro_words[rows[row, 10]]
        if has_accel:
            _axes(rows, row, 11, 3, axes)
            word |= accel_words[rows[row, 20]]
        status[row] = word
        if temperature_at > 0:
            for cluster in range(2 if has_accel else 1):
                for axis in range(3):
                    place = temperature_at + 7 * cluster + 2 * axis
                    counts = np.int64(np.int8(rows[row, place])) * 256 + np.int64(rows[row, place + 1])
                    celsius[row, 3 * cluster + axis] = np.float32(counts) * _TEMPERATURE_LSB_C
        counter[row] = rows[row, tail]
        latency_us[row] = np.int64(rows[row, tail + 1]) * 256 + np.int64(rows[row, tail + 2])
