"""What a line once said, from whatever file it was kept in: our captures, bare bytes, hexadecimal text."""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from itertools import islice
from pathlib import Path

import numpy as np

from drivers.capture import CaptureError, read_capture, replay
from drivers.capture_parts import parts
from drivers.counters import Counters
from drivers.hex_text import HexTextError, looks_like_hex, read_hex
from drivers.protocols.base import Protocol
from drivers.stream import Batch, StreamDecoder

HEAD_BYTES = 2**16
PIECE_BYTES = 2**21


class SourceKind(StrEnum):
    """How the bytes of a line were kept."""

    CAPTURE = "capture"
    HEX = "hexadecimal text"
    BYTES = "bare bytes"


def source_kind(path: Path) -> SourceKind:
    """Tell by content what a file is; a file with no whole record of a capture in it is not one.

    Raises
    ------
    CaptureError
        It cannot be read, or is empty.
    """
    if not path.is_file() and parts(path):
        return SourceKind.CAPTURE
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read: {error.strerror}. Give an existing file.") from None
    if not head:
        raise CaptureError(f"{path}: is empty. Give a file that holds what a line said.")
    if looks_like_hex(head[: head.rfind(b"\n") + 1] or head):
        return SourceKind.HEX
    try:
        return SourceKind.CAPTURE if list(islice(read_capture(path), 1)) else SourceKind.BYTES
    except CaptureError:
        return SourceKind.BYTES


def bare_bytes(path: Path, kind: SourceKind) -> Iterator[bytes]:
    """Yield the bytes of a file that is no capture.

    Raises
    ------
    CaptureError
        It is not what it looks like.
    """
    if kind is SourceKind.HEX:
        try:
            yield read_hex(path)
        except HexTextError as error:
            raise CaptureError(str(error)) from None
        return
    with path.open("rb") as file:
        while piece := file.read(PIECE_BYTES):
            yield piece


def read_source(
    path: Path, protocol: Protocol, *, bit_rate: float = 921600, counters: Counters | None = None
) -> Iterator[Batch]:
    """Yield the batches that any of these files holds.

    Bare bytes came at no known time: their host times are all 0, and gaps longer than a counter's period stay unseen.

    Raises
    ------
    CaptureError
        The file cannot be read.
    """
    kind = source_kind(path)
    if kind is SourceKind.CAPTURE:
        yield from replay(path, protocol, bit_rate=bit_rate, counters=counters)
        return
    decoder = StreamDecoder(protocol, bit_rate, counters=counters)
    for piece in bare_bytes(path, kind):
        data = np.frombuffer(piece, np.uint8)
        decoder.feed_stretch(data, np.array([len(data)]), np.zeros(1))
        if batch := decoder.take():
            yield batch
    decoder.finish()
    if batch := decoder.take():
        yield batch
