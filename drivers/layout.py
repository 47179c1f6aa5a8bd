"""Frames told by a table: what a protocol says of itself so that whole captures can be split by compiled code.

A live line is split by the protocol's own ``measure`` and ``check``. Where a table can say the same, a replay is a
hundred times as fast; a test holds the two to the same frames, losses and times, on any bytes.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray


class Checksum(IntEnum):
    """How a frame proves itself whole."""

    CRC32_LITTLE = 0
    """CRC-32 as in zlib over all before it, little-endian."""
    CRC32_MPEG2_BIG = 1
    """CRC-32/MPEG-2 over all before it and :attr:`Head.padding` zeros that are not sent, big-endian."""
    BYTE_SUM = 2
    """Sum of all bytes before it, modulo 256."""
    WORD_SUM_LITTLE = 3
    """Sum of all little-endian 16-bit words before it, carry dropped, little-endian."""


CRCS = (Checksum.CRC32_LITTLE, Checksum.CRC32_MPEG2_BIG)


@dataclass(frozen=True, slots=True)
class Head:
    """One kind of frame: the ``pattern`` of up to eight bytes that it begins with, and its ``length`` [bytes].

    ``padding`` zeros are thought of ahead of the checksum; ``trailer`` follows it and must stand there. The first
    ``lead`` bytes of the pattern are not covered by the checksum. ``checksum`` is given where it is another than the
    layout's.
    """

    pattern: bytes
    length: int
    padding: int = 0
    trailer: bytes = b""
    lead: int = 0
    checksum: Checksum | None = None


@dataclass(frozen=True, slots=True)
class FrameLayout:
    """All frames of a protocol; no pattern of ``heads`` begins another, no frame is shorter than eight bytes.

    All CRCs among the checksums are of one kind. The ``sync_length`` bytes of a pattern that follow its lead end its
    sync pattern.
    """

    heads: tuple[Head, ...]
    checksum: Checksum
    sync_length: int


@dataclass(frozen=True, slots=True)
class LayoutArrays:
    """A layout as compiled code reads it.

    ``first[b]`` is the first head whose pattern begins with byte b, -1 where none does, and ``following[h]`` the next
    one that begins alike. ``patterns`` and their masks are little-endian words; ``sizes`` has for each head the
    lengths of sync pattern, pattern and frame, its padding, trailer, lead and checksum.
    """

    first: NDArray[np.int64]
    following: NDArray[np.int64]
    patterns: NDArray[np.uint64]
    sync_masks: NDArray[np.uint64]
    masks: NDArray[np.uint64]
    sizes: NDArray[np.int64]
    trailer: NDArray[np.uint8]


SYNC, PATTERN, LENGTH, PADDING, TRAILER, LEAD, CHECKSUM = range(7)
"""Columns of :attr:`LayoutArrays.sizes`."""


def layout_arrays(layout: FrameLayout) -> LayoutArrays:
    """Return the arrays of a layout.

    Raises
    ------
    ValueError
        Frames of fewer than eight bytes, several trailers, or several kinds of CRC.
    """
    heads = layout.heads
    trailers = {head.trailer for head in heads if head.trailer}
    crcs = {layout.checksum, *(head.checksum for head in heads)}.intersection(CRCS)
    if min(head.length for head in heads) < 8 or len(trailers) > 1 or len(crcs) > 1:
        raise ValueError("frames of a layout have eight bytes or more, one trailer and one kind of CRC at most")
    first, following = np.full(256, -1, np.int64), np.full(len(heads), -1, np.int64)
    for index in reversed(range(len(heads))):
        following[index], first[heads[index].pattern[0]] = first[heads[index].pattern[0]], index
    rows = [
        (
            head.lead + layout.sync_length,
            len(head.pattern),
            head.length,
            head.padding,
            len(head.trailer),
            head.lead,
            layout.checksum if head.checksum is None else head.checksum,
        )
        for head in heads
    ]
    return LayoutArrays(
        first,
        following,
        np.array([int.from_bytes(head.pattern, "little") for head in heads], np.uint64),
        np.array([2 ** (8 * row[SYNC]) - 1 for row in rows], np.uint64),
        np.array([2 ** (8 * row[PATTERN]) - 1 for row in rows], np.uint64),
        np.array(rows, np.int64),
        np.frombuffer(b"".join(trailers) + b"\0", np.uint8),
    )
