"""Raw bytes of a line on disk, as they came and when, before anyone decoded them; and their replay.

A capture is a run of records and nothing else, all numbers little-endian:

====== ======= ==============================================================================
offset bytes   what
====== ======= ==============================================================================
0      4       mark ``89 49 54 52``
4      1       version, 1
5      1       kind: 0 received, 1 sent, 2 the line was opened (data: JSON about it)
6      2       0
8      8       host time [simulated s] at the last byte, double
16     4       length n of the data
20     n       data
20+n   4       CRC-32 (zlib) over everything before it
====== ======= ==============================================================================

Each record is handed to the operating system in one write as soon as it is there, so that a killed process loses
none. Cut a capture anywhere, or damage it: the reader looks for the next mark whose record is whole, and reads on.
One capture may stand in several files, some of them compressed: :mod:`drivers.capture_parts`.
"""

from __future__ import annotations

import json
import os
import re
import struct
import threading
import zlib
from collections.abc import Iterator
from contextlib import suppress
from enum import IntEnum
from itertools import chain, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from drivers.capture_parts import compress, part_path, parts, pieces
from drivers.counters import Counters
from drivers.framing import BITS_PER_BYTE
from drivers.protocols.base import Protocol
from drivers.stream import Batch, StreamDecoder

if TYPE_CHECKING:
    from drivers.capture_index import Records

MARK = bytes.fromhex("89495452")
VERSION = 1
LONGEST_DATA = 2**24
PART_BYTES = 2**26
"""Size at which a capture goes on in another part."""
PATIENCE_BYTES = 2**20
"""How much more than that a part may hold where no frame ends at which it could be split."""
_HEAD = struct.Struct("<4sBBHdI")
_CRC = struct.Struct("<I")


class CaptureError(ValueError):
    """A capture cannot be read: which file, why, and what to do."""


class RecordKind(IntEnum):
    """What a record holds."""

    RECEIVED = 0
    SENT = 1
    OPENED = 2


class CaptureRecord(NamedTuple):
    """One record: what, when its last byte passed [simulated s], and the bytes."""

    kind: RecordKind
    host_time_s: float
    data: bytes


class CaptureWriter:
    """Appends to a capture; safe to use from several threads.

    Parameters
    ----------
    path : file to append to, made with its folder when absent.
    protocol : what the line speaks. With it the capture goes on in another part (``drivers.capture_parts``) once one
        is larger than ``part_bytes``, each beginning with a whole frame; without it there is one part.
    bit_rate : of the line [bit/s]; dates the two halves of a chunk that is split.
    packed : whether parts are compressed once they are closed.

    Raises
    ------
    CaptureError
        The file cannot be opened for writing.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        protocol: Protocol | None = None,
        bit_rate: float = 921600,
        part_bytes: int = PART_BYTES,
        packed: bool = False,
    ) -> None:
        self.path = Path(path)
        self._lock = threading.Lock()
        self._part_bytes, self._packed = part_bytes, packed
        self._byte_s = BITS_PER_BYTE / bit_rate
        self._boundary = None if protocol is None else _FrameEnds(protocol)
        self._compressors: list[threading.Thread] = []
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            there = parts(self.path)
            is_open = bool(there) and there[-1] == part_path(self.path, len(there) - 1)  # a compressed one is closed
            self._file: int | None = self._open(len(there) - is_open)
        except OSError as error:
            raise CaptureError(
                f"{path}: cannot be written: {error.strerror}. Give a file in a folder that can."
            ) from None

    def write(self, data: bytes, host_time_s: float, kind: RecordKind = RecordKind.RECEIVED) -> None:
        """Append one record; ``OSError`` when the disk will not take it."""
        with self._lock:
            if self._file is None:
                return
            if self._boundary is not None and kind is RecordKind.RECEIVED and self._size >= self._part_bytes:
                data = self._split(self._boundary, data, host_time_s)
            self._append(data, host_time_s, kind)

    def close(self) -> None:
        """Put everything on disk and let go of the files; closing twice does no harm."""
        with self._lock:
            if self._file is not None:
                self._close_part()
                self._file = None
        for thread in self._compressors:
            thread.join()

    def _open(self, number: int) -> int:
        """Open a part for appending."""
        self._number = number
        file = os.open(part_path(self.path, number), os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        self._size = os.fstat(file).st_size
        return file

    def _append(self, data: bytes, host_time_s: float, kind: RecordKind) -> None:
        """Write one record."""
        assert self._file is not None
        record = _HEAD.pack(MARK, VERSION, kind, 0, host_time_s, len(data)) + data
        record += _CRC.pack(zlib.crc32(record))
        self._size += len(record)
        while record:
            record = record[os.write(self._file, record) :]

    def _split(self, boundary: _FrameEnds, data: bytes, host_time_s: float) -> bytes:
        """Go on in a new part from the end of a frame in ``data`` on, when there is one; return what belongs there."""
        cut = boundary.find(data)
        if cut is None and self._size < self._part_bytes + PATIENCE_BYTES:
            return data
        cut = cut or 0
        if cut:
            self._append(data[:cut], host_time_s - (len(data) - cut) * self._byte_s, RecordKind.RECEIVED)
        self._close_part()
        self._file = self._open(self._number + 1)
        boundary.forget()
        return data[cut:]

    def _close_part(self) -> None:
        """Put a part on disk and, elsewhere and in its own time, compress it."""
        assert self._file is not None
        os.fsync(self._file)
        os.close(self._file)
        if self._packed:
            thread = threading.Thread(target=_compress, args=(part_path(self.path, self._number),), name="compress")
            self._compressors = [one for one in self._compressors if one.is_alive()] + [thread]
            thread.start()


def _compress(path: Path) -> None:
    with suppress(OSError):  # no room: it stays as it is, and reads as well
        compress(path)


class _FrameEnds:
    """Finds where in a stream a whole frame ends."""

    def __init__(self, protocol: Protocol) -> None:
        self._protocol = protocol
        self._sync = re.compile(b"|".join(re.escape(sync) for sync in protocol.sync), re.DOTALL)
        self._before = b""

    def find(self, data: bytes) -> int | None:
        """Return where in ``data``, the next of the stream, a frame ends; None where none does."""
        before, stream = len(self._before), self._before + data
        self._before = stream[-self._protocol.longest :]
        for sync in self._sync.finditer(stream):
            start = sync.start()
            length = self._protocol.measure(stream, start, len(stream))
            stop = start + length
            if 0 < length <= len(stream) - start and stop > before and self._protocol.check(stream, start, stop):
                return stop - before
        return None

    def forget(self) -> None:
        """Begin another part."""
        self._before = b""


def describe_line(**about: object) -> bytes:
    """Return the data of an OPENED record: how the line was opened."""
    return json.dumps(about, sort_keys=True).encode()


def read_capture(path: Path | str) -> Iterator[CaptureRecord]:
    """Yield every whole record of a capture, in order, passing over what is cut or damaged.

    Raises
    ------
    CaptureError
        The file cannot be read, or holds no whole record though it is not empty.
    """
    for records in read_stretches(path):
        rows = (records.kinds.tolist(), records.times_s.tolist(), records.starts.tolist(), records.stops.tolist())
        for kind, time_s, start, stop in zip(*rows, strict=True):
            yield CaptureRecord(RecordKind(kind), time_s, records.data[start:stop].tobytes())


def read_stretches(path: Path | str) -> Iterator[Records]:
    """Yield the whole records of a capture, all its parts one behind the other, some mebibytes at a time.

    Raises
    ------
    CaptureError
        As :func:`read_capture`.
    """
    from drivers.capture_index import Layout, index_records  # whoever writes needs no compiled code, nor waits for it

    layout = Layout(int.from_bytes(MARK, "little"), VERSION, len(RecordKind), LONGEST_DATA)
    found, size, rest = False, 0, b""
    try:
        files = parts(Path(path)) or [Path(path)]
        for piece in chain((piece for file in files for piece in pieces(file)), [None]):
            data = np.frombuffer(rest + (piece or b""), np.uint8)
            records, done = index_records(data, layout, last=piece is None)
            found, size = found or len(records) > 0, size + len(piece or b"")
            rest = data[done:].tobytes()
            if len(records):
                yield records
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read: {error.strerror}. Give an existing capture.") from None
    if size and not found:
        raise CaptureError(f"{path}: holds no whole record of a capture. Give a file that `inertrim capture` wrote.")


def replay(
    path: Path | str,
    protocol: Protocol,
    *,
    bit_rate: float = 921600,
    direction: RecordKind = RecordKind.RECEIVED,
    counters: Counters | None = None,
    batch_bytes: int = 2**21,
) -> Iterator[Batch]:
    """Yield the batches of a capture, split and decoded as a live line would have been.

    ``direction`` chooses what the host received or what it sent; losses are added to ``counters``.
    """
    decoder = StreamDecoder(protocol, bit_rate, counters=counters)
    for records in read_stretches(path):
        opened = np.flatnonzero(records.kinds == RecordKind.OPENED).tolist()
        for low, high in pairwise([-1, *opened, len(records)]):
            if low >= 0:
                decoder.opened(float(records.times_s[low]))
                yield from _said(decoder)
            chosen = records.chosen(low + 1, high, direction)
            for first, last in chosen.pieces(batch_bytes):
                data, ends = chosen.joined(slice(first, last))
                decoder.feed_stretch(data, ends, chosen.times_s[first:last])
                yield from _said(decoder)
    decoder.finish()
    yield from _said(decoder)


def _said(decoder: StreamDecoder) -> Iterator[Batch]:
    """Yield what a decoder has to say, if anything."""
    if batch := decoder.take():
        yield batch
