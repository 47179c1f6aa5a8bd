"""A serial line to a block, over any pyserial URL: opened, read, lost, opened again, and never shown better than it is.

One thread reads and does nothing else: bytes go to the raw capture and into one bounded queue. Splitting and decoding
happen in the caller's :meth:`SerialLink.read`.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from enum import StrEnum
from typing import Any

import serial

from drivers.capture import CaptureWriter, RecordKind, describe_line
from drivers.clock import ClockFit, HostClock
from drivers.counters import Counters
from drivers.messages import Received
from drivers.protocols.base import Protocol
from drivers.stream import Batch, StreamDecoder
from drivers.timebase import Timebase

READ_SIZE = 65536
FULL_READ = 4095
"""A read of fewer bytes has drained the line."""
IDLE_S = 0.02
"""How often [real s] an idle line is looked at for having been replaced."""
WRITE_TIMEOUT_S = 1.0
"""How long [real s] the line may refuse bytes to be sent."""
BATCH_S = 0.04
"""No batch follows another sooner than this [real s]: a batch costs about as much with a hundred samples as with one,
arrivals are stamped before they wait here, and nobody above looks more often than twenty times a second."""
BACK_OFF_S = (0.1, 2.0)
"""First and longest pause [simulated s] between attempts to open; each is twice the one before."""
SHORTEST_PAUSE_S = 0.005
"""No pause is shorter than this [real s], however fast simulated time runs."""


class LinkState(StrEnum):
    """What can be said of a line now."""

    DISCONNECTED = "DISCONNECTED"
    OPENING = "OPENING"
    SYNCING = "SYNCING"
    STREAMING = "STREAMING"
    STALE = "STALE"


class LinkError(RuntimeError):
    """The line cannot do what was asked: which, why, and what to do."""


class SerialLink:
    """Reads one block.

    Parameters
    ----------
    url : device path, symbolic link to one, or any other pyserial URL (``socket://host:port``, ``loop://`` …).
    protocol : what the block speaks.
    bit_rate : of the line [bit/s].
    timebase : whose seconds all limits are in; default real time.
    stale_after_s : age of the newest sample [simulated s] beyond which the line is STALE (see ``Timebase.limit_s``).
    capture : where raw bytes go before anything is done with them.
    queue_bytes : how much may wait for :meth:`read`; beyond it the oldest chunks are dropped and counted.

    Raises
    ------
    LinkError
        The URL is of no kind that pyserial knows.

    Notes
    -----
    States: DISCONNECTED (not there, or waiting to try again; ``reason`` says why), OPENING, SYNCING (open, no sample
    since), STREAMING, STALE (open, newest sample too old). Without calls of :meth:`read` nothing is decoded, and the
    line ages.
    """

    def __init__(
        self,
        url: str,
        protocol: Protocol,
        *,
        bit_rate: int = 921600,
        timebase: Timebase | None = None,
        stale_after_s: float = 0.5,
        capture: CaptureWriter | None = None,
        queue_bytes: int = 2**22,
    ) -> None:
        self.url, self.protocol, self.bit_rate = url, protocol, bit_rate
        self.timebase = timebase or Timebase()
        self.counters = Counters()
        self.reason = "not started"
        self.on_message: list[Callable[[Received], None]] = []
        self._capture = capture
        self._stale_after_s = self.timebase.limit_s(stale_after_s)
        self._queue_bytes = queue_bytes
        self._queue: deque[tuple[float, bytes | None]] = deque()  # None: the line was opened
        self._queued_bytes = 0
        self._arrived = threading.Condition()
        self._decoder = StreamDecoder(protocol, bit_rate, self.timebase.limit_s(0.1, 0.1), self.counters)
        self._decoding = threading.Lock()
        self._clock = HostClock()
        self._clock_use = threading.Lock()
        self._next_batch = 0.0
        self._newest_s: float | None = None
        self._line = LinkState.DISCONNECTED  # as the reading thread sees it; SYNCING stands for open
        self._opened_s = float("inf")
        self._port: Any = None
        self._port_use = threading.Lock()  # held to write and to close, so that nothing is written to a closed port
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self._wake: tuple[int, int] | None = None
        try:
            serial.serial_for_url(url, do_not_open=True)
        except ValueError as error:
            raise LinkError(
                f"{url}: {error}. Give a device path or a pyserial URL such as socket://host:port."
            ) from None

    def prepare(self) -> None:
        """Make compiled code ready, to keep up with fast lines; takes seconds where it never was compiled."""
        self._decoder.prepare()

    def start(self) -> None:
        """Begin to open and read; starting twice does no harm."""
        if self._thread is None:
            self._stopping.clear()
            self._wake = os.pipe()
            self._thread = threading.Thread(target=self._run, name=f"link {self.url}", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Close the line and end the thread; stopping twice does no harm."""
        thread, self._thread = self._thread, None
        if thread is None or self._wake is None:
            return
        self._stopping.set()
        os.write(self._wake[1], b"\0")
        with self._arrived:
            self._arrived.notify_all()
        thread.join(timeout=10)
        for end in self._wake:
            os.close(end)
        self._wake = None
        self.reason = "stopped"

    def __enter__(self) -> SerialLink:
        """Start."""
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop."""
        self.stop()

    @property
    def state(self) -> LinkState:
        """What can be said of the line now."""
        if self._line is not LinkState.SYNCING:
            return self._line
        newest_s = self._newest_s
        if newest_s is None or newest_s < self._opened_s:
            return LinkState.SYNCING
        return LinkState.STREAMING if self.age_s() <= self._stale_after_s else LinkState.STALE

    @property
    def queued(self) -> int:
        """Chunks of bytes that wait for :meth:`read`."""
        return len(self._queue)

    def age_s(self) -> float:
        """Return how long ago [simulated s] the newest sample came; infinite when none ever did."""
        return float("inf") if self._newest_s is None else max(0.0, self.timebase.now_s() - self._newest_s)

    def clock(self) -> ClockFit | None:
        """Return how the block's clock stands to simulated time, with σ; None until there is enough to say."""
        with self._clock_use:
            return self._clock.fit()

    def wrong_rate(self) -> float | None:
        """Return by what fraction samples come slower than stated, where that is a named condition; else None."""
        check = self._decoder.rate_check
        return check.discrepancy if check.condition else None

    def read(self, timeout_s_real: float = 0.1) -> Batch | None:
        """Decode what has come; wait up to ``timeout_s_real`` [real s] for something, and return None without.

        Calls :attr:`on_message` for every message, in the caller's thread.
        """
        deadline = time.monotonic() + timeout_s_real
        with self._decoding:
            while True:
                time.sleep(max(0.0, min(self._next_batch, deadline) - time.monotonic()))
                remaining = deadline - time.monotonic()
                self._feed(self._take_queued(remaining))
                self._next_batch = time.monotonic() + BATCH_S
                batch = self._decoder.take(self.timebase.now_s())
                if len(batch.samples):
                    self._newest_s = float(batch.host_time_s[-1])
                    with self._clock_use:
                        batch.follow_clock(self._clock)
                if batch or remaining <= 0 or self._stopping.is_set():
                    break
        for received in batch.messages:
            for listener in self.on_message:
                listener(received)
        return batch or None

    def _feed(self, taken: list[tuple[float, bytes | None]]) -> None:
        """Hand on what was queued: runs of chunks, and between them that the line was opened."""
        chunks: list[tuple[float, bytes]] = []
        for host_time_s, data in taken:
            if data is not None:
                chunks.append((host_time_s, data))
                continue
            self._decoder.feed_chunks(chunks)
            self._decoder.opened(host_time_s)
            chunks = []
        self._decoder.feed_chunks(chunks)

    def send(self, data: bytes) -> None:
        """Send bytes to the block.

        Raises
        ------
        LinkError
            The line is not open, or does not take them.
        """
        with self._port_use:
            if self._port is None:
                raise LinkError(f"{self.url}: cannot send, the line is {self._line}: {self.reason}. Connect the block.")
            self._tee(data, self.timebase.now_s(), RecordKind.SENT)
            try:
                self._port.write(data)
            except (OSError, TypeError) as error:  # pyserial's own errors are OSErrors
                raise LinkError(f"{self.url}: cannot send: {error}. Check the line to the block.") from None

    def _take_queued(self, timeout_s: float) -> list[tuple[float, bytes | None]]:
        """Return all that waits, when nothing does after waiting for it."""
        with self._arrived:
            if not self._queue and timeout_s > 0 and not self._stopping.is_set():
                self._arrived.wait(timeout_s)
            taken = list(self._queue)
            self._queue.clear()
            self._queued_bytes = 0
        return taken

    def _put(self, host_time_s: float, data: bytes | None) -> None:
        """Queue a chunk, dropping the oldest ones where there is no room."""
        with self._arrived:
            self._queue.append((host_time_s, data))
            self._queued_bytes += len(data or b"")
            while self._queued_bytes > self._queue_bytes and len(self._queue) > 1:
                dropped = len(self._queue.popleft()[1] or b"")
                self._queued_bytes -= dropped
                self.counters.queue_drops += bool(dropped)
                self.counters.bytes_dropped += dropped
            self._arrived.notify()

    def _tee(self, data: bytes, host_time_s: float, kind: RecordKind) -> None:
        """Write to the raw capture; a disk that fails costs the capture, never the line."""
        if self._capture is not None:
            try:
                self._capture.write(data, host_time_s, kind)
            except OSError:
                self.counters.capture_failures += 1
                self._capture = None

    def _run(self) -> None:
        """Open, read until the line is lost, and again, until stopped."""
        first_s, longest_s = BACK_OFF_S
        pause_s = first_s
        while not self._stopping.is_set():
            if self._open():
                pause_s = first_s
                self._read_until_lost()
                self._close()
            self._stopping.wait(max(self.timebase.real_s(pause_s), SHORTEST_PAUSE_S))
            pause_s = min(2 * pause_s, longest_s)
        self._line = LinkState.DISCONNECTED

    def _open(self) -> bool:
        """Try to open the port."""
        self._line = LinkState.OPENING
        try:
            port = serial.serial_for_url(
                self.url, self.bit_rate, timeout=IDLE_S, write_timeout=WRITE_TIMEOUT_S, exclusive=True
            )
            if self.url.startswith("socket://"):
                _keep_alive(port)
        except Exception as error:  # pyserial lets termios.error and others through, and this thread must not die
            self.counters.open_failures += 1
            self.reason = str(error)
            self._line = LinkState.DISCONNECTED
            return False
        self.counters.openings += 1
        self._opened_s = self.timebase.now_s()
        about = describe_line(url=self.url, protocol=self.protocol.name, bit_rate=self.bit_rate)
        self._tee(about, self._opened_s, RecordKind.OPENED)
        self._put(self._opened_s, None)
        with self._port_use:
            self._port = port
        self.reason = ""
        self._line = LinkState.SYNCING
        with contextlib.suppress(LinkError):  # one that cannot be asked may yet be heard
            for request in self.protocol.requests:
                self.send(request)
        return True

    def _close(self) -> None:
        """Let go of the port."""
        with self._port_use:
            port, self._port = self._port, None
            with contextlib.suppress(Exception):  # it is lost already: nothing that closing says matters
                port.close()
        self._line = LinkState.DISCONNECTED

    def _read_until_lost(self) -> None:
        """Move bytes from the port to capture and queue until there is no port any more."""
        try:
            receive = self._receiver()
            while not self._stopping.is_set():
                data = receive()
                if data:
                    host_time_s = self.timebase.now_s()
                    self._tee(data, host_time_s, RecordKind.RECEIVED)
                    self._put(host_time_s, data)
        except Exception as error:  # whatever it was, the line is lost and this thread must not die
            self.counters.disconnections += 1
            self.reason = str(error) or type(error).__name__

    def _receiver(self) -> Callable[[], bytes]:
        """Return a function that waits a little for bytes and returns what there is."""
        port = self._port
        try:
            descriptor = port.fileno()
        except (AttributeError, OSError):  # no descriptor behind this URL (loop://, rfc2217://): as pyserial can
            return lambda: bytes(port.read(max(1, port.in_waiting)))
        assert self._wake is not None
        poll = select.poll()
        poll.register(descriptor, select.POLLIN)
        poll.register(self._wake[0], select.POLLIN)

        def receive() -> bytes:
            ready = dict(poll.poll(IDLE_S * 1e3))
            if descriptor not in ready:
                self._check_not_replaced(descriptor)
                return b""
            data = _read_all(descriptor)
            if data is None:
                raise ConnectionResetError("the other end closed the line")
            return data

        return receive

    def _check_not_replaced(self, descriptor: int) -> None:
        """Raise when the path that was opened is gone or leads elsewhere: the device was plugged in anew."""
        if "://" not in self.url:
            now, opened = os.stat(self.url), os.fstat(descriptor)
            if (now.st_ino, now.st_rdev) != (opened.st_ino, opened.st_rdev):
                raise ConnectionResetError("the path leads to another device now")


def _read_all(descriptor: int) -> bytes | None:
    """Return all that a ready descriptor holds, None where the other end is gone.

    A terminal gives 4095 bytes at a time. Asking again at once, and not after another poll, halves how often this
    thread must get the interpreter back from a busy one.
    """
    data = bytearray()
    try:
        while len(data) < READ_SIZE:
            piece = os.read(descriptor, READ_SIZE)
            data += piece
            if len(piece) < FULL_READ:
                return bytes(data) if data else None
    except BlockingIOError:  # drained, or ready only in name
        pass
    except OSError:
        if not data:  # else the loss shows at the next read
            raise
    return bytes(data)


def _keep_alive(port: Any) -> None:
    """Let a network line notice within seconds that its other end has gone without a word."""
    with socket.socket(fileno=os.dup(port.fileno())) as line:
        line.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 2)
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 1)
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3)
