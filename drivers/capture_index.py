"""Finds the whole records among the bytes of a capture, in compiled code: a day's capture holds millions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import compiled
from drivers.crc import Bytes, Place, Tables, little_u32, little_u64, zlib_crc32, zlib_tables

Places = NDArray[np.int64]

HEAD_SIZE = 20
CRC_SIZE = 4
_TIME, _LENGTH = 8, 16


@dataclass(frozen=True, slots=True)
class Layout:
    """What a record looks like: its mark (little-endian number), version, number of kinds, longest data [bytes]."""

    mark: int
    version: int
    kinds: int
    longest: int


@dataclass(frozen=True, slots=True)
class Records:
    """Whole records found in ``data``: kind, host time [s], and where their data start and stop."""

    data: Bytes
    kinds: NDArray[np.uint8]
    times_s: NDArray[np.float64]
    starts: Places
    stops: Places

    def __len__(self) -> int:
        return len(self.kinds)

    def chosen(self, first: int, last: int, kind: int) -> Records:
        """Return the records of one kind among those from ``first`` to before ``last``."""
        rows = first + np.flatnonzero(self.kinds[first:last] == kind)
        return Records(self.data, self.kinds[rows], self.times_s[rows], self.starts[rows], self.stops[rows])

    def pieces(self, size: int) -> Iterator[tuple[int, int]]:
        """Yield runs of records (first, behind the last) with about ``size`` bytes of data each."""
        turns = np.flatnonzero(np.diff(np.cumsum(self.stops - self.starts) // size, prepend=0)) + 1
        for first, last in pairwise([0, *turns.tolist(), len(self)]):
            if last > first:
                yield first, last

    def joined(self, which: slice) -> tuple[Bytes, Places]:
        """Return the data of some records without what stands between them, and where each ends in it."""
        starts, stops = self.starts[which], self.stops[which]
        ends = np.cumsum(stops - starts)
        joined = np.empty(int(ends[-1]) if len(ends) else 0, np.uint8)
        _join(self.data, starts, stops, joined)
        return joined, ends


def index_records(data: Bytes, layout: Layout, *, last: bool) -> tuple[Records, int]:
    """Return the whole records in ``data`` and how many bytes are dealt with.

    What may yet become a record is not dealt with, unless this is the ``last`` of it.
    """
    room = len(data) // (HEAD_SIZE + CRC_SIZE) + 1
    kinds, times = np.empty(room, np.uint8), np.empty(room, np.uint64)
    starts, stops = np.empty(room, np.int64), np.empty(room, np.int64)
    numbers = (layout.mark, layout.version, layout.kinds, layout.longest)
    count, done = _index(data, last, numbers, _tables(), kinds, times, starts, stops)
    return Records(data, kinds[:count], times[:count].view(np.float64), starts[:count], stops[:count]), done


@cache
def _tables() -> Tables:
    return zlib_tables()


@compiled
def _index(
    data: Bytes,
    last: bool,
    layout: tuple[int, int, int, int],
    tables: Tables,
    kinds: NDArray[np.uint8],
    times: NDArray[np.uint64],
    starts: Places,
    stops: Places,
) -> tuple[int, int]:
    """Do the work of :func:`index_records`; times are the bits of doubles."""
    mark, version, kind_count, longest = layout
    total, count = len(data), 0
    place: Place = 0
    while place + HEAD_SIZE <= total:
        if little_u32(data, place) != mark:
            place += 1
            continue
        head = little_u32(data, place + 4)
        kind, length = (head >> 8) & 255, np.int64(little_u32(data, place + _LENGTH))
        stop = place + HEAD_SIZE + length
        legal = (head & 255) == version and kind < kind_count and head >> 16 == 0 and length <= longest
        if legal and stop + CRC_SIZE > total and not last:
            break
        whole = legal and stop + CRC_SIZE <= total
        if not whole or zlib_crc32(data, place, stop, tables) != little_u32(data, stop):
            place += 1
            continue
        kinds[count], times[count] = kind, little_u64(data, place + _TIME)
        starts[count], stops[count] = place + HEAD_SIZE, stop
        count += 1
        place = stop + CRC_SIZE
    return count, int(place)


@compiled
def _join(data: Bytes, starts: Places, stops: Places, joined: Bytes) -> None:
    """Copy spans of ``data`` one behind the other."""
    place = 0
    for index in range(len(starts)):
        size = stops[index] - starts[index]
        joined[place : place + size] = data[starts[index] : stops[index]]
        place += size
