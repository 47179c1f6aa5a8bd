"""NovAtel binary messages, for the splitter alone: long (AA 44 12) and short (AA 44 13) headers."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from typing import ClassVar

from drivers.protocols.base import NEED_MORE, NOT_A_FRAME, Buffer, Decoded, Decoder, Frame, Protocol, ProtocolError
from drivers.samples import SampleArray

LONG, SHORT = bytes.fromhex("aa4412"), bytes.fromhex("aa4413")
_SHORT_HEADER = 12
_CRC = 4


class NovAtel(Protocol):
    """Messages told from anything else; what they say is not read."""

    name: ClassVar[str] = "novatel"
    bit_rates: ClassVar[tuple[int, ...]] = (115200, 230400, 460800, 921600)
    sync = (LONG, SHORT)
    longest = 255 + 65535 + _CRC

    def measure(self, data: Buffer, start: int, stop: int) -> int:
        """Return the length of header, body and CRC."""
        if stop - start < 10:
            return NEED_MORE
        if data[start + 2] == SHORT[2]:
            return _SHORT_HEADER + data[start + 3] + _CRC
        header = data[start + 3]
        if header < 28:
            return NOT_A_FRAME
        return header + int.from_bytes(data[start + 8 : start + 10], "little") + _CRC

    def check(self, data: Buffer, start: int, stop: int) -> bool:
        """Compare the CRC-32 whose initial value and final XOR are 0."""
        crc = zlib.crc32(data[start : stop - _CRC], 0xFFFFFFFF) ^ 0xFFFFFFFF
        return crc == int.from_bytes(data[stop - _CRC : stop], "little")

    def decoder(self) -> Decoder:
        """Return a decoder that rejects every message: only the splitter is for these."""
        return _NoDecoder()

    def encode_samples(self, samples: SampleArray) -> bytes:
        """Refuse.

        Raises
        ------
        ProtocolError
            Always.
        """
        raise ProtocolError(f"protocol novatel only splits; it cannot send {len(samples)} samples")


class _NoDecoder(Decoder):
    def decode(self, frames: Sequence[Frame]) -> Decoded:
        """Reject."""
        return Decoded(rejects=len(frames))
