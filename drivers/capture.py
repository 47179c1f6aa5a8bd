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
"""

from __future__ import annotations

import json
import os
import struct
import threading
import zlib
from collections.abc import Iterator
from enum import IntEnum
from pathlib import Path
from typing import NamedTuple

from drivers.counters import Counters
from drivers.protocols.base import Protocol
from drivers.stream import Batch, StreamDecoder

MARK = bytes.fromhex("89495452")
VERSION = 1
LONGEST_DATA = 2**24
_HEAD = struct.Struct("<4sBBHdI")
_CRC = struct.Struct("<I")
_READ_SIZE = 2**20


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

    Raises
    ------
    CaptureError
        The file cannot be opened for writing.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self._lock = threading.Lock()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file: int | None = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        except OSError as error:
            raise CaptureError(
                f"{path}: cannot be written: {error.strerror}. Give a file in a folder that can."
            ) from None

    def write(self, data: bytes, host_time_s: float, kind: RecordKind = RecordKind.RECEIVED) -> None:
        """Append one record; ``OSError`` when the disk will not take it."""
        record = _HEAD.pack(MARK, VERSION, kind, 0, host_time_s, len(data)) + data
        record += _CRC.pack(zlib.crc32(record))
        with self._lock:
            if self._file is not None:
                while record:
                    record = record[os.write(self._file, record) :]

    def close(self) -> None:
        """Put everything on disk and let go of the file; closing twice does no harm."""
        with self._lock:
            if self._file is not None:
                os.fsync(self._file)
                os.close(self._file)
                self._file = None


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
    found = False
    buffer = bytearray()
    try:
        with Path(path).open("rb") as file:
            last = False
            while not last:
                piece = file.read(_READ_SIZE)
                last = not piece
                buffer += piece
                for record in _take_records(buffer, last):
                    found = True
                    yield record
            size = file.tell()
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read: {error.strerror}. Give an existing capture.") from None
    if size and not found:
        raise CaptureError(f"{path}: holds no whole record of a capture. Give a file that `inertrim capture` wrote.")


def _take_records(buffer: bytearray, last: bool) -> Iterator[CaptureRecord]:
    """Take whole records from the front of ``buffer``; what may yet become one stays unless this is the last of it."""
    head = 0
    while (start := buffer.find(MARK, head)) >= 0:
        head = start
        if len(buffer) - start < _HEAD.size:
            if not last:
                break
            head = start + 1
            continue
        _, version, kind, zero, host_time_s, length = _HEAD.unpack_from(buffer, start)
        end = start + _HEAD.size + length + _CRC.size
        legal = version == VERSION and kind in _KINDS and zero == 0 and length <= LONGEST_DATA
        if legal and end > len(buffer) and not last:
            break
        body = end - _CRC.size
        if not legal or end > len(buffer) or zlib.crc32(buffer[start:body]) != _CRC.unpack_from(buffer, body)[0]:
            head = start + 1
            continue
        yield CaptureRecord(RecordKind(kind), host_time_s, bytes(buffer[start + _HEAD.size : body]))
        head = end
    else:
        head = max(head, len(buffer) - len(MARK) + 1)
    del buffer[:head]


_KINDS = frozenset(RecordKind)


def replay(
    path: Path | str,
    protocol: Protocol,
    *,
    bit_rate: float = 921600,
    direction: RecordKind = RecordKind.RECEIVED,
    counters: Counters | None = None,
    batch_bytes: int = 65536,
) -> Iterator[Batch]:
    """Yield the batches of a capture through the decoder that a live line uses.

    ``direction`` chooses what the host received or what it sent; losses are added to ``counters``.
    """
    decoder = StreamDecoder(protocol, bit_rate, counters=counters)
    waiting = 0
    for record in read_capture(path):
        if record.kind == RecordKind.OPENED:
            decoder.opened(record.host_time_s)
        elif record.kind == direction:
            decoder.feed(record.data, record.host_time_s)
            waiting += len(record.data)
        if waiting >= batch_bytes:
            waiting = 0
            if batch := decoder.take():
                yield batch
    decoder.finish()
    if batch := decoder.take():
        yield batch
