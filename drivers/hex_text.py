"""Bytes written as hexadecimal text: digits in pairs, any white space between them, ``#`` begins a remark."""

from __future__ import annotations

from pathlib import Path


class HexTextError(ValueError):
    """A text is not hexadecimal: which file, which line, what to do."""


def looks_like_hex(head: bytes) -> bool:
    """Return whether a file that begins with ``head`` is hexadecimal text."""
    lines = [line.partition(b"#")[0] for line in head.splitlines()]
    digits = b"".join(b"".join(lines).split())
    return bool(digits) and all(byte in b"0123456789abcdefABCDEF" for byte in digits)


def read_hex(path: Path) -> bytes:
    """Return the bytes of a hexadecimal text.

    Raises
    ------
    HexTextError
        A line holds something else, or half a byte.
    OSError
        The file cannot be read.
    """
    found = bytearray()
    for number, line in enumerate(path.read_bytes().splitlines(), start=1):
        digits = b"".join(line.partition(b"#")[0].split())
        try:
            found += bytes.fromhex(digits.decode("ascii"))
        except ValueError:  # UnicodeDecodeError is one
            reason = "an odd number of digits" if len(digits) % 2 else "something that is no hexadecimal digit"
            raise HexTextError(f"{path}: line {number} holds {reason}. Mend it, or put # before remarks.") from None
    return bytes(found)
