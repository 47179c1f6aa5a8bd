"""The splitter in compiled code: whole stretches of a capture at once, and the same frames as byte by byte.

:func:`scan` repeats :class:`drivers.framing.Splitter` step for step, the waits and time-outs between chunks included,
for protocols whose frames a :class:`~drivers.layout.FrameLayout` tells.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import compiled, compiled_inline, compiled_part
from drivers.crc import (
    Bytes,
    Tables,
    big_u32,
    byte_sum,
    little_u32,
    little_u64,
    mpeg2_crc32,
    mpeg2_tables,
    word_sum,
    zlib_crc32,
    zlib_tables,
)
from drivers.layout import (
    CHECKSUM,
    CRCS,
    LEAD,
    LENGTH,
    PADDING,
    PATTERN,
    SYNC,
    TRAILER,
    Checksum,
    FrameLayout,
    LayoutArrays,
    layout_arrays,
)

Places = NDArray[np.int64]
Times = NDArray[np.float64]
Words = NDArray[np.uint64]

_MPEG2, _BYTE_SUM, _WORD_SUM = (
    int(one) for one in (Checksum.CRC32_MPEG2_BIG, Checksum.BYTE_SUM, Checksum.WORD_SUM_LITTLE)
)
_CRC_SIZE = 4
_NONE = -1
# Where the counts and the places stand in the array of whole numbers that a call changes, and the times in theirs.
_DISCARDED, _FRAMES, _CRC_FAILURES, _RESYNCS, _TIMEOUTS, _IN_STEP, _WAITING, _HEAD = range(8)
_LIMIT, _DEADLINE = range(2)


@dataclass(slots=True)
class ScanState:
    """What goes over from one stretch to the next, and what one call counted."""

    in_step: bool
    waiting: int
    limit_s: float
    deadline_s: float
    head: int = 0
    discarded: int = 0
    frames: int = 0
    crc_failures: int = 0
    resyncs: int = 0
    timeouts: int = 0


@dataclass(frozen=True, slots=True)
class Line:
    """What the waits depend on: time of a byte [s], latency of the host [s], longest legal frame [bytes]."""

    byte_s: float
    latency_s: float
    longest: int


@dataclass(frozen=True, slots=True)
class Chunks:
    """Chunks of a stretch: where each ends, when it was read, when the one before it was; the last ones are new."""

    ends: Places
    times_s: Times
    earlier_s: Times
    first_new: int


class Scanner:
    """Compiled splitter of one layout."""

    def __init__(self, layout: FrameLayout) -> None:
        self._arrays = layout_arrays(layout)
        self._shortest = min(head.length for head in layout.heads)
        self._longest_sync = int(self._arrays.sizes[:, SYNC].max())
        used = [Checksum(one) for one in self._arrays.sizes[:, CHECKSUM]]
        self._tables = _tables(next((one for one in used if one in CRCS), Checksum.CRC32_LITTLE))

        one = np.zeros(1)
        chunks = Chunks(np.ones(1, np.int64), one, one, 0)
        self.scan(np.zeros(1, np.uint8), chunks, Line(0.0, 0.0, 1), ScanState(True, -1, 0.0, np.inf))  # compiles

    def scan(self, data: Bytes, chunks: Chunks, line: Line, state: ScanState) -> tuple[Places, Places, Times]:
        """Return start, end and arrival time of every frame in ``data``; ``state`` is brought up to date."""
        room = len(data) // self._shortest + 1
        starts, stops, times = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room)
        whole = np.zeros(8, np.int64)
        whole[_IN_STEP], whole[_WAITING] = state.in_step, state.waiting
        seconds = np.array([state.limit_s, state.deadline_s])
        arrays = tuple(getattr(self._arrays, one.name) for one in fields(LayoutArrays))
        sizes = (line.longest, self._longest_sync, chunks.first_new)
        _scan(
            data,
            (chunks.ends, chunks.times_s, chunks.earlier_s),
            arrays,
            self._tables,
            sizes,
            (line.byte_s, line.latency_s),
            whole,
            seconds,
            (starts, stops, times),
        )
        state.discarded, state.frames, state.crc_failures, state.resyncs, state.timeouts = whole[:5].tolist()
        state.in_step, state.waiting, state.head = bool(whole[_IN_STEP]), int(whole[_WAITING]), int(whole[_HEAD])
        state.limit_s, state.deadline_s = seconds.tolist()
        return starts[: state.frames], stops[: state.frames], times[: state.frames]


@cache
def scanner_of(layout: FrameLayout) -> Scanner:
    """Return the compiled splitter of a layout; it keeps nothing, so that one serves every line."""
    return Scanner(layout)


@cache
def _tables(checksum: Checksum) -> Tables:
    return mpeg2_tables() if checksum is Checksum.CRC32_MPEG2_BIG else zlib_tables()


ChunkArrays = tuple[Places, Times, Times]
HeadArrays = tuple[Places, Places, Words, Words, Words, Places, Bytes]
Found = tuple[Places, Places, Times]


@compiled_inline
def _word(data: Bytes, place: int) -> np.uint64:
    """Return up to eight bytes from ``place`` on as a little-endian number, zeros where there are no more."""
    if place + 8 <= len(data):
        return little_u64(data, place)
    word = np.uint64(0)
    for offset in range(len(data) - place):
        word |= np.uint64(data[place + offset]) << np.uint64(8 * offset)
    return word


@compiled_inline
def _match(word: np.uint64, room: int, column: int, masks: Words, heads: HeadArrays) -> int:
    """Return the first head of which the masked part agrees with ``word`` and fits into ``room`` bytes, or -1."""
    first, following, patterns, _, _, sizes, _ = heads
    index = first[word & np.uint64(255)]
    while index >= 0 and (((patterns[index] ^ word) & masks[index]) != 0 or sizes[index, column] > room):
        index = following[index]
    return int(index)


@compiled_part
def _take_run(
    data: Bytes,
    chunks: ChunkArrays,
    heads: HeadArrays,
    kind: int,
    tables: Tables,
    line: tuple[float, float],
    at: tuple[int, int, int, int],
    found: Found,
) -> tuple[int, int, int, int]:
    """Take frames of one kind while one follows the other: what a clean line says, with as little ado as there can be.

    ``at`` and what is returned are (place, feed, of_frame, count) as in :func:`_scan`. Ends where anything is not
    plain: another head, a wrong checksum, too few bytes, or chunks so far apart that a wait for the frame may have
    timed out.
    """
    ends, times_s, earlier_s = chunks
    starts, stops, arrivals_s = found
    trailer, pattern, mask = heads[6], heads[2][kind], heads[4][kind]
    sizes, checksum = heads[5], heads[5][kind, CHECKSUM]
    length, padding, trailing, lead = sizes[kind, LENGTH], sizes[kind, PADDING], sizes[kind, TRAILER], sizes[kind, LEAD]
    byte_s, latency_s = line
    place, feed, of_frame, count = at
    total, stop, chunk_end = len(data), ends[feed], ends[of_frame]
    while place + length <= total and (little_u64(data, place) & mask) == pattern:
        end = place + length
        while stop < end and times_s[feed] - earlier_s[of_frame] <= latency_s:
            feed += 1
            stop = ends[feed]
        if stop < end:
            break
        body = end - trailing - _CRC_SIZE
        if checksum == _BYTE_SUM:
            holds = byte_sum(data, place + lead, body + 3) == data[body + 3]
        elif checksum == _WORD_SUM:
            holds = word_sum(data, place + lead, body + 2) == np.uint16(data[body + 2] | np.uint16(data[body + 3]) << 8)
        elif checksum == _MPEG2:
            holds = mpeg2_crc32(data, place + lead, body, padding, tables) == big_u32(data, body)
        else:
            holds = zlib_crc32(data, place + lead, body, tables) == little_u32(data, body)
        for offset in range(trailing):
            holds &= data[end - trailing + offset] == trailer[offset]
        if not holds:
            break
        while chunk_end < end:
            of_frame += 1
            chunk_end = ends[of_frame]
        starts[count], stops[count] = place, end
        arrivals_s[count] = max(times_s[of_frame] - (chunk_end - end) * byte_s, earlier_s[of_frame])
        count += 1
        place = end
    return place, feed, of_frame, count


@compiled_part
def _behind(
    data: Bytes,
    stop: int,
    chunks: ChunkArrays,
    heads: HeadArrays,
    tables: Tables,
    line: tuple[float, float],
    at: tuple[int, int, int, int],
    found: Found,
) -> int:
    """Return where the next whole frame before ``stop`` begins, behind the header at ``at``; -1: there is none.

    What is written to ``found`` on the way is written again when that frame is taken.
    """
    place, feed, of_frame, count = at
    for start in range(place + 1, stop):
        kind = _match(_word(data, start), stop - start, LENGTH, heads[4], heads)
        if kind >= 0:
            here = (start, feed, of_frame, count)
            if _take_run(data, chunks, heads, kind, tables, line, here, found)[3] > count:
                return start
    return _NONE


@compiled
def _scan(
    data: Bytes,
    chunks: ChunkArrays,
    heads: HeadArrays,
    tables: Tables,
    sizes: tuple[int, int, int],
    line: tuple[float, float],
    whole: Places,
    seconds: Times,
    found: Found,
) -> None:
    """Do the work of :meth:`Scanner.scan`; ``whole`` and ``seconds`` are its state.

    ``place`` is where a frame is looked for, ``head`` the end of what is dealt with, ``feed`` the chunk at whose
    arrival this looking happens and ``stop`` its end, ``of_frame`` the chunk that holds the last frame's last byte.
    """
    ends, times_s, earlier_s = chunks
    longest, longest_sync, feed = sizes
    byte_s, latency_s = line
    last_feed, total = len(ends) - 1, len(data)
    head = place = count = of_frame = whole[_HEAD]  # 0, yet no constant: parts would be compiled for constants too
    expired_in = -1
    stop = ends[feed]
    while True:
        # The next sync pattern, wherever it ends; chunks that arrive before its end wait for nothing.
        sync = _NONE
        while place < total:
            sync = _match(_word(data, place), total - place, SYNC, heads[3], heads)
            if sync >= 0:
                break
            place += 1
        needed = heads[5][max(sync, 0), SYNC]
        while feed < last_feed and (sync < 0 or stop < place + needed):
            feed += 1
            stop = ends[feed]
            whole[_WAITING], seconds[_DEADLINE] = _NONE, np.inf
        if sync < 0:
            whole[_WAITING], seconds[_DEADLINE] = _NONE, np.inf
            place = max(head, total - longest_sync + 1)
            break
        if place > head:
            whole[_DISCARDED] += place - head
            whole[_IN_STEP] = 0
            head = place
        # The frame of which it is the beginning, or that it is none, or that more must come.
        word, kind, is_known, is_jump = _word(data, place), _NONE, False, False
        while True:
            needed = longest
            if place + heads[5][sync, PATTERN] <= stop:
                kind = _match(word, total, PATTERN, heads[4], heads)
                needed = heads[5][max(kind, 0), LENGTH]
                is_known = kind < 0 or place + needed <= stop
            if is_known:
                break
            limit_s = 2 * needed * byte_s + latency_s
            if whole[_WAITING] != place or seconds[_LIMIT] != limit_s:
                # From the time that the header's first byte came.
                chunk = of_frame
                while ends[chunk] < place + 1:
                    chunk += 1
                came_s = max(times_s[chunk] - (ends[chunk] - place - 1) * byte_s, earlier_s[chunk])
                whole[_WAITING], seconds[_LIMIT], seconds[_DEADLINE] = place, limit_s, came_s + limit_s
            if times_s[feed] > seconds[_DEADLINE] and expired_in != feed:
                expired_in = feed
                seconds[_DEADLINE] = times_s[feed] + limit_s
                whole[_TIMEOUTS] += 1
                at = (place, feed, of_frame, count)
                behind = _behind(data, stop, chunks, heads, tables, line, at, found)
                if behind >= 0:
                    place, is_jump = behind, True
                    break
            if feed == last_feed:
                break
            feed += 1
            stop = ends[feed]
        if is_jump:
            continue
        if not is_known:
            break
        before = count
        if kind >= 0:
            at = (place, feed, of_frame, count)
            place, feed, of_frame, count = _take_run(data, chunks, heads, kind, tables, line, at, found)
        if count > before:
            whole[_RESYNCS] += 1 - whole[_IN_STEP]
            whole[_IN_STEP] = 1
        else:
            whole[_CRC_FAILURES] += kind >= 0
            whole[_DISCARDED] += 1
            whole[_IN_STEP] = 0
            place += 1
        head, stop = place, ends[feed]
    if place > head:
        whole[_DISCARDED] += place - head
        whole[_IN_STEP] = 0
    whole[_FRAMES], whole[_HEAD] = count, place
