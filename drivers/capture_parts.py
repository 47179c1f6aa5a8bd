"""The files of one capture: parts by size, compressed once they are closed, read as one run of bytes.

``run.cap`` is followed by ``run.1.cap``, ``run.2.cap`` and so on; each may be ``….cap.gz`` instead. A compressed part
is a run of gzip members of a mebibyte each, so that a cut or damaged file gives back all members but the one it hit.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import BinaryIO

READ_SIZE = 2**22
MEMBER_SIZE = 2**20
LEVEL = 1
"""Fast: what sensors say is mostly noise, and higher levels gain next to nothing."""
_GZIP = 16 + zlib.MAX_WBITS
_MEMBER_MARK = b"\x1f\x8b\x08"
COMPRESSED = ".gz"


def part_path(path: Path, number: int) -> Path:
    """Return the name of a part, the first one being ``path`` itself."""
    return path if number == 0 else path.with_name(f"{path.stem}.{number}{path.suffix}")


def parts(path: Path) -> list[Path]:
    """Return the files of a capture in order, each as it stands; none where there is no capture."""
    path = path.with_suffix("") if path.suffix == COMPRESSED else path
    found = []
    for number in count():
        plain = part_path(path, number)
        packed = plain.with_name(plain.name + COMPRESSED)
        if plain.is_file():
            found.append(plain)
        elif packed.is_file():
            found.append(packed)
        else:
            break
    return found


def compress(path: Path) -> None:
    """Put ``….gz`` in the place of a closed part; a crash at any moment leaves one of the two whole.

    Raises
    ------
    OSError
        There is no room for it; the part stays as it is.
    """
    packed = path.with_name(path.name + COMPRESSED)
    temporary = path.with_name(f".{packed.name}.part")
    try:
        with path.open("rb") as source, temporary.open("wb") as target:
            while piece := source.read(MEMBER_SIZE):
                member = zlib.compressobj(LEVEL, wbits=_GZIP)
                target.write(member.compress(piece) + member.flush())
            target.flush()
            os.fsync(target.fileno())
        temporary.replace(packed)
        path.unlink()
    finally:
        temporary.unlink(missing_ok=True)


def pieces(path: Path) -> Iterator[bytes]:
    """Yield the bytes of one file piece by piece, as far as they can be had.

    Raises
    ------
    OSError
        The file cannot be opened or read.
    """
    with path.open("rb") as file:
        if path.suffix != COMPRESSED:
            while piece := file.read(READ_SIZE):
                yield piece
        else:
            yield from _inflated(file)


def _inflated(file: BinaryIO) -> Iterator[bytes]:
    """Yield what gzip members hold; behind damage, from the next member on."""
    waiting, more = b"", True
    while more or waiting:
        piece = file.read(MEMBER_SIZE)
        more = bool(piece)
        waiting += piece
        member = zlib.decompressobj(_GZIP)
        try:
            found = member.decompress(waiting)
        except zlib.error:
            yield _until_damage(waiting)
            start = waiting.find(_MEMBER_MARK, 1)
            waiting = waiting[start:] if start >= 0 else waiting[-len(_MEMBER_MARK) + 1 :] if more else b""
            continue
        if not member.eof and more:
            continue
        yield found
        waiting = member.unused_data


def _until_damage(member: bytes) -> bytes:
    """Return what a member gives before its damage shows."""
    inflate, found = zlib.decompressobj(_GZIP), b""
    try:
        for start in range(0, len(member), 256):
            found += inflate.decompress(member[start : start + 256])
    except zlib.error:
        pass
    return found
