"""A process beside the service's that does its long work: what runs there holds neither interpreter nor processor here.

A piece of work is a function and its arguments. They go over as a pickle with their arrays beside it, which are neither
copied nor looked at on this side. The process keeps nothing from one piece to the next, so that another one can take
its place: one that dies at work is started anew and given the same piece once more.
"""

from __future__ import annotations

import multiprocessing
import pickle
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, Literal, ParamSpec, TypeVar, cast

import structlog

from service.subordinate import subordinate

log = structlog.get_logger()

TRIES = 2
"""How often a piece of work may begin."""
NICENESS = 5
"""Reading the line goes before; but an operator waits for this work, also on a host that is busy with other things."""

Parameters = ParamSpec("Parameters")
Returned = TypeVar("Returned")


class WorkRefused(ValueError):
    """The work cannot be done with what it was given or where it writes; the text is that of its own error."""


class WorkFailed(RuntimeError):
    """The work met a fault of the program; the text is the traceback of where it was done."""


class ProcessDied(RuntimeError):
    """The process died, and at the second try once more."""


class SideProcess:
    """One process for work that takes long. :meth:`call` is for one thread, the rest for any.

    Parameters
    ----------
    prepare
        First work of every process, done while nobody waits for it: to import, compile and configure. Like all work, a
        function of a module or a ``functools.partial`` of one.
    """

    def __init__(self, prepare: Callable[[], None]) -> None:
        self._prepare = prepare
        self._lock = threading.Lock()
        self._life: _Life | None = None
        self._stopped = False

    def start(self) -> None:
        """Start the process and have it prepare; does not wait for it."""
        with self._lock:
            if self._stopped:
                raise ProcessDied("the service is ending")
            if self._life is None or self._life.over:
                self._life = _Life(self._prepare)

    def stop(self) -> None:
        """End the process at once, at work or not. It writes files whole or not at all."""
        with self._lock:
            self._stopped = True
            if self._life is not None:
                self._life.kill()

    def call(
        self, function: Callable[Parameters, Returned], *arguments: Parameters.args, **named: Parameters.kwargs
    ) -> Returned:
        """Have a piece of work done and return what it returned.

        Raises
        ------
        WorkRefused
            It raised a ``ValueError`` or an ``OSError``.
        WorkFailed
            It raised anything else.
        ProcessDied
            The process did not live to return anything, and neither did the one after it.
        """
        for _ in range(TRIES):
            self.start()
            assert self._life is not None
            try:
                return cast("Returned", self._life.ask(function, arguments, named))
            except (EOFError, OSError):
                how = self._life.bury()
                log.error("side process", work=function.__name__, died=how)
        raise ProcessDied(f"the process for it died each time, at last {how}. Has the machine too little memory?")


class _Life:
    """One process from its start to its end."""

    def __init__(self, prepare: Callable[[], None]) -> None:
        self._channel, theirs = multiprocessing.Pipe()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "service.side_process", str(theirs.fileno())],
                stdin=subprocess.PIPE,
                pass_fds=(theirs.fileno(),),
            )
        self._prepared = False
        _send(self._channel, (prepare, (), {}))

    @property
    def over(self) -> bool:
        """Whether it has ended."""
        return self._process.poll() is not None

    def ask(self, *work: object) -> object:
        """Return what a piece of work returned; ``EOFError`` or ``OSError`` where the process dies meanwhile."""
        if not self._prepared:
            self._prepared = True
            try:
                self._answer()
            except (WorkRefused, WorkFailed) as error:  # the work may be possible all the same
                log.error("side process", work="prepare", error=str(error))
        _send(self._channel, work)
        return self._answer()

    def _answer(self) -> object:
        kind, what = _receive(self._channel)
        if kind == "refused":
            raise WorkRefused(what)
        if kind == "failed":
            raise WorkFailed(what)
        return what

    def kill(self) -> int:
        """End it where it has not ended, and return its exit code. Whoever waits for an answer learns of it."""
        self._process.kill()
        return self._process.wait()

    def bury(self) -> str:
        """Let go of all that is left of it, and return how it died."""
        code = self.kill()
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._channel.close()
        return f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"


def _send(channel: Connection[Any, Any], what: object) -> None:
    """Send an object, its arrays as the bytes they are."""
    beside: list[pickle.PickleBuffer] = []
    text = pickle.dumps(what, pickle.HIGHEST_PROTOCOL, buffer_callback=beside.append)
    channel.send((text, len(beside)))
    for buffer in beside:
        channel.send_bytes(buffer.raw())


def _receive(channel: Connection[Any, Any]) -> Any:
    """Return what :func:`_send` sent; arrays cannot be written to. ``EOFError`` when the other end is gone."""
    text, count = channel.recv()
    return pickle.loads(text, buffers=[channel.recv_bytes() for _ in range(count)])


_Answer = tuple[Literal["returned", "refused", "failed"], object]


def _done(function: Callable[..., object], arguments: tuple[object, ...], named: dict[str, object]) -> _Answer:
    try:
        return "returned", function(*arguments, **named)
    except (ValueError, OSError) as error:
        return "refused", str(error)
    except Exception:
        return "failed", traceback.format_exc()


def main(descriptor: int) -> None:
    """Do what comes over a socket until it is closed."""
    subordinate(NICENESS)
    with Connection(descriptor) as channel, suppress(EOFError):
        while True:
            _send(channel, _done(*_receive(channel)))


if __name__ == "__main__":
    main(int(sys.argv[1]))
