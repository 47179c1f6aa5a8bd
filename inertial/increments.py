"""One span of readings without gaps, as every estimator takes it, and the repair of a few lost samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from inertial.error_model import Coefficients, Terms, true_from_readings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Increments:
    """Readings of a span of device time, body axes, one row a sample, none missing.

    ``start_s`` device time at which the first sample's interval begins; ``dv_mps`` (n, 3) [m/s], ``dtheta_rad``
    (n, 3) [rad] as the block sent them; ``interval_s`` (n,) [s]; ``repaired`` how many rows were interpolated.
    """

    start_s: float
    dv_mps: Array
    dtheta_rad: Array
    interval_s: Array
    repaired: int = 0

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.interval_s)

    @property
    def duration_s(self) -> float:
        """Return the time that the span covers [s]."""
        return float(np.sum(self.interval_s))

    def readings(self) -> tuple[Array, Array]:
        """Return accelerometer [m/s²] and gyro [rad/s] readings (n, 3): each increment over its own interval."""
        return self.dv_mps / self.interval_s[:, None], self.dtheta_rad / self.interval_s[:, None]

    def true(self, coefficients: Coefficients, terms: Terms | None = None) -> tuple[Array, Array]:
        """Return the true velocity [m/s] and angle [rad] increments (n, 3) by (8), (9), sample by sample."""
        accel, gyro = true_from_readings(*self.readings(), coefficients, terms)
        return accel * self.interval_s[:, None], gyro * self.interval_s[:, None]


def increments_of(
    sequence: ArrayLike, time_s: ArrayLike, dv_mps: ArrayLike, dtheta_rad: ArrayLike, interval_s: ArrayLike
) -> Increments:
    """Return samples (n rows) as a span without gaps; lost ones are interpolated and counted.

    Where the sequence jumps by k + 1, k rows are put in whose rates run linearly from the sample before the gap to
    the one behind it, over the interval of the latter (a row behind a gap keeps the interval it was itself integrated
    over, as ``drivers.samples.intervals_s`` gives it). Pure and in order, so that live and replay agree bit for bit.
    How much loss is too much is the caller's to say: compare ``repaired`` with the length.

    Parameters
    ----------
    sequence : (n,)
        Frame counter, modulo 2³².
    time_s : (n,)
        Device time at the end of each sample [s].

    Raises
    ------
    ValueError
        Nothing given, lengths that differ, a sequence that does not increase, intervals that are not positive.
    """
    counter = np.asarray(sequence).astype(np.uint32)
    dv, dtheta = np.array(dv_mps, dtype=np.float64), np.array(dtheta_rad, dtype=np.float64)
    interval = np.array(interval_s, dtype=np.float64)
    time = np.asarray(time_s, dtype=np.float64)
    count = len(counter)
    if count == 0 or dv.shape != (count, 3) or dtheta.shape != (count, 3) or interval.shape != time.shape != (count,):
        raise ValueError(
            f"samples do not match: {count} sequence numbers, dv {dv.shape}, dtheta {dtheta.shape}, "
            f"interval {interval.shape}, time {time.shape}; give one row of each per sample"
        )
    if not np.all(interval > 0.0):
        raise ValueError(f"sample {int(np.argmin(interval > 0.0))}: the interval is not positive")
    steps = np.diff(counter).astype(np.int32)
    if np.any(steps <= 0):
        raise ValueError(f"sample {int(np.argmax(steps <= 0)) + 1}: the sequence does not increase")
    start = float(time[0] - interval[0])
    missing = int(np.sum(steps - 1))
    if missing == 0:
        return Increments(start, dv, dtheta, interval)
    # Position of every row of the whole span among the rows that came: whole where one came, between where not.
    place = np.concatenate([[0], np.cumsum(steps)])
    whole = np.arange(place[-1] + 1)
    behind = np.searchsorted(place, whole)
    full_interval = interval[behind]
    rates = np.hstack([dv, dtheta]) / interval[:, None]
    filled = np.column_stack([np.interp(whole, place, rates[:, c]) for c in range(6)]) * full_interval[:, None]
    filled[place] = np.hstack([dv, dtheta])  # what was sent stays as it was sent
    return Increments(start, filled[:, :3].copy(), filled[:, 3:].copy(), full_interval, missing)
