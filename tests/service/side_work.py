"""Work for test_side_process, found there by the name of this module."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np

from drivers.samples import SampleArray

prepared: list[str] = []


def prepare(word: str) -> None:
    prepared.append(word)


def about_process() -> dict[str, Any]:
    return {"pid": os.getpid(), "niceness": os.getpriority(os.PRIO_PROCESS, 0), "prepared": prepared}


def about_samples(samples: SampleArray) -> tuple[int, float, bool, np.ndarray]:
    return len(samples), float(samples["time"].sum()), samples.flags.writeable, samples[-2:].copy()


def refuse() -> None:
    raise OSError("the disk takes nothing")


def fail() -> None:
    raise ZeroDivisionError("nobody thought of this")


def die(note: Path, times: int) -> str:
    """Be killed at work, as often as that, then be done."""
    begun = len(note.read_text()) if note.exists() else 0
    note.write_text("x" * (begun + 1))
    if begun < times:
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


def stay_busy(note: Path) -> None:
    """Say who works, and hold the interpreter."""
    note.write_text(str(os.getpid()))
    end_s = time.monotonic() + 300.0
    while time.monotonic() < end_s:
        sum(range(10_000))
