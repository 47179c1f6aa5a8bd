"""One stream of events to many clients; a slow client loses its own oldest events and hurts nobody else."""

from __future__ import annotations

import asyncio
import json
import secrets
import threading
from collections import deque
from collections.abc import AsyncGenerator
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from typing import Any

QUEUE_EVENTS = 256
"""Events that may wait for a client, and that are kept for one that comes back."""
MOMENTARY = frozenset({"progress", "samples"})
"""Kinds of which the next one says all that the last one said: they are not kept."""
HEARTBEAT_S = 10.0


def text_of(facts: dict[str, Any]) -> str:
    """Return the facts of an event as they are sent."""
    return json.dumps(facts, separators=(",", ":"))


@dataclass(frozen=True)
class Event:
    """One event: a number that increases, 0 for one that is not kept, its kind, and its facts as JSON for all."""

    number: int
    kind: str
    text: str


class _Client:
    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self.waiting: deque[Event] = deque(maxlen=QUEUE_EVENTS)
        self.ready = asyncio.Event()
        self.dropped = 0

    def put(self, event: Event) -> None:
        """Runs in the client's loop."""
        self.dropped += len(self.waiting) == QUEUE_EVENTS
        self.waiting.append(event)
        self.ready.set()


def _put(clients: list[_Client], event: Event) -> None:
    for client in clients:
        client.put(event)


class EventHub:
    """Publishes from any thread; each subscriber reads in its own event loop.

    The last events are kept, so that a client that was cut off can go on where it was. Ids begin with a word of this
    process: those of another one mean nothing here.
    """

    def __init__(self) -> None:
        self._numbers = count(1)
        self._era = secrets.token_hex(4)
        self._kept: deque[Event] = deque(maxlen=QUEUE_EVENTS)
        self._clients: set[_Client] = set()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._clients)

    def id_of(self, event: Event) -> str | None:
        """Return the id by which a client can go on after an event; None for one that is not kept."""
        return f"{self._era}-{event.number}" if event.number else None

    def publish(self, kind: str, data: dict[str, Any]) -> None:
        """Give an event to every subscriber; never waits for one."""
        of_loop: dict[asyncio.AbstractEventLoop, list[_Client]] = {}
        text, kept = text_of(data), kind not in MOMENTARY
        with self._lock:
            for client in self._clients:
                of_loop.setdefault(client.loop, []).append(client)
            event = Event(next(self._numbers) if kept else 0, kind, text)
            if kept:
                self._kept.append(event)
        for loop, clients in of_loop.items():  # to wake a loop is a system call, and the line's reader is who pays it
            with suppress(RuntimeError):  # it has closed
                loop.call_soon_threadsafe(_put, clients, event)

    async def subscribe(self, heartbeat_s: float = HEARTBEAT_S, after: str | None = None) -> AsyncGenerator[Event]:
        """Yield events as they come, and a ``heartbeat`` (with how many were dropped) when none came for a while.

        Close it (``aclosing``) to be forgotten.

        Parameters
        ----------
        heartbeat_s
            Real seconds of silence before a heartbeat.
        after
            Id of the last event a client has seen: those since come first, as far as they are kept.
        """
        client = _Client(asyncio.get_running_loop())
        with self._lock:
            for event in self._since(after):
                client.put(event)
            self._clients.add(client)
        try:
            while True:
                try:
                    await asyncio.wait_for(client.ready.wait(), heartbeat_s)
                except TimeoutError:
                    yield Event(0, "heartbeat", text_of({"dropped": client.dropped}))
                client.ready.clear()
                while client.waiting:
                    yield client.waiting.popleft()
        finally:
            with self._lock:
                self._clients.discard(client)

    def _since(self, after: str | None) -> list[Event]:
        era, _, number = (after or "").rpartition("-")
        if era != self._era or not number.isdigit():
            return []
        return [event for event in self._kept if event.number > int(number)]
