"""Child processes of the demo: started with their output in a log, watched, and always ended."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self


class ProcessFailed(RuntimeError):
    """A child ended by itself; the text quotes its last words and names its log."""


class Processes:
    """Children that end with the block they are started in, whatever happens there.

    A plain ``kill`` of the parent (SIGTERM) ends them too; only SIGKILL cannot be helped.
    """

    def __init__(self) -> None:
        self._children: dict[str, tuple[subprocess.Popen[bytes], Path]] = {}
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        before = signal.signal(signal.SIGTERM, _leave)
        self._stack.callback(signal.signal, signal.SIGTERM, before)
        self._stack.callback(self.stop)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def start(self, name: str, arguments: Sequence[str], log: Path) -> None:
        """Start ``inertrim`` with these arguments under a name, its output going to a log file."""
        with log.open("wb") as sink:
            command = [sys.executable, "-m", "service.cli", *arguments]
            self._children[name] = (subprocess.Popen(command, stdout=sink, stderr=sink, stdin=subprocess.DEVNULL), log)

    def pids(self) -> list[int]:
        """Return the children's process ids, in the order of their start."""
        return [child.pid for child, _ in self._children.values()]

    def check(self) -> None:
        """Raise :class:`ProcessFailed` when a child has ended."""
        for name, (child, log) in self._children.items():
            code = child.poll()
            if code is not None:
                lines = log.read_text(errors="replace").strip().splitlines() or ["it said nothing"]
                raise ProcessFailed(f"the {name} ended with code {code}: {lines[-1]} (log: {log})")

    def stop(self) -> None:
        """Ask every child to end, wait, and insist where one does not."""
        for child, _ in reversed(self._children.values()):
            if child.poll() is None:
                child.terminate()
        for child, _ in self._children.values():
            try:
                child.wait(timeout=5)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
        self._children.clear()


def _leave(number: int, frame: object) -> None:
    del frame
    raise SystemExit(128 + number)


def free_port() -> int:
    """Return a TCP port on loopback that nothing listens on now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
