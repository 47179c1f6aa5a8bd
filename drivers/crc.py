"""CRC-32 in compiled code, sixteen bytes a step (slicing-by-16), for frames too short and too many to call zlib for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import compiled_inline

Bytes = NDArray[np.uint8]
Tables = NDArray[np.uint32]
Place = int | np.int64

ZLIB_POLYNOMIAL = 0xEDB88320
MPEG2_POLYNOMIAL = 0x04C11DB7
_ONES = np.uint32(0xFFFFFFFF)
_8, _16, _24 = np.uint32(8), np.uint32(16), np.uint32(24)
# Shifts widen to 64 bits in compiled code, hence the conversions back.
# Unsigned all through: a signed index would be tested for being negative at every byte.
I1, I2, I3, I4, I5, I6, I7, I8 = (np.uint64(i) for i in range(1, 9))
I9, I10, I11, I12, I13, I14, I15, I16 = (np.uint64(i) for i in range(9, 17))


def zlib_tables() -> Tables:
    """Return sixteen tables for the reflected CRC; table k is that of a byte with k bytes behind it."""
    tables = np.zeros((16, 256), np.uint32)
    crc = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        crc = np.where(crc & 1, (crc >> 1) ^ np.uint32(ZLIB_POLYNOMIAL), crc >> 1)
    tables[0] = crc
    for k in range(1, 16):
        tables[k] = (tables[k - 1] >> 8) ^ tables[0, tables[k - 1] & 255]
    return tables


def mpeg2_tables() -> Tables:
    """Return sixteen tables for the unreflected CRC; table k is that of a byte with k bytes behind it."""
    tables = np.zeros((16, 256), np.uint32)
    crc = np.arange(256, dtype=np.uint32) << 24
    for _ in range(8):
        crc = np.where(crc >> 31, (crc << 1) ^ np.uint32(MPEG2_POLYNOMIAL), crc << 1)
    tables[0] = crc
    for k in range(1, 16):
        tables[k] = (tables[k - 1] << 8) ^ tables[0, tables[k - 1] >> 24]
    return tables


@compiled_inline
def zlib_crc32(data: Bytes, start: Place, stop: Place, t: Tables) -> np.uint32:
    """Return ``zlib.crc32(data[start:stop])``; ``t`` from :func:`zlib_tables`."""
    crc, i, end = _ONES, np.uint64(start), np.uint64(stop)
    while i + I16 <= end:
        crc = (
            t[15, data[i] ^ np.uint8(crc)]
            ^ t[14, data[i + I1] ^ np.uint8(crc >> _8)]
            ^ t[13, data[i + I2] ^ np.uint8(crc >> _16)]
            ^ t[12, data[i + I3] ^ np.uint8(crc >> _24)]
            ^ t[11, data[i + I4]]
            ^ t[10, data[i + I5]]
            ^ t[9, data[i + I6]]
            ^ t[8, data[i + I7]]
            ^ t[7, data[i + I8]]
            ^ t[6, data[i + I9]]
            ^ t[5, data[i + I10]]
            ^ t[4, data[i + I11]]
            ^ t[3, data[i + I12]]
            ^ t[2, data[i + I13]]
            ^ t[1, data[i + I14]]
            ^ t[0, data[i + I15]]
        )
        i += I16
    while i + I8 <= end:
        crc = (
            t[7, data[i] ^ np.uint8(crc)]
            ^ t[6, data[i + I1] ^ np.uint8(crc >> _8)]
            ^ t[5, data[i + I2] ^ np.uint8(crc >> _16)]
            ^ t[4, data[i + I3] ^ np.uint8(crc >> _24)]
            ^ t[3, data[i + I4]]
            ^ t[2, data[i + I5]]
            ^ t[1, data[i + I6]]
            ^ t[0, data[i + I7]]
        )
        i += I8
    while i < end:
        crc = t[0, data[i] ^ np.uint8(crc)] ^ np.uint32(crc >> _8)
        i += I1
    return crc ^ _ONES


@compiled_inline
def mpeg2_crc32(data: Bytes, start: Place, stop: Place, padding: int, t: Tables) -> np.uint32:
    """Return CRC-32/MPEG-2 over ``data[start:stop]`` and ``padding`` zeros; ``t`` from :func:`mpeg2_tables`."""
    crc, i, end = _ONES, np.uint64(start), np.uint64(stop)
    while i + I16 <= end:
        crc = (
            t[15, data[i] ^ np.uint8(crc >> _24)]
            ^ t[14, data[i + I1] ^ np.uint8(crc >> _16)]
            ^ t[13, data[i + I2] ^ np.uint8(crc >> _8)]
            ^ t[12, data[i + I3] ^ np.uint8(crc)]
            ^ t[11, data[i + I4]]
            ^ t[10, data[i + I5]]
            ^ t[9, data[i + I6]]
            ^ t[8, data[i + I7]]
            ^ t[7, data[i + I8]]
            ^ t[6, data[i + I9]]
            ^ t[5, data[i + I10]]
            ^ t[4, data[i + I11]]
            ^ t[3, data[i + I12]]
            ^ t[2, data[i + I13]]
            ^ t[1, data[i + I14]]
            ^ t[0, data[i + I15]]
        )
        i += I16
    while i + I8 <= end:
        crc = (
            t[7, data[i] ^ np.uint8(crc >> _24)]
            ^ t[6, data[i + I1] ^ np.uint8(crc >> _16)]
            ^ t[5, data[i + I2] ^ np.uint8(crc >> _8)]
            ^ t[4, data[i + I3] ^ np.uint8(crc)]
            ^ t[3, data[i + I4]]
            ^ t[2, data[i + I5]]
            ^ t[1, data[i + I6]]
            ^ t[0, data[i + I7]]
        )
        i += I8
    while i < end:
        crc = t[0, data[i] ^ np.uint8(crc >> _24)] ^ np.uint32(crc << _8)
        i += I1
    for _ in range(padding):
        crc = t[0, np.uint8(crc >> _24)] ^ np.uint32(crc << _8)
    return crc


@compiled_inline
def little_u32(data: Bytes, start: Place) -> np.uint32:
    """Return the four bytes from ``start`` on as a little-endian number."""
    i = np.uint64(start)
    low = np.uint32(data[i]) | (np.uint32(data[i + I1]) << _8)
    return np.uint32(low | (np.uint32(data[i + I2]) << _16) | (np.uint32(data[i + I3]) << _24))


@compiled_inline
def big_u32(data: Bytes, start: Place) -> np.uint32:
    """Return the four bytes from ``start`` on as a big-endian number."""
    i = np.uint64(start)
    high = (np.uint32(data[i]) << _24) | (np.uint32(data[i + I1]) << _16)
    return np.uint32(high | (np.uint32(data[i + I2]) << _8) | np.uint32(data[i + I3]))


@compiled_inline
def little_u64(data: Bytes, start: Place) -> np.uint64:
    """Return the eight bytes from ``start`` on as a little-endian number."""
    return np.uint64(little_u32(data, start)) | (np.uint64(little_u32(data, start + 4)) << np.uint64(32))


@compiled_inline
def byte_sum(data: Bytes, start: Place, stop: Place) -> np.uint8:
    """Return the sum of bytes, modulo 256."""
    total: Place = 0
    for place in range(start, stop):
        total += np.int64(data[place])
    return np.uint8(total & 255)


@compiled_inline
def word_sum(data: Bytes, start: Place, stop: Place) -> np.uint16:
    """Return the sum of little-endian 16-bit words, modulo 65536."""
    total: Place = 0
    for place in range(start, stop):
        total += np.int64(data[place]) << (8 * ((place - start) & 1))
    return np.uint16(total & 65535)
