"""How much one client may ask: a bucket for each that fills at a steady rate."""

from __future__ import annotations

import time
from collections.abc import Callable

BURST_S = 5.0
CLIENTS_MAX = 10_000


class RateLimit:
    """One bucket a client.

    Parameters
    ----------
    per_s
        Requests per second in the long run.
    burst_s
        What is saved up in so many seconds may be spent at once.
    clock
        Monotonic seconds.
    """

    def __init__(self, per_s: float, burst_s: float = BURST_S, clock: Callable[[], float] = time.monotonic) -> None:
        self._per_s, self._clock = per_s, clock
        self._full = max(per_s * burst_s, 1.0)
        self._buckets: dict[str, tuple[float, float]] = {}

    def wait_s(self, client: str) -> float:
        """Return the seconds after which a request could be taken, 0 for now."""
        return max(1.0 - self._left(client, self._clock()), 0.0) / self._per_s

    def take(self, client: str) -> float:
        """Take one request; return 0, or the seconds after which it could be."""
        now_s = self._clock()
        left = self._left(client, now_s)
        if left < 1.0:
            return (1.0 - left) / self._per_s
        if client not in self._buckets and len(self._buckets) >= CLIENTS_MAX:
            self._buckets.clear()
        self._buckets[client] = (left - 1.0, now_s)
        return 0.0

    def _left(self, client: str, now_s: float) -> float:
        left, at_s = self._buckets.get(client, (self._full, now_s))
        return min(left + (now_s - at_s) * self._per_s, self._full)
