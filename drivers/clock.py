"""Device clocks: wraps undone, restarts told from wraps, device time set against host time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Unwrapped:
    """Ticks since the first one seen, and the rows at which the device began to count anew (ticks go on from there)."""

    ticks: NDArray[np.int64]
    restarts: list[int]


class WrappingCounter:
    """Makes one long count of a counter that wraps, by help of the host's clock.

    Parameters
    ----------
    modulus : number of values of the counter.
    tick_s : nominal time [s] of one step.
    latency_s : by how much host times may be late [s].

    Notes
    -----
    Between two readings the counter stepped by ``(b - a) mod modulus`` and some whole periods. Their number is the one
    whose time agrees best with the host's, so that the loss of whole periods does not pass unseen. When even the best
    disagrees by more than ``latency_s`` the device began anew. A period of less than twice ``latency_s`` can prove no
    restart: there a step is taken for the shortest.
    """

    def __init__(self, modulus: int, tick_s: float, latency_s: float = 0.1) -> None:
        self._modulus, self._tick_s, self._latency_s = modulus, tick_s, latency_s
        self._last: tuple[int, float] | None = None
        self._ticks = 0

    def unwrap(self, counts: NDArray[np.integer], host_time_s: NDArray[np.float64]) -> Unwrapped:
        """Unwrap the next readings of the counter, each with the host time [s] of its arrival."""
        ticks, restarts = np.empty(len(counts), np.int64), []
        for row, (count, host_s) in enumerate(zip(counts.tolist(), host_time_s.tolist(), strict=True)):
            if self._last is not None:
                step, agrees = self._step(count - self._last[0], host_s - self._last[1])
                if not agrees:
                    restarts.append(row)
                self._ticks += step
            ticks[row] = self._ticks
            self._last = (count, host_s)
        return Unwrapped(ticks, restarts)

    def _step(self, difference: int, elapsed_s: float) -> tuple[int, bool]:
        """Return the step that agrees best with the time that passed, and whether it agrees at all."""
        short = difference % self._modulus
        period_s = self._modulus * self._tick_s
        if period_s < 2 * self._latency_s:
            return short, True
        periods = max(0, round((elapsed_s - short * self._tick_s) / period_s))
        step = short + periods * self._modulus
        return step, abs(step * self._tick_s - elapsed_s) <= self._latency_s


def host_offset_s(device_time_s: NDArray[np.float64], host_time_s: NDArray[np.float64]) -> float:
    """Return the host's time [s] at device time 0: host minus device where the delay was least.

    Delays only ever make the host late, so that the lower envelope is the truth and a mean is not.
    """
    return float(np.min(host_time_s - device_time_s))
