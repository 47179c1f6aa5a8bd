"""The one sample record that every protocol produces and everything above reads."""

from __future__ import annotations

from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

SampleArray = NDArray[np.void]
"""Structured array with the fields of :func:`sample_dtype`, one row per frame."""


class Status(IntFlag):
    """Named conditions of a block, the same whatever protocol reported them (field ``status``)."""

    START_UP = 1 << 0
    OVERLOAD = 1 << 1
    OUT_OF_RANGE = 1 << 2
    SELF_TEST_FAILED = 1 << 3
    INTEGRITY = 1 << 4
    WRONG_RATE = 1 << 5
    """The host's clock contradicts the rate that the block or its user states by more than 0.1 %."""
    INVALID_ACCEL_X = 1 << 8
    INVALID_ACCEL_Y = 1 << 9
    INVALID_ACCEL_Z = 1 << 10
    INVALID_GYRO_X = 1 << 11
    INVALID_GYRO_Y = 1 << 12
    INVALID_GYRO_Z = 1 << 13


def sample_dtype(temperatures: int = 1) -> np.dtype[np.void]:
    """Record layout with ``temperatures`` temperature sensors.

    ``sequence`` [frames since the block started, unwrapped modulo 2³²], ``time`` [s, device clock, unwrapped],
    ``dv`` [m/s gained in the sample's interval, body], ``dtheta`` [rad turned in it, body], ``temperature`` [°C],
    ``supply`` [V], ``status`` [:class:`Status`]. A sensor that the block does not have reads NaN.
    """
    return np.dtype(
        [
            ("sequence", np.uint32),
            ("time", np.float64),
            ("dv", np.float64, (3,)),
            ("dtheta", np.float64, (3,)),
            ("temperature", np.float32, (temperatures,)),
            ("supply", np.float32),
            ("status", np.uint32),
        ]
    )


def empty_samples(count: int = 0, temperatures: int = 1) -> SampleArray:
    """Return ``count`` zeroed rows with unknown (NaN) temperature and supply."""
    samples = np.zeros(count, sample_dtype(temperatures))
    samples["temperature"] = np.nan
    samples["supply"] = np.nan
    return samples


def intervals_s(samples: SampleArray) -> NDArray[np.float64]:
    """Device interval of every sample [s], from its own clock and sequence, never from a nominal rate.

    The time between two rows is shared over the frames their sequence numbers say lie between them, so that a
    row behind a gap keeps the interval it was integrated over. The first row takes its successor's.

    Raises
    ------
    ValueError
        Fewer than two samples, or time or sequence not increasing.
    """
    if len(samples) < 2:
        raise ValueError("an interval needs two samples or more")
    steps = np.diff(samples["sequence"]).astype(np.int32)  # modulo 2³²: a wrap counts as one step
    elapsed = np.diff(samples["time"])
    if np.any(steps <= 0) or np.any(elapsed <= 0):
        worst = int(np.flatnonzero((steps <= 0) | (elapsed <= 0))[0]) + 1
        raise ValueError(f"sample {worst}: device time or sequence does not increase")
    interval = elapsed / steps
    return np.concatenate([interval[:1], interval])
