"""What is on a line: bit rates and protocols tried on the bytes that come, and how sure the answer is."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol as Interface

import serial

from drivers.framing import Splitter
from drivers.protocols import get_protocol, protocol_names
from drivers.protocols.base import Protocol

LISTEN_S = 1.5
"""How long [real s] each bit rate is listened to: an idle block of ours speaks once a second."""
ENOUGH_BYTES = 8192
"""No more bytes are waited for."""
SURE = 0.95
"""A candidate this sure ends the search."""
CHANCE = 1e-6
"""Frames that random bytes would hold with a probability above this are no evidence."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """What may be on the line: ``confidence`` from 0 to 1, and the ``evidence`` for it in words."""

    protocol: str
    bit_rate: int
    confidence: float
    evidence: str


class Port(Interface):
    """What is needed of an open port."""

    def read(self, size: int) -> bytes:
        """Return what comes, at most ``size`` bytes, or nothing after a short while."""

    def close(self) -> None:
        """Let go."""


Opener = Callable[[str, int], Port]


def open_serial(url: str, bit_rate: int) -> Port:
    """Open any pyserial URL for a detection.

    Raises
    ------
    OSError, ValueError
        The port is not there, or cannot be set to that bit rate.
    """
    port: Port = serial.serial_for_url(url, bit_rate, timeout=0.05)
    return port


def detect(
    url: str,
    *,
    protocols: Iterable[str] | None = None,
    bit_rates: Iterable[int] | None = None,
    listen_s: float = LISTEN_S,
    open_port: Opener = open_serial,
) -> list[Candidate]:
    """Listen to a line and say what is on it, the surest first; empty where nothing known is.

    Parameters
    ----------
    url : device path or pyserial URL.
    protocols : names to try; default all that are known.
    bit_rates : to try; default those of the protocols, the commonest first.
    listen_s : how long to listen at each bit rate [real s].
    open_port : opens the line at a bit rate.

    Raises
    ------
    OSError
        The port cannot be opened at any bit rate.
    ProtocolError
        A protocol is not known.

    Notes
    -----
    Nothing is sent. At a wrong bit rate a line reads as garbage, in which no checksum holds. A pseudo-terminal or a
    network line reads the same at any: there the first one is named.
    """
    kinds = [get_protocol(name) for name in (protocols or protocol_names())]
    found: list[Candidate] = []
    problem: Exception | None = None
    opened = False
    for bit_rate in bit_rates or common_bit_rates(kinds):
        try:
            port = open_port(url, bit_rate)
        except (OSError, ValueError) as error:
            problem = error
            continue
        opened = True
        try:
            data = _listen(port, listen_s)
        finally:
            with contextlib.suppress(OSError):
                port.close()
        found += [one for kind in kinds if (one := judge(data, kind, bit_rate)) is not None]
        if any(one.confidence >= SURE for one in found):
            break
    if not opened and problem is not None:
        raise OSError(f"{url}: cannot be opened: {problem}. Give a port that is there and not in use.") from None
    return sorted(found, key=lambda one: -one.confidence)


def common_bit_rates(kinds: Iterable[Protocol]) -> list[int]:
    """Return the bit rates of protocols, those that most of them use first."""
    votes: dict[int, float] = {}
    for kind in kinds:
        for place, bit_rate in enumerate(kind.bit_rates):
            votes[bit_rate] = votes.get(bit_rate, 0.0) + 1.0 / (1 + place)
    return sorted(votes, key=lambda bit_rate: -votes[bit_rate])


def _listen(port: Port, listen_s: float) -> bytes:
    """Return what comes until there is enough or the time is up."""
    data = bytearray()
    deadline = time.monotonic() + listen_s
    while len(data) < ENOUGH_BYTES and time.monotonic() < deadline:
        data += port.read(ENOUGH_BYTES - len(data))
    return bytes(data)


def judge(data: bytes, protocol: Protocol, bit_rate: int = 0) -> Candidate | None:
    """Return how well bytes agree with a protocol; None where they hold no more frames than chance would make.

    Frames count when their checksum holds. The confidence is the share of the bytes that whole frames explain, the
    cut ones at both ends left out, less what chance could do.
    """
    splitter = Splitter(protocol)
    frames = splitter.feed(data, 0.0) + splitter.restart(0.0)
    if not frames:
        return None
    by_chance = _log_probability(len(frames), expected_by_chance(len(data), protocol))
    if by_chance > math.log(CHANCE):
        return None
    size = sum(len(frame.data) for frame in frames)
    first, last = data.find(frames[0].data), data.rfind(frames[-1].data) + len(frames[-1].data)
    ends = sum(part for part in (first, len(data) - last) if part < protocol.longest)
    share = size / (len(data) - ends)
    text = f"{len(frames)} frames with a good checksum, {share:.1%} of {len(data)} bytes"
    if splitter.counters.crc_failures:
        text += f", {splitter.counters.crc_failures} bad checksums"
    return Candidate(protocol.name, bit_rate, round(min(1.0, share) * (1 - math.exp(by_chance)), 3), text)


def expected_by_chance(size: int, protocol: Protocol) -> float:
    """Return how many frames random bytes hold: places where a sync and then a checksum agree."""
    at_one_place = math.fsum(2.0 ** (-8 * len(sync)) for sync in protocol.sync)
    return size * at_one_place * 2.0**-protocol.checksum_bits


def _log_probability(count: int, expected: float) -> float:
    """Return the logarithm of a bound on the probability of ``count`` or more where ``expected`` are expected."""
    if expected <= 0 or count <= expected:
        return 0.0
    return count - expected + count * math.log(expected / count)  # Chernoff's bound of a Poisson tail
