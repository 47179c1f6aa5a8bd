"""The one resynchronising splitter: bytes to whole frames, whatever the protocol.

No good frame is lost that follows a bad one: header and length are judged before anything is waited for, a wrong
checksum costs one byte and no more, and a header whose frame does not come is passed over when its time is up.
"""

from __future__ import annotations

import re
from collections import deque
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.counters import Counters
from drivers.protocols.base import NEED_MORE, NOT_A_FRAME, Frame, FrameRun, Protocol

if TYPE_CHECKING:
    from drivers.scan import Chunks, Scanner, ScanState

BITS_PER_BYTE = 10
"""Start bit, eight data bits, stop bit."""


@cache
def sync_finder(sync: tuple[bytes, ...]) -> re.Pattern[bytes]:
    """Return the expression that finds any of the patterns that a frame may begin with."""
    return re.compile(b"|".join(map(re.escape, sync)), re.DOTALL)


class _Chunk(NamedTuple):
    """Where a chunk ends in the stream, when it was read, and when the one before it was read."""

    end: int
    host_time_s: float
    earlier_s: float


class Splitter:
    """Finds whole frames in a stream of bytes.

    Parameters
    ----------
    protocol : tells frames from anything else.
    bit_rate : of the line [bit/s of simulated time]; dates bytes inside a chunk and bounds the wait for a frame.
    latency_s : how late the host may hand bytes on [simulated s].
    counters : where losses are counted.

    Notes
    -----
    Memory is bounded by the longest legal frame and one chunk. A header whose frame has not come after twice the
    time that its bytes take on the line, and ``latency_s``, is looked past, once in each such time: whole frames
    behind it prove it false. When there are none it is kept, so that a pause of line or host inside a good frame
    loses nothing.
    """

    def __init__(
        self, protocol: Protocol, bit_rate: float = 921600, latency_s: float = 0.1, counters: Counters | None = None
    ) -> None:
        self.counters = counters if counters is not None else Counters()
        self._protocol = protocol
        self._byte_s = BITS_PER_BYTE / bit_rate
        self._latency_s = latency_s
        self._find = sync_finder(protocol.sync).search
        self._sync_tail = max(map(len, protocol.sync)) - 1
        self._buffer = bytearray()
        self._base = 0  # place of the buffer's first byte in the stream
        self._chunks: deque[_Chunk] = deque()
        self._read_s = float("-inf")
        self._waiting = -1  # place in the stream of the header that is waited for
        self._limit_s = 0.0
        self._deadline_s = float("inf")
        self._in_step = True  # no byte discarded since the last frame
        self._scanner: Scanner | None = None

    @property
    def pending(self) -> int:
        """Number of bytes that wait for more."""
        return len(self._buffer)

    def feed(self, data: bytes, host_time_s: float) -> list[Frame]:
        """Take the next bytes, whose last one came at ``host_time_s`` [simulated s]; return the frames made whole."""
        if data:
            self.counters.bytes_in += len(data)
            self._buffer += data
            self._chunks.append(_Chunk(self._base + len(self._buffer), host_time_s, self._read_s))
            self._read_s = host_time_s
        frames = self._scan()
        return frames + self.expire(host_time_s)

    def feed_stretch(
        self, data: NDArray[np.uint8], ends: NDArray[np.int64], times_s: NDArray[np.float64]
    ) -> FrameRun | list[Frame]:
        """Take many chunks at once; the same as :meth:`feed` with each, in compiled code where the protocol allows.

        Parameters
        ----------
        data : the bytes of all chunks.
        ends : (n,) where each chunk ends in ``data``.
        times_s : (n,) when the last byte of each came [simulated s].
        """
        self.prepare()
        if self._scanner is None or not len(ends):
            starts = [0, *ends.tolist()]
            pieces = zip(starts, ends.tolist(), times_s.tolist(), strict=False)
            return [frame for start, end, time_s in pieces for frame in self.feed(data[start:end].tobytes(), time_s)]
        return self._scan_stretch(self._scanner, data, ends, times_s)

    @property
    def is_compiled(self) -> bool:
        """Whether compiled code is ready for this protocol."""
        return self._scanner is not None

    def prepare(self) -> None:
        """Make compiled code ready, where the protocol's frames can be told by a table."""
        if self._scanner is None and (layout := self._protocol.layout()) is not None:
            from drivers.scan import scanner_of  # not everyone who splits needs compiled code, or waits for it

            self._scanner = scanner_of(layout)

    def _scan_stretch(
        self, scanner: Scanner, data: NDArray[np.uint8], ends: NDArray[np.int64], times_s: NDArray[np.float64]
    ) -> FrameRun:
        """Set the compiled splitter on what waits and what is new, and go on from where it ends."""
        from drivers.scan import Chunks, Line, ScanState

        waiting = len(self._buffer)
        whole = np.concatenate([np.frombuffer(self._buffer, np.uint8), data]) if waiting else data
        before = np.empty(len(ends))
        before[0], before[1:] = self._read_s, times_s[:-1]
        if ends[0] == 0 or np.any(ends[1:] == ends[:-1]):  # an empty chunk tells the time and dates no byte
            filled = np.diff(ends, prepend=0) > 0
            before = np.append(self._read_s, times_s[filled])[np.cumsum(filled) - filled]
        chunks = Chunks(ends, times_s, before, 0)
        if waiting:
            old = np.array(self._chunks, np.float64).reshape(-1, 3)
            chunks = Chunks(
                np.concatenate([(old[:, 0] - self._base).astype(np.int64), ends + waiting]),
                np.concatenate([old[:, 1], times_s]),
                np.concatenate([old[:, 2], before]),
                len(old),
            )
        state = ScanState(
            self._in_step,
            self._waiting - self._base if self._waiting >= 0 else -1,
            self._limit_s,
            self._deadline_s,
        )
        line = Line(self._byte_s, self._latency_s, self._protocol.longest)
        starts, stops, arrivals = scanner.scan(whole, chunks, line, state)
        self._resume(whole, chunks, state)
        self.counters.bytes_in += len(data)
        if len(data):
            self._read_s = float(times_s[np.searchsorted(ends, len(data))])
        return FrameRun(whole, starts, stops, arrivals)

    def _resume(self, whole: NDArray[np.uint8], chunks: Chunks, state: ScanState) -> None:
        """Take over what the compiled splitter left and counted."""
        self.counters.bytes_discarded += state.discarded
        self.counters.frames += state.frames
        self.counters.crc_failures += state.crc_failures
        self.counters.resyncs += state.resyncs
        self.counters.timeouts += state.timeouts
        self._in_step = state.in_step
        self._waiting = self._base + state.waiting if state.waiting >= 0 else -1
        self._limit_s, self._deadline_s = state.limit_s, state.deadline_s
        self._buffer = bytearray(whole[state.head :].tobytes())
        first = int(np.searchsorted(chunks.ends, state.head, side="right"))
        self._chunks.clear()
        rows = (chunks.ends[first:].tolist(), chunks.times_s[first:].tolist(), chunks.earlier_s[first:].tolist())
        for end, time_s, earlier_s in zip(*rows, strict=True):
            if not self._chunks or self._base + end > self._chunks[-1].end:  # empty chunks date nothing
                self._chunks.append(_Chunk(self._base + end, time_s, earlier_s))
        self._base += state.head

    def expire(self, now_s: float) -> list[Frame]:
        """Return frames that stand behind a header whose time is up; call it when nothing comes."""
        if now_s <= self._deadline_s:
            return []
        self._deadline_s = now_s + self._limit_s
        self.counters.timeouts += 1
        return self._look_past()

    def restart(self, now_s: float) -> list[Frame]:
        """Begin a new stream (the line was lost): return what is still whole, discard the rest."""
        frames: list[Frame] = []
        while found := self._look_past():
            frames += found
        self._discard(len(self._buffer))
        self._read_s = now_s
        self._waiting, self._deadline_s = -1, float("inf")
        return frames

    def _scan(self) -> list[Frame]:
        """Take all whole frames from the buffer, up to a header that must be waited for."""
        frames: list[Frame] = []
        buffer, protocol, find = self._buffer, self._protocol, self._find
        stop, head = len(buffer), 0
        while True:
            sync = find(buffer, head)
            if sync is None:
                self._note_discarded(max(0, stop - self._sync_tail - head))
                head = max(head, stop - self._sync_tail)
                self._waiting, self._deadline_s = -1, float("inf")
                break
            start = sync.start()
            self._note_discarded(start - head)
            head = start
            length = protocol.measure(buffer, start, stop)
            if length == NEED_MORE and stop - start >= protocol.longest:
                length = NOT_A_FRAME
            if length > stop - start or length == NEED_MORE:
                self._wait(self._base + start, length or protocol.longest)
                break
            if length > 0 and protocol.check(buffer, start, start + length):
                head = start + length
                frames.append(self._frame(start, head))
                continue
            self.counters.crc_failures += length > 0
            self._note_discarded(1)
            head = start + 1
        self._consume(head)
        return frames

    def _look_past(self) -> list[Frame]:
        """Search for a whole frame behind the waiting header; when there is one, go on from it."""
        buffer, protocol = self._buffer, self._protocol
        stop, start = len(buffer), 0
        while sync := self._find(buffer, start + 1):
            start = sync.start()
            length = protocol.measure(buffer, start, stop)
            if 0 < length <= stop - start and protocol.check(buffer, start, start + length):
                self._discard(start)
                return self._scan()
        return []

    def _frame(self, start: int, end: int) -> Frame:
        """Return the frame in ``buffer[start:end]`` and count it."""
        self.counters.frames += 1
        self.counters.resyncs += not self._in_step
        self._in_step = True
        return Frame(bytes(self._buffer[start:end]), self._arrival_s(self._base + end))

    def _arrival_s(self, end: int) -> float:
        """Return when the byte before place ``end`` came: back-dated in its chunk, not before the chunk ahead."""
        chunks = self._chunks
        while chunks[0].end < end:
            chunks.popleft()
        chunk = chunks[0]
        return max(chunk.host_time_s - (chunk.end - end) * self._byte_s, chunk.earlier_s)

    def _wait(self, place: int, length: int) -> None:
        """Wait for the frame whose header stands at ``place``, from the time its first byte came."""
        limit_s = 2 * length * self._byte_s + self._latency_s
        if (place, limit_s) != (self._waiting, self._limit_s):
            self._waiting, self._limit_s = place, limit_s
            self._deadline_s = self._arrival_s(place + 1) + limit_s

    def _discard(self, count: int) -> None:
        """Drop bytes from the front of the buffer."""
        self._note_discarded(count)
        self._consume(count)

    def _note_discarded(self, count: int) -> None:
        """Count bytes that belong to no frame."""
        if count:
            self.counters.bytes_discarded += count
            self._in_step = False

    def _consume(self, count: int) -> None:
        """Let go of bytes that are dealt with."""
        del self._buffer[:count]
        self._base += count
        while self._chunks and self._chunks[0].end <= self._base:
            self._chunks.popleft()
