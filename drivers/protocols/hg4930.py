"""Honeywell HG4930: control and inertial messages, encoder."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers.layout import Checksum, FrameLayout, Head
from drivers.protocols.base import NEED_MORE, NOT_A_FRAME, Buffer, Decoded, Decoder, Frame, Protocol
from drivers.protocols.checksums import word_sum
from drivers.protocols.options import choice
from drivers.protocols.readings import (
    GYRO_AXES,
    Readings,
    add,
    arrivals,
    axis_flags,
    encoding_intervals_s,
    first_bytes,
    flags,
    repeats,
    table,
)
from drivers.protocols.timelines import CounterTimeline
from drivers.samples import SampleArray, Status

ADDRESS = 0x0E
CONTROL, INERTIAL = 0x01, 0x02
SLOT_RATE_HZ = 600.0
"""Messages a second; every sixth is an inertial one."""
SLOTS = 6
_FOOT_M = 0.3048
RATE_LSB_RADPS = 600 * 2.0**-20
ACCEL_LSB_MPS2 = 600 * 2.0**-14 * _FOOT_M
ANGLE_LSB_RAD = 2.0**-33
VELOCITY_LSB_MPS = 2.0**-27 * _FOOT_M
POWER_UP = 0x5555
"""What sensor fields hold until the power-up self-test is over."""
_CONTROL = [("address", "u1"), ("kind", "u1"), ("rate", "<i2", (3,)), ("accel", "<i2", (3,)), ("status", "<u2", (2,))]
LAYOUTS = {
    CONTROL: np.dtype([*_CONTROL, ("sum", "<u2")]),
    INERTIAL: np.dtype([*_CONTROL, ("dtheta", "<i4", (3,)), ("dv", "<i4", (3,)), ("sum", "<u2")]),
}
# Polarity as in the parser that Honeywell gives out for its HGuide units: in word 1 failures of unit, gyros,
# accelerometers, gyro test and unit test are set bits, and so is each gyro axis that is valid; in word 2 failures of
# process, memory, electronics, gyros (two) and accelerometers are.
_UNIT = 0x0010
_FAILED = (0x80F0, 0x7D00)
_CONTINUOUS_TEST = 0x0004
_GYRO_VALID = np.array([0x0100, 0x0200, 0x0400])
_TEMPERATURE_SHOWN = 0x8000


class Hg4930(Protocol):
    """Messages of the HG4930.

    Parameters
    ----------
    message : inertial (100 Hz, increments) or control (600 Hz, rates; each inertial message holds one too): what
        samples are made of.

    Raises
    ------
    ProtocolError
        An option's value is not legal.
    """

    name: ClassVar[str] = "hg4930"
    bit_rates: ClassVar[tuple[int, ...]] = (1_000_000,)
    checksum_bits: ClassVar[int] = 16
    sync = (bytes([ADDRESS, CONTROL]), bytes([ADDRESS, INERTIAL]))
    longest = LAYOUTS[INERTIAL].itemsize

    def __init__(self, *, message: object = "inertial") -> None:
        self.message = choice("message", message, ("inertial", "control"))
        self.rates_hz = (SLOT_RATE_HZ / SLOTS,) if self.message == "inertial" else (SLOT_RATE_HZ,)

    def measure(self, data: Buffer, start: int, stop: int) -> int:
        """Return the length that the message number stands for."""
        if stop - start < 2:
            return NEED_MORE
        layout = LAYOUTS.get(data[start + 1])
        return NOT_A_FRAME if layout is None else layout.itemsize

    def check(self, data: Buffer, start: int, stop: int) -> bool:
        """Compare the sum of words."""
        return word_sum(data[start : stop - 2]) == int.from_bytes(data[stop - 2 : stop], "little")

    def layout(self) -> FrameLayout:
        """Return the two kinds of message as a table."""
        heads = [Head(bytes([ADDRESS, kind]), layout.itemsize) for kind, layout in LAYOUTS.items()]
        return FrameLayout(tuple(heads), Checksum.WORD_SUM_LITTLE, 2)

    def decoder(self) -> Decoder:
        """Return a decoder; it remembers the counter."""
        return HgDecoder(self.message)

    def encode_samples(self, samples: SampleArray) -> bytes:
        """Return messages of the kind chosen, alone: inertial ones at 100 Hz, or control ones at 600 Hz."""
        inertial = self.message == "inertial"
        kind = INERTIAL if inertial else CONTROL
        nominal_s = (SLOTS if inertial else 1) / SLOT_RATE_HZ
        interval_s = encoding_intervals_s(samples, nominal_s)[:, None]
        frames = np.zeros(len(samples), LAYOUTS[kind])
        frames["address"], frames["kind"] = ADDRESS, kind
        frames["rate"] = _limited(samples["dtheta"] / interval_s / RATE_LSB_RADPS, 15)
        frames["accel"] = _limited(samples["dv"] / interval_s / ACCEL_LSB_MPS2, 15)
        starting = (samples["status"] & Status.START_UP) != 0
        frames["rate"][starting] = frames["accel"][starting] = POWER_UP
        if inertial:
            frames["dtheta"] = _limited(samples["dtheta"] / ANGLE_LSB_RAD, 31)
            frames["dv"] = _limited(samples["dv"] / VELOCITY_LSB_MPS, 31)
            frames["dtheta"][starting] = frames["dv"][starting] = POWER_UP << 16 | POWER_UP
        slots = samples["sequence"].astype(np.int64) * (SLOTS if inertial else 1)
        good = (samples["status"][:, None] & GYRO_AXES) == 0
        failed = (samples["status"] & Status.SELF_TEST_FAILED) != 0
        frames["status"][:, 0] = slots % 4 + (good * _GYRO_VALID).sum(axis=1) + failed * _UNIT
        frames["status"][:, 0] += ~starting * np.uint16(_CONTINUOUS_TEST)
        celsius = np.clip(np.rint(np.nan_to_num(samples["temperature"][:, 0])), -128, 127).astype(np.int64)
        frames["status"][:, 1] = _TEMPERATURE_SHOWN | celsius & 0xFF
        octets = frames.view(np.uint8).reshape(len(frames), frames.dtype.itemsize)
        frames["sum"] = octets[:, :-2].copy().view("<u2").sum(axis=1) & 0xFFFF
        return frames.tobytes()


def _limited(counts: NDArray[np.float64], bits: int) -> NDArray[np.float64]:
    """Return whole counts within a signed field."""
    return np.clip(np.rint(counts), -(2**bits), 2**bits - 1)


class HgDecoder(Decoder):
    """Messages of the kind chosen to samples; the others only count."""

    def __init__(self, message: str) -> None:
        self._inertial = message == "inertial"
        # Inertial messages are six slots apart, which the two-bit counter shows as two: its upper bit counts them.
        modulus, tick_s = (2, SLOTS / SLOT_RATE_HZ) if self._inertial else (4, 1 / SLOT_RATE_HZ)
        self._timeline = CounterTimeline(modulus, tick_s, 1.0)
        self._celsius = np.nan
        self._before = b""
        self._starting = True

    def decode(self, frames: Sequence[Frame]) -> Decoded:
        """Decode all messages of the kind together."""
        decoded = Decoded()
        if not len(frames):
            return decoded
        kind = INERTIAL if self._inertial else CONTROL
        kinds = first_bytes(frames, 1)
        run = np.flatnonzero(kinds == kind) if self._inertial else np.arange(len(frames))
        if len(run):
            self._decode(table(frames, run, 0, LAYOUTS[kind].itemsize), kind, run, arrivals(frames)[run], decoded)
        return decoded

    def _decode(
        self,
        rows: NDArray[np.uint8],
        kind: int,
        run: NDArray[np.intp],
        host_s: NDArray[np.float64],
        decoded: Decoded,
    ) -> None:
        frames = np.ascontiguousarray(rows).view(LAYOUTS[kind])[:, 0]
        same = repeats(rows, self._before)
        self._before = rows[-1].tobytes()
        starting = np.concatenate([frames["rate"], frames["accel"]], axis=1).view(np.uint16) == POWER_UP
        starting = starting.all(axis=1)
        status = _conditions(frames["status"].astype(np.int64)) | flags(starting, Status.START_UP)
        gyro, accel = frames["rate"] * RATE_LSB_RADPS, frames["accel"] * ACCEL_LSB_MPS2
        count = frames["status"][:, 0].astype(np.int64) % 4
        if self._inertial:
            gyro, accel, count = frames["dtheta"] * ANGLE_LSB_RAD, frames["dv"] * VELOCITY_LSB_MPS, count >> 1
        gyro[starting] = accel[starting] = 0.0
        readings = Readings(
            frame=run,
            host_s=host_s,
            gyro=gyro,
            accel=accel,
            temperature=self._temperatures(frames["status"][:, 1])[:, None],
            status=status,
            count=count,
            stamp=np.zeros(len(rows), np.int64),
            same=same,
            gyro_is_rate=not self._inertial,
            accel_is_rate=not self._inertial,
        )
        if starting[0] and not self._starting:
            self._timeline.restart()
        self._starting = bool(starting[-1])
        add(decoded, readings, self._timeline.place(count, host_s, same, self.host_latency_s))

    def _temperatures(self, words: NDArray[np.uint16]) -> NDArray[np.float64]:
        """Return the die temperature [°C], which some messages show; the others keep the last one."""
        celsius = np.where(words & _TEMPERATURE_SHOWN, (words & 0xFF).astype(np.uint8).view(np.int8), np.nan)
        if np.isnan(celsius[0]):
            celsius[0] = self._celsius
        celsius = celsius[np.maximum.accumulate(np.where(np.isnan(celsius), 0, np.arange(len(celsius))))]
        self._celsius = float(celsius[-1])
        return celsius


def _conditions(words: NDArray[np.int64]) -> NDArray[np.uint32]:
    """Return the named conditions of both status words (n, 2)."""
    status = axis_flags((words[:, :1] & _GYRO_VALID) == 0, GYRO_AXES)
    return status | flags(((words & _FAILED) != 0).any(axis=1), Status.SELF_TEST_FAILED)
