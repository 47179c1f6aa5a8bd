"""Tells systemd how the service is, over the socket that it names (``Type=notify``, ``WatchdogSec=``).

The protocol is one datagram of ``KEY=value`` lines (sd_notify(3)), so the standard library does: the small packages
that wrap it have no more in them than this and are kept by nobody, and libsystemd's binding needs a compiler.
"""

from __future__ import annotations

import os
import socket
import time
from contextlib import suppress

BEATS_IN_TIME = 4
"""Signs of life sent within the time that systemd allows for one."""


class Notifier:
    """Sends to ``NOTIFY_SOCKET``; without one, to nobody. Safe from any thread; never waits."""

    def __init__(self) -> None:
        path = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + path[1:] if path.startswith("@") else path
        self._socket: socket.socket | None = None
        if path:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)
        allowed_s = int(os.environ.get("WATCHDOG_USEC", "0")) * 1e-6
        self._every_s = allowed_s / BEATS_IN_TIME
        self._beaten_s = 0.0

    def ready(self) -> None:
        """Say that the service serves."""
        self._send("READY=1")

    def stopping(self) -> None:
        """Say that it is ending."""
        self._send("STOPPING=1")

    def beat(self) -> None:
        """Say that whoever calls this is alive; call it as often as you like."""
        now_s = time.monotonic()
        if self._every_s and now_s - self._beaten_s >= self._every_s:
            self._beaten_s = now_s
            self._send("WATCHDOG=1")

    def _send(self, text: str) -> None:
        if self._socket is not None:
            with suppress(OSError):  # systemd is busy or gone: it will see for itself
                self._socket.sendto(text.encode(), self._address)
