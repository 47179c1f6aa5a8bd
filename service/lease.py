"""The lease: one console commands at a time, the others watch."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass


class LeaseHeld(Exception):
    """Somebody else commands; ``lease`` tells who, and for how long if he does not renew."""

    def __init__(self, lease: Lease, left_s: float) -> None:
        super().__init__(f"{lease.holder} commands this service for {left_s:.0f} s more")
        self.lease, self.left_s = lease, left_s


class NoSuchLease(Exception):
    """The lease has run out, was taken over, or never was."""


@dataclass(frozen=True)
class Lease:
    """Who commands until when [monotonic s]; ``id`` is known to the holder alone."""

    id: str
    holder: str
    ends_s: float


class LeaseDesk:
    """Gives and checks the lease. Safe to call from any thread.

    While nobody holds it, whoever may command does, as a single console would; while somebody does, only he.

    Parameters
    ----------
    clock
        Monotonic seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._lease: Lease | None = None

    def current(self) -> tuple[Lease, float] | None:
        """Return the lease and the seconds it has left; None when nobody holds it."""
        lease = self._lease
        left_s = 0.0 if lease is None else lease.ends_s - self._clock()
        return None if lease is None or left_s <= 0 else (lease, left_s)

    def acquire(self, holder: str, lasts_s: float, *, take_over: bool = False) -> tuple[Lease, str | None]:
        """Return a new lease, and from whom it was taken over.

        Raises
        ------
        LeaseHeld
            Another holds it, and ``take_over`` is not asked for.
        """
        with self._lock:
            held = self.current()
            if held is not None and not take_over:
                raise LeaseHeld(*held)
            self._lease = Lease(secrets.token_urlsafe(16), holder, self._clock() + lasts_s)
            return self._lease, held[0].holder if held is not None else None

    def renew(self, lease_id: str, lasts_s: float) -> Lease:
        """Return the lease, lasting from now on; raises :class:`NoSuchLease`."""
        with self._lock:
            held = self._mine(lease_id)
            self._lease = Lease(held.id, held.holder, self._clock() + lasts_s)
            return self._lease

    def release(self, lease_id: str) -> Lease:
        """Give the lease back; raises :class:`NoSuchLease`."""
        with self._lock:
            held = self._mine(lease_id)
            self._lease = None
            return held

    def check(self, lease_id: str | None) -> None:
        """Raise :class:`LeaseHeld` when another holds the lease, :class:`NoSuchLease` for one that has run out."""
        held = self.current()
        if held is not None and not (lease_id is not None and secrets.compare_digest(held[0].id, lease_id)):
            raise LeaseHeld(*held)
        if held is None and lease_id is not None:
            raise NoSuchLease("this lease has run out or was taken over; acquire one again")

    def _mine(self, lease_id: str) -> Lease:
        held = self.current()
        if held is None or not secrets.compare_digest(held[0].id, lease_id):
            raise NoSuchLease("this lease has run out or was taken over")
        return held[0]
