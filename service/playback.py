"""Plays what a line once said onto a pseudo-terminal, at its own pace or another, as a block would say it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from drivers.capture import RecordKind, read_capture
from drivers.framing import BITS_PER_BYTE
from drivers.protocols.base import Protocol
from drivers.sources import SourceKind, bare_bytes, read_source, source_kind
from simulators.wire import PtyLine

LOOK_S = 0.002
"""Real seconds between looks for a reader, for room, and for what is due."""
PIECE_S = 0.005
"""Bare bytes are played in pieces as long as this [simulated s]."""


def play(file: Path, protocol: Protocol, path: Path, *, speed: float = 1.0, bit_rate: float = 921600) -> int:
    """Play a file from when somebody opens ``path`` until it is over, and return how many bytes were played.

    No byte is lost to a slow reader: while the line is full the player waits, and goes on late. What comes while
    nobody has the line open is lost, as it would be.

    Raises
    ------
    CaptureError
        The file cannot be read.
    """
    line, count = PtyLine(path), 0
    line.plug()
    try:
        while not (line.listening() and line.settled()):
            time.sleep(LOOK_S)
        zero = None
        for due_s, data in _timed(file, protocol, bit_rate):
            zero = time.monotonic() - due_s / speed if zero is None else zero
            time.sleep(max(0.0, zero + due_s / speed - time.monotonic()))
            while data and line.listening():
                written = line.write(data)
                count, data = count + written, data[written:]
                if data:
                    time.sleep(LOOK_S)
        while line.listening() and line.unread():
            time.sleep(LOOK_S)
    finally:
        line.unplug()
    return count


def _timed(file: Path, protocol: Protocol, bit_rate: float) -> Iterator[tuple[float, bytes]]:
    """Yield what was received, each with the time [s] at which it is due."""
    kind = source_kind(file)
    if kind is SourceKind.CAPTURE:
        for record in read_capture(file):
            if record.kind is RecordKind.RECEIVED:
                yield record.host_time_s, record.data
        return
    data = b"".join(bare_bytes(file, kind))
    byte_s = _byte_s(file, protocol, len(data)) or BITS_PER_BYTE / bit_rate
    size = max(1, round(PIECE_S / byte_s))
    for start in range(0, len(data), size):
        yield min(start + size, len(data)) * byte_s, data[start : start + size]


def _byte_s(file: Path, protocol: Protocol, size: int) -> float | None:
    """Return how long a byte of a bare file took on average [s], by the time that its samples tell."""
    elapsed_s, steps, frames = 0.0, 0, 0
    for batch in read_source(file, protocol):
        times_s = batch.samples["time"]
        frames += len(times_s)
        if len(times_s) > 1 and not batch.restarts:
            elapsed_s, steps = elapsed_s + float(times_s[-1] - times_s[0]), steps + len(times_s) - 1
    return elapsed_s / steps * frames / size if steps and elapsed_s > 0 else None
