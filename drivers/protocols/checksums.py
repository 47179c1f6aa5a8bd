"""Checksums of other makers' frames, at the speed of the C that the standard library already holds."""

from __future__ import annotations

import zlib

_MIRROR = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def crc32_mpeg2(data: bytes | bytearray, dummies: int = 0) -> bytes:
    """Return the CRC-32/MPEG-2 of ``data`` and ``dummies`` zero bytes behind it, as the 4 bytes sent.

    Polynomial 04C11DB7, initial value FFFFFFFF, not reflected, no final XOR. The reflected CRC of mirrored bytes is
    the mirrored CRC, and zlib computes the reflected one.
    """
    mirrored = zlib.crc32(data.translate(_MIRROR) + bytes(dummies)) ^ 0xFFFFFFFF
    return mirrored.to_bytes(4, "little").translate(_MIRROR)


def fletcher16(data: bytes | bytearray) -> bytes:
    """Return the two sums of MicroStrain's packets: of the bytes, and of those sums, modulo 256."""
    first = second = 0
    for byte in data:
        first += byte
        second += first
    return bytes((first & 0xFF, second & 0xFF))


def word_sum(data: bytes | bytearray) -> int:
    """Return the 16-bit sum of little-endian words, carry dropped."""
    return (sum(data[0::2]) + 256 * sum(data[1::2])) & 0xFFFF
