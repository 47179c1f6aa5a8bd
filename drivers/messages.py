"""What a block and its host say to each other besides samples, whatever the protocol."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum

from drivers.samples import Status

Vector = tuple[float, float, float]

GYRO_KINDS = ("", "dtg", "laser", "fibre", "mems")
"""Kinds of gyro by their number on the line; the first is unknown."""


class Outcome(IntEnum):
    """What became of a command."""

    DONE = 0
    UNKNOWN_COMMAND = 1
    BAD_ARGUMENT = 2
    NOT_NOW = 3
    STORAGE_FAULT = 4


@dataclass(frozen=True, slots=True)
class Identity:
    """Who the block is; sent at power-up and on request. Texts are ASCII, 16 characters at most."""

    model: str
    serial: str
    firmware: str
    gyro_kind: str = ""


@dataclass(frozen=True, slots=True)
class Configuration:
    """How the block is set; sent at power-up, after a change of rate and on request."""

    sample_rate_hz: float
    bit_rate: int
    accel_range_mps2: float
    gyro_range_radps: float
    streaming: bool


@dataclass(frozen=True, slots=True)
class SelfTestResult:
    """Outcome of a self-test: the conditions found, none when it passed."""

    status: Status

    @property
    def passed(self) -> bool:
        """Whether nothing was found."""
        return self.status == Status(0)


@dataclass(frozen=True, slots=True)
class Acknowledgement:
    """What became of a command; ``command`` is its class name here, empty when the block knows no such command."""

    command: str
    outcome: Outcome


@dataclass(frozen=True, slots=True)
class Compensation:
    """Terms that the block keeps: added to the readings by whoever uses them, never by the block.

    ``f_mps2`` [m/s²] and ``g_radps`` [rad/s] in body axes (paper eqs 8, 9), ``writes`` the count of writes in the
    block's life, ``crc`` what the block stored with the terms.
    """

    f_mps2: Vector
    g_radps: Vector
    writes: int
    crc: int

    @property
    def intact(self) -> bool:
        """Whether the terms still match the CRC they were stored with."""
        return self.crc == terms_crc(self.f_mps2, self.g_radps)


@dataclass(frozen=True, slots=True)
class Start:
    """Send samples."""


@dataclass(frozen=True, slots=True)
class Stop:
    """Send no more samples."""


@dataclass(frozen=True, slots=True)
class SelfTest:
    """Test yourself; acknowledged at once, a :class:`SelfTestResult` follows."""


@dataclass(frozen=True, slots=True)
class SetRate:
    """Change the sample rate [Hz]."""

    rate_hz: float


@dataclass(frozen=True, slots=True)
class WriteCompensation:
    """Keep these terms ([m/s²], [rad/s], body)."""

    f_mps2: Vector
    g_radps: Vector


@dataclass(frozen=True, slots=True)
class ReadCompensation:
    """Send the terms you keep: answered by :class:`Compensation`."""


@dataclass(frozen=True, slots=True)
class ReadIdentity:
    """Say who you are: answered by :class:`Identity`."""


@dataclass(frozen=True, slots=True)
class ReadConfiguration:
    """Say how you are set: answered by :class:`Configuration`."""


Command = Start | Stop | SelfTest | SetRate | WriteCompensation | ReadCompensation | ReadIdentity | ReadConfiguration
Message = Identity | Configuration | SelfTestResult | Acknowledgement | Compensation | Command


@dataclass(frozen=True, slots=True)
class Received:
    """One message off the line.

    ``sequence`` is the number of the command that it is or answers, 0 when nobody asked; ``time_s`` the sender's
    clock [s]; ``host_time_s`` when its last byte arrived.
    """

    message: Message
    sequence: int
    time_s: float
    host_time_s: float


def pack_terms(f_mps2: Vector, g_radps: Vector) -> bytes:
    """Return the six terms as the 48 bytes (little-endian doubles) that blocks keep and sign."""
    return struct.pack("<6d", *f_mps2, *g_radps)


def terms_crc(f_mps2: Vector, g_radps: Vector) -> int:
    """Return the CRC-32 that a block stores with its terms."""
    return zlib.crc32(pack_terms(f_mps2, g_radps))
