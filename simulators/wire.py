"""A line with the temper of a real one: it carries bytes at its bit rate and waits for nobody.

``Uart`` paces frames onto an end of a line. What the reader does not take in time is lost and counted, as a UART's
receiver overruns; the sender is never held up. Each loss is booked to the frame it hit, so that a test can demand
every other frame. ``Noise`` spoils frames on purpose before they are sent, and books that too.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import socket
import struct
import termios
import time
import tty
from collections import deque
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from drivers.framing import BITS_PER_BYTE
from simulators.device import Outgoing
from simulators.scenarios import NoisyLine

SETTLE_S = 0.05
"""Real time [s] for which a line just opened carries nothing yet: its reader is still setting it up and flushing it."""
DRAIN_S = 0.05
"""Real time [s] that a reader is given to take what has arrived before the line is pulled."""
MAX_TICK_S = 0.01
"""Real time [s] at most that one turn stands for: a sender that the host held up does not flood its reader's buffer."""
GARBAGE_BYTES = 40
RECENT_BYTES = 65536  # more than a pseudo-terminal or a socket holds for its reader


class Line(Protocol):
    """An end of a line. Nothing here blocks."""

    def plug(self) -> None:
        """Make the line appear."""

    def unplug(self) -> None:
        """Make it disappear."""

    def listening(self) -> bool:
        """Return whether somebody has opened the other end."""

    def settled(self) -> bool:
        """Return whether whoever opened it has had the time to set it up."""

    def unread(self) -> int:
        """Return how many bytes were carried but not read, after the reader has had the time to take them."""

    def write(self, data: bytes) -> int:
        """Return how many bytes were taken."""

    def read(self) -> bytes:
        """Return what has come, perhaps nothing."""

    def wait(self, seconds: float, also: int | None = None) -> None:
        """Sleep until something comes, here or on the file ``also``, or real seconds have passed."""


class PtyLine:
    """Pseudo-terminal whose other end is found under ``path``, a symbolic link.

    Unplugging closes it and removes the link; plugging in makes a new one.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._master = -1
        self._slave_name = ""
        self._opened_at = 0.0
        self._was_open = False

    def plug(self) -> None:
        """Make a new pseudo-terminal in raw mode and link to it."""
        master, slave = os.openpty()
        tty.setraw(slave)
        self._slave_name = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(master, False)
        self._master, self._was_open = master, False
        fresh = self.path.with_name(f".{self.path.name}.{os.getpid()}")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(self._slave_name)
        os.replace(fresh, self.path)

    def unplug(self) -> None:
        """Close the pseudo-terminal and remove the link."""
        if self._master < 0:
            return
        if self.path.is_symlink() and os.readlink(self.path) == self._slave_name:
            self.path.unlink()
        os.close(self._master)
        self._master = -1

    def listening(self) -> bool:
        """Return whether the other end has been open for long enough to be set up."""
        if self._master < 0:
            return False
        poll = select.poll()
        poll.register(self._master, 0)
        is_open = not any(events & select.POLLHUP for _, events in poll.poll(0))
        if is_open and not self._was_open:
            self._opened_at = time.monotonic()
        self._was_open = is_open
        return is_open

    def settled(self) -> bool:
        """Return whether whoever opened the line has had the time to set it up."""
        return time.monotonic() - self._opened_at >= SETTLE_S

    def write(self, data: bytes) -> int:
        """Return how many bytes the reader's buffer had room for."""
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0

    def read(self) -> bytes:
        """Return what has come."""
        if self._master < 0:
            return b""
        try:
            return os.read(self._master, 4096)
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno == errno.EIO:  # nobody has the other end open
                return b""
            raise

    def wait(self, seconds: float, also: int | None = None) -> None:
        """Sleep until something comes or the time is over."""
        files = [file for file in (also,) if file is not None]
        if self._was_open and self._master >= 0:
            files.append(self._master)
        select.select(files, [], [], seconds)

    def unread(self) -> int:
        """Return the bytes still in the reader's buffer after it has had the time to take them."""
        try:
            slave = os.open(self._slave_name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError:
            return 0
        deadline = time.monotonic() + DRAIN_S
        try:
            while (unread := _waiting(slave)) and time.monotonic() < deadline:
                time.sleep(0.001)
        finally:
            os.close(slave)
        return unread


def _waiting(file: int) -> int:
    """Return the number of bytes that wait to be read.

    The kernel hands on what was written in its own time, and counts only what it has handed on: asking whether a read
    would block makes it do so now.
    """
    select.select([file], [], [], 0)
    return int(struct.unpack("i", fcntl.ioctl(file, termios.FIONREAD, b"\0" * 4))[0])


class TcpLine:
    """A line for one client at a time over TCP, for ``socket://HOST:PORT``; port 0 takes a free one."""

    def __init__(self, port: int, host: str = "127.0.0.1") -> None:
        self.address = (host, port)
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None

    def plug(self) -> None:
        """Listen."""
        self._listener = socket.create_server(self.address)
        self._listener.setblocking(False)
        self.address = self._listener.getsockname()[:2]

    def unplug(self) -> None:
        """Drop the client and listen no more."""
        self._drop()
        if self._listener is not None:
            self._listener.close()
        self._listener = None

    def listening(self) -> bool:
        """Return whether a client is connected."""
        if self._client is None and self._listener is not None:
            with contextlib.suppress(BlockingIOError):
                self._client, _ = self._listener.accept()
                self._client.setblocking(False)
                self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 16384)
        return self._client is not None

    def settled(self) -> bool:
        """A connection needs no setting up."""
        return True

    def unread(self) -> int:
        """Return 0: what lies between here and a client cannot be known."""
        return 0

    def write(self, data: bytes) -> int:
        """Return how many bytes the connection had room for."""
        if self._client is None:
            return 0
        try:
            return self._client.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self._drop()
            return 0

    def read(self) -> bytes:
        """Return what has come."""
        if self._client is None:
            return b""
        try:
            data = self._client.recv(4096)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop()
        return data

    def wait(self, seconds: float, also: int | None = None) -> None:
        """Sleep until something comes or the time is over."""
        files = [file for file in (also, self._client, self._listener) if file is not None]
        select.select(files, [], [], seconds)

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client = None


@dataclass
class Ledger:
    """What was sent and what became of it, frame by frame.

    ``cycles[i]`` has, for the sensors' i-th switch-on, the spans ``sent`` of sequences that were put on the line and
    the sequences ``touched`` on the way with what touched them; all others arrived whole at whoever kept reading.
    Bytes are those written to the line, and those lost: ``overrun`` (the reader was too slow), ``unheard`` (nobody had
    opened the line), ``unplugged``, ``unread`` (line pulled or closed before the reader had taken them).
    """

    cycles: list[dict[str, Any]] = field(default_factory=list)
    frames_sent: int = 0
    frames_touched: int = 0
    messages_sent: int = 0
    messages_touched: int = 0
    bytes_sent: int = 0
    overrun_bytes: int = 0
    unheard_bytes: int = 0
    unplugged_bytes: int = 0
    unread_bytes: int = 0
    garbage_bytes: int = 0
    faults: list[dict[str, Any]] = field(default_factory=list)

    def offer(self, frame: Outgoing) -> None:
        """Book a frame that is put on the line."""
        if frame.sequence is None:
            self.messages_sent += 1
            return
        self.frames_sent += 1
        while len(self.cycles) <= frame.cycle:
            self.cycles.append({"sent": [], "touched": {}})
        sent = self.cycles[frame.cycle]["sent"]
        if sent and sent[-1][1] + 1 == frame.sequence:
            sent[-1][1] = frame.sequence
        else:
            sent.append([frame.sequence, frame.sequence])

    def touch(self, frame: Outgoing, how: str) -> None:
        """Book that a frame does not arrive as it was made."""
        if frame.sequence is None:
            self.messages_touched += 1
        elif frame.sequence not in self.cycles[frame.cycle]["touched"]:
            self.frames_touched += 1
            self.cycles[frame.cycle]["touched"][frame.sequence] = how

    def untouched(self, cycle: int) -> set[int]:
        """Return the sequences of a cycle that a reader must have received."""
        spans = self.cycles[cycle]["sent"] if cycle < len(self.cycles) else []
        sent = {sequence for low, high in spans for sequence in range(low, high + 1)}
        return sent - set(self.cycles[cycle]["touched"]) if sent else sent

    def as_json(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self)


class Piece:
    """Bytes on their way, and the frame they are of; None for bytes that are of none."""

    __slots__ = ("data", "frame")

    def __init__(self, data: bytes, frame: Outgoing | None) -> None:
        self.data, self.frame = data, frame


class Noise:
    """Spoils frames by the spans of noise that hold at their time; seeded."""

    def __init__(self, seed: int, ledger: Ledger) -> None:
        self._rng = np.random.default_rng(seed)
        self._ledger = ledger
        self.active: list[NoisyLine] = []

    def spoil(self, frame: Outgoing) -> list[Piece]:
        """Return what goes on the line for a frame."""
        self._ledger.offer(frame)
        pieces = [Piece(frame.data, frame)]
        for fault in self.active:
            if self._rng.random() < fault.probability:
                pieces = self._apply(fault.kind, frame, pieces)
        return pieces

    def _apply(self, kind: str, frame: Outgoing, pieces: list[Piece]) -> list[Piece]:
        rng, body = self._rng, pieces[-1]
        match kind:
            case "bit_flips":
                data = bytearray(body.data)
                bit = int(rng.integers(8 * len(data)))
                data[bit // 8] ^= 1 << bit % 8
                self._ledger.touch(frame, kind)
                return [*pieces[:-1], Piece(bytes(data), frame)]
            case "cuts":
                self._ledger.touch(frame, kind)
                return [*pieces[:-1], Piece(body.data[: int(rng.integers(1, len(body.data)))], frame)]
            case "garbage":
                extra = rng.bytes(int(rng.integers(1, GARBAGE_BYTES)))
            case _:  # false_headers: enough of a frame's head to promise the rest
                extra = frame.data[: len(frame.data) // 3]
        self._ledger.garbage_bytes += len(extra)
        return [Piece(extra, None), *pieces]


class Uart:
    """Puts pieces on a line at the bit rate of simulated time; what the reader does not take in time is lost."""

    def __init__(self, line: Line, bit_rate: int, speed: float, ledger: Ledger) -> None:
        self.line, self.ledger = line, ledger
        self.plugged = False
        self._bytes_per_s = bit_rate * speed / BITS_PER_BYTE
        self._queue: deque[Piece] = deque()
        self._recent: deque[Piece] = deque()
        self._recent_bytes = 0
        self._budget = 0.0
        self._turned_at = time.monotonic()
        self._heard = False

    @property
    def idle(self) -> bool:
        """Whether nothing waits to be sent."""
        return not self._queue

    def plug(self) -> None:
        """Make the line appear."""
        self.line.plug()
        self.plugged = True

    def unplug(self) -> None:
        """Make the line disappear."""
        if self.plugged:
            self._lose_unread()
            self.line.unplug()
        self.plugged, self._heard = False, False

    def close(self) -> None:
        """End it: what waits is never sent."""
        self.unplug()
        self._touch(self._queue, "unsent")
        self._queue.clear()

    def send(self, pieces: Iterable[Piece]) -> None:
        """Queue pieces."""
        self._queue.extend(pieces)

    def turn(self) -> None:
        """Send what the bit rate allows since the turn before."""
        now = time.monotonic()
        self._budget += min(now - self._turned_at, MAX_TICK_S) * self._bytes_per_s
        self._turned_at = now
        heard = self.plugged and self.line.listening()
        if self._heard and not heard:
            self._lose_unread()
        self._heard = heard
        if not self._queue or (heard and not self.line.settled()):
            self._budget = 0.0
            return
        pieces = self._take(int(self._budget))
        size = sum(len(piece.data) for piece in pieces)
        self._budget = self._budget - size if self._queue else 0.0
        if heard:
            self._write(pieces, size)
        elif self.plugged:
            self.ledger.unheard_bytes += size
            self._touch(pieces, "unheard")
        else:
            self.ledger.unplugged_bytes += size
            self._touch(pieces, "unplugged")

    def _take(self, count: int) -> list[Piece]:
        """Take bytes off the queue; a piece may be taken in parts."""
        taken = []
        while self._queue and count > 0:
            piece = self._queue.popleft()
            if len(piece.data) > count:
                self._queue.appendleft(Piece(piece.data[count:], piece.frame))
                piece = Piece(piece.data[:count], piece.frame)
            taken.append(piece)
            count -= len(piece.data)
        return taken

    def _write(self, pieces: list[Piece], size: int) -> None:
        written = self.line.write(b"".join(piece.data for piece in pieces))
        self.ledger.bytes_sent += written
        self.ledger.overrun_bytes += size - written
        if written < size:
            self._touch(_behind(pieces, written), "overrun")
        self._recent.extend(pieces)
        self._recent_bytes += size
        while self._recent_bytes - len(self._recent[0].data) > RECENT_BYTES:
            self._recent_bytes -= len(self._recent.popleft().data)

    def _touch(self, pieces: Iterable[Piece], how: str) -> None:
        for piece in pieces:
            if piece.frame is not None:
                self.ledger.touch(piece.frame, how)

    def _lose_unread(self) -> None:
        """Book what was carried but never read: the last bytes sent."""
        unread = self.line.unread()
        self.ledger.unread_bytes += unread
        while unread > 0 and self._recent:
            piece = self._recent.pop()
            unread -= len(piece.data)
            self._touch([piece], "unread")
        self._recent.clear()
        self._recent_bytes = 0


def _behind(pieces: list[Piece], count: int) -> list[Piece]:
    """Return the pieces of which a byte lies behind the first ``count``."""
    behind = []
    for piece in pieces:
        count -= len(piece.data)
        if count < 0:
            behind.append(piece)
    return behind
