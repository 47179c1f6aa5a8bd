"""A thread that does one piece of work after the other, in the order they came."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

Piece = TypeVar("Piece")


class Lane(Generic[Piece]):
    """One queue and the thread that empties it.

    Parameters
    ----------
    name
        Of the thread.
    do
        Does a piece of work; must not raise.
    """

    def __init__(self, name: str, do: Callable[[Piece], None]) -> None:
        self._do = do
        self._pieces: queue.SimpleQueue[Piece | None] = queue.SimpleQueue()
        self._begun_s: float | None = None
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)

    def start(self) -> None:
        """Begin to work."""
        self._thread.start()

    def submit(self, piece: Piece) -> None:
        """Queue a piece of work; never waits."""
        self._pieces.put(piece)

    def finish(self) -> None:
        """Take no more; what is queued is still done."""
        self._pieces.put(None)

    def join(self, timeout_s: float) -> None:
        """Wait up to so many real seconds until the last piece is done."""
        self._thread.join(timeout_s)

    @property
    def waiting(self) -> int:
        """How many pieces wait."""
        return self._pieces.qsize()

    @property
    def busy_s(self) -> float:
        """How long [real s] the piece in hand has taken so far, 0 without one."""
        begun_s = self._begun_s
        return time.monotonic() - begun_s if begun_s is not None else 0.0

    def _work(self) -> None:
        while (piece := self._pieces.get()) is not None:
            self._begun_s = time.monotonic()
            self._do(piece)
            self._begun_s = None
