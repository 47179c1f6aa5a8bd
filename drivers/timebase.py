"""Simulated time: one clock that simulator and service share by speed and epoch.

Every limit of the drivers (stale, time-outs, bit rate) is in simulated seconds; at speed 1 they are real seconds.
"""

from __future__ import annotations

import time

HOST_LATENCY_S = 0.4
"""Real time [s] that a loaded host may take to hand a byte on, whatever the speed of simulated time."""


class Timebase:
    """Clock that runs ``speed`` times as fast as the host's monotonic clock and reads 0 at ``epoch_s``.

    Parameters
    ----------
    speed : simulated seconds per real second, above zero.
    epoch_s : reading of the monotonic clock (``time.monotonic``) at simulated time 0; default now. Processes on one
        host that share speed and epoch read the same time.
    """

    def __init__(self, speed: float = 1.0, epoch_s: float | None = None) -> None:
        if not 0 < speed < float("inf"):
            raise ValueError(f"speed is {speed!r}; give a number of simulated seconds per real second above 0")
        self.speed = float(speed)
        self.epoch_s = time.monotonic() if epoch_s is None else float(epoch_s)

    def now_s(self) -> float:
        """Return the simulated time [s] since the epoch."""
        return self.speed * (time.monotonic() - self.epoch_s)

    def sleep_s(self, simulated_s: float) -> None:
        """Sleep for a simulated duration [s]; none or less returns at once."""
        if simulated_s > 0:
            time.sleep(simulated_s / self.speed)

    def real_s(self, simulated_s: float) -> float:
        """Return how long a simulated duration lasts in real seconds."""
        return simulated_s / self.speed

    def limit_s(self, simulated_s: float, host_latency_s: float = HOST_LATENCY_S) -> float:
        """Return a limit [simulated s] no shorter than the host's own latency [real s].

        A limit guards against the line and the block. At speed 50 a limit of 0.5 s is 10 ms of real time, which
        the host's scheduler alone can use up: it would then speak of the host and not of the line.
        """
        return max(simulated_s, host_latency_s * self.speed)
