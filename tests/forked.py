"""``inertrim`` in processes of its own, forked from one that has imported it: seconds are spared with every start.

How it starts when it is installed, by its own console script and from the wheel, is for test_deploy and test_cli.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from multiprocessing import reduction
from pathlib import Path
from typing import IO

FORKSERVER = multiprocessing.get_context("forkserver")
FORKSERVER.set_forkserver_preload(["service.cli", "service.main"])


class _Stream:
    """A file descriptor that is handed on with a process's arguments."""

    def __init__(self, fileno: int) -> None:
        self.fileno = fileno

    def __reduce__(self) -> tuple[type[_Received], tuple[object]]:
        return _Received, (reduction.DupFd(self.fileno),)


class _Received:
    """The descriptor on the other side."""

    def __init__(self, handed: object) -> None:
        self.fileno = int(handed.detach())  # type: ignore[attr-defined]


class Program:
    """``inertrim`` running with these arguments, held as :class:`subprocess.Popen` holds a process.

    It is killed by the kernel when the test run that started it is.
    """

    def __init__(
        self,
        *arguments: str | Path,
        folder: Path | None = None,
        variables: Mapping[str, str] | None = None,
        stdin: IO[bytes] | int | None = None,
        stdout: IO[bytes] | int | None = None,
        stderr: IO[bytes] | int | None = None,
    ) -> None:
        held = (stdin, stdout, stderr)
        streams = [None if one is None else _Stream(one if isinstance(one, int) else one.fileno()) for one in held]
        words = ["inertrim", *map(str, arguments)]
        self._process = FORKSERVER.Process(target=_become, args=(words, folder, dict(variables or {}), streams))
        self._process.start()

    @property
    def pid(self) -> int:
        assert self._process.pid is not None
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        return self._process.exitcode

    def poll(self) -> int | None:
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        self._process.join(timeout)
        if self.returncode is None:
            raise subprocess.TimeoutExpired("inertrim", timeout or 0.0)
        return self.returncode

    def send_signal(self, number: int) -> None:
        if self.returncode is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


def inertrim(*arguments: str | Path, folder: Path | None = None, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run ``inertrim`` to its end, as a user does, and return what it said and its exit code."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        program = Program(*arguments, folder=folder, variables=variables, stdout=out, stderr=err)
        try:
            code = program.wait(120)
        finally:
            program.kill()
        said = [(stream.seek(0), stream.read().decode())[1] for stream in (out, err)]
    return subprocess.CompletedProcess(["inertrim", *map(str, arguments)], code, *said)


def _die_with_parent() -> None:
    """Have the kernel end this process when the one that started it is killed (prctl PR_SET_PDEATHSIG)."""
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)


def _become(words: list[str], folder: Path | None, variables: dict[str, str], streams: list[_Received | None]) -> None:
    """Be ``inertrim`` from here on: its own streams, folder and words."""
    _die_with_parent()
    if streams[0] is None:
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for number, stream in enumerate(streams):
        if stream is not None:
            os.dup2(stream.fileno, number)
    sys.stdin, sys.stdout, sys.stderr = open(0), open(1, "w"), open(2, "w")  # noqa: SIM115
    if folder is not None:
        os.chdir(folder)
    os.environ.update(variables)
    sys.argv = words
    from service.cli import main

    main()
