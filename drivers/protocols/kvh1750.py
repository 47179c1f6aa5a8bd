"""KVH 1725, 1750 and 1775: formats A, B and C, self-test frames, encoder."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers.layout import Checksum, FrameLayout, Head
from drivers.messages import Message, Received, SelfTestResult
from drivers.protocols.base import NEED_MORE, NOT_A_FRAME, Buffer, Decoded, Decoder, Frame, Protocol
from drivers.protocols.checksums import crc32_mpeg2
from drivers.protocols.options import choice, positive
from drivers.protocols.readings import (
    ACCEL_AXES,
    GYRO_AXES,
    STANDARD_GRAVITY_MPS2,
    Readings,
    add,
    arrivals,
    axis_flags,
    encoding_intervals_s,
    first_bytes,
    floats,
    repeats,
    table,
)
from drivers.protocols.timelines import ClockTimeline, HostTimeline
from drivers.samples import SampleArray, Status

HEADER = bytes.fromhex("fe81ff")
SELF_TEST = bytes.fromhex("fe8100")
_HEAD = [("header", "S4"), ("rotation", ">f4", (3,)), ("acceleration", ">f4", (3,))]
_TAIL = [("status", "u1"), ("sequence", "u1")]
FORMATS = {
    0x55: np.dtype([*_HEAD, *_TAIL, ("temperature", ">i2"), ("crc", "S4")]),
    0x56: np.dtype([*_HEAD, ("time_us", ">u4"), *_TAIL, ("temperature", ">i2"), ("crc", "S4")]),
    0x57: np.dtype([*_HEAD, ("selected", ">f4"), *_TAIL, ("crc", "S4")]),
}
LETTERS = {"A": 0x55, "B": 0x56, "C": 0x57}
SELF_TESTS = {0xAA: 11, 0xAB: 13}
"""Length of a self-test frame by its last header byte: six results, or eight; public drivers read both."""
PASSED = 0x7F
COUNTER_MODULUS = 128
FACTORY_RATE_HZ = 1000.0


class Kvh1750(Protocol):
    """Frames of KVH's fibre-optic units.

    Parameters
    ----------
    gyro_output, accel_output : rate or incremental, as the unit is configured: frames do not say.
    angle_unit : rad or deg.
    rate_hz : that the unit is set to; checked against the host's clock, and never integrated with. Formats A and C
        carry no time: there the rate is measured by the host's clock.
    format : what the encoder sends: A, B or C.

    Raises
    ------
    ProtocolError
        An option's value is not legal.
    """

    name: ClassVar[str] = "kvh1750"
    sync = tuple(HEADER + bytes([last]) for last in FORMATS) + tuple(SELF_TEST + bytes([last]) for last in SELF_TESTS)
    longest = max(kind.itemsize for kind in FORMATS.values())

    def __init__(
        self,
        *,
        gyro_output: object = "rate",
        accel_output: object = "rate",
        angle_unit: object = "rad",
        rate_hz: object = None,
        format: object = "A",
    ) -> None:
        self.gyro_output = choice("gyro_output", gyro_output, ("rate", "incremental"))
        self.accel_output = choice("accel_output", accel_output, ("rate", "incremental"))
        self.angle_scale = 1.0 if choice("angle_unit", angle_unit, ("rad", "deg")) == "rad" else np.pi / 180
        self.accel_scale = 1.0 if self.accel_output == "incremental" else STANDARD_GRAVITY_MPS2
        self.rate_hz = positive("rate_hz", rate_hz)
        self._format = LETTERS[choice("format", format, LETTERS)]

    def measure(self, data: Buffer, start: int, stop: int) -> int:
        """Return the length that the header stands for."""
        if stop - start < 4:
            return NEED_MORE
        last = data[start + 3]
        if data[start + 2] == HEADER[2]:
            return FORMATS[last].itemsize if last in FORMATS else NOT_A_FRAME
        return SELF_TESTS.get(last, NOT_A_FRAME)

    def check(self, data: Buffer, start: int, stop: int) -> bool:
        """Compare the CRC of data, the byte sum of a self-test."""
        if data[start + 2] == SELF_TEST[2]:
            return sum(data[start : stop - 1]) & 0xFF == data[stop - 1]
        return crc32_mpeg2(data[start : stop - 4]) == data[stop - 4 : stop]

    def layout(self) -> FrameLayout:
        """Return the headers as a table."""
        data = [Head(HEADER + bytes([last]), kind.itemsize) for last, kind in FORMATS.items()]
        tests = [
            Head(SELF_TEST + bytes([last]), length, checksum=Checksum.BYTE_SUM) for last, length in SELF_TESTS.items()
        ]
        return FrameLayout((*data, *tests), Checksum.CRC32_MPEG2_BIG, len(HEADER) + 1)

    def decoder(self) -> Decoder:
        """Return a decoder; it remembers counters and clock."""
        return KvhDecoder(self)

    def encode_samples(self, samples: SampleArray) -> bytes:
        """Return data frames in the format chosen."""
        interval_s = encoding_intervals_s(samples, 1.0 / (self.rate_hz or FACTORY_RATE_HZ))[:, None]
        frames = np.zeros(len(samples), FORMATS[self._format])
        frames["header"] = HEADER + bytes([self._format])
        rotation = samples["dtheta"] if self.gyro_output == "incremental" else samples["dtheta"] / interval_s
        velocity = samples["dv"] if self.accel_output == "incremental" else samples["dv"] / interval_s
        frames["rotation"] = rotation / self.angle_scale
        frames["acceleration"] = velocity / self.accel_scale
        good_gyro = ((samples["status"][:, None] & GYRO_AXES) == 0) * np.array([1, 2, 4])
        good_accel = ((samples["status"][:, None] & ACCEL_AXES) == 0) * np.array([16, 32, 64])
        frames["status"] = good_gyro.sum(axis=1) + good_accel.sum(axis=1)
        frames["sequence"] = samples["sequence"] % COUNTER_MODULUS
        celsius = np.nan_to_num(samples["temperature"][:, 0].astype(np.float64))
        if self._format == LETTERS["C"]:
            frames["selected"] = np.where(frames["sequence"] % 4 == 0, celsius, 0.0)
        else:
            frames["temperature"] = np.clip(np.rint(celsius), -(2**15), 2**15 - 1)
        if self._format == LETTERS["B"]:
            frames["time_us"] = np.rint(samples["time"] * 1e6) % 2**32
        size = frames.dtype.itemsize - 4
        bodies = [row.tobytes()[:size] for row in frames]
        return b"".join(body + crc32_mpeg2(body) for body in bodies)

    def encode_message(self, message: Message, sequence: int = 0, time_s: float = 0.0) -> bytes:
        """Return the self-test frame of a self-test result."""
        if not isinstance(message, SelfTestResult):
            return super().encode_message(message, sequence, time_s)
        frame = SELF_TEST + b"\xaa" + bytes([PASSED if message.passed else 0] + [PASSED] * 5)
        return frame + bytes([sum(frame) & 0xFF])


class KvhDecoder(Decoder):
    """Data frames to samples, self-test frames to results."""

    def __init__(self, protocol: Kvh1750) -> None:
        self._protocol = protocol
        self.stated_rate_hz = protocol.rate_hz
        self._kind = -1
        self._timeline: HostTimeline | ClockTimeline
        self._held: Readings | None = None
        self._before = b""
        self._celsius = np.nan

    def decode(self, frames: Sequence[Frame]) -> Decoded:
        """Decode runs of one format together."""
        decoded = Decoded()
        if not len(frames):
            return decoded
        kinds = first_bytes(frames, 3)
        host_s = arrivals(frames)
        for low, high in itertools.pairwise([0, *(np.flatnonzero(kinds[1:] != kinds[:-1]) + 1).tolist(), len(kinds)]):
            run, kind = np.arange(low, high), int(kinds[low])
            if kind in SELF_TESTS:
                for index in run.tolist():
                    passed = all(byte == PASSED for byte in frames[index].data[4:-1])
                    result = SelfTestResult(Status(0) if passed else Status.SELF_TEST_FAILED)
                    decoded.messages.append(Received(result, 0, 0.0, float(host_s[index])))
                continue
            if kind != self._kind:
                self._begin(kind)
            self._place(self._read(table(frames, run, 0, FORMATS[kind].itemsize), kind, run, host_s[run]), decoded)
        return decoded

    def _begin(self, kind: int) -> None:
        """Begin a line of time for frames of one format."""
        self._kind, self._held = kind, None
        if kind == LETTERS["B"]:
            self._timeline = ClockTimeline(2**32, 1e-6, COUNTER_MODULUS)
        else:
            rate_hz = self._protocol.rate_hz
            self._timeline = HostTimeline(rate_hz or FACTORY_RATE_HZ, rate_hz is not None, COUNTER_MODULUS)

    def _read(self, rows: NDArray[np.uint8], kind: int, run: NDArray[np.intp], host_s: NDArray[np.float64]) -> Readings:
        """Return the readings of data frames in SI."""
        frames = np.ascontiguousarray(rows).view(FORMATS[kind])[:, 0]
        same = repeats(rows, self._before)
        self._before = rows[-1].tobytes()
        status = _CONDITIONS[frames["status"]]
        count = frames["sequence"].astype(np.int64)
        stamp = frames["time_us"].astype(np.int64) if kind == LETTERS["B"] else np.zeros(len(rows), np.int64)
        celsius = self._selected(frames) if kind == LETTERS["C"] else frames["temperature"].astype(np.float64)
        readings = Readings(
            frame=run,
            host_s=host_s,
            gyro=floats(frames["rotation"]) * self._protocol.angle_scale,
            accel=floats(frames["acceleration"]) * self._protocol.accel_scale,
            temperature=celsius[:, None],
            status=status,
            count=count,
            stamp=stamp,
            same=same,
            gyro_is_rate=self._protocol.gyro_output == "rate",
            accel_is_rate=self._protocol.accel_output == "rate",
        )
        readings.drop_what_is_no_number()
        return readings

    def _selected(self, frames: NDArray[np.void]) -> NDArray[np.float64]:
        """Return the temperature that format C sends with every fourth frame, kept for the other three."""
        celsius = np.where(frames["sequence"] % 4 == 0, floats(frames["selected"]), np.nan)
        if np.isnan(celsius[0]):
            celsius[0] = self._celsius
        newest = np.maximum.accumulate(np.where(np.isnan(celsius), 0, np.arange(len(celsius))))
        celsius = celsius[newest]
        self._celsius = float(celsius[-1])
        return celsius

    def _place(self, readings: Readings, decoded: Decoded) -> None:
        """Give readings their time and interval, and append them."""
        if self._held is not None:
            readings, self._held = readings.behind(self._held), None
        if isinstance(self._timeline, HostTimeline):
            placed = self._timeline.place(readings.count, readings.host_s, readings.same, self.host_latency_s)
        elif len(readings) == 1 and not self._timeline.interval_known:
            self._held = readings
            return
        else:
            placed = self._timeline.place(readings.stamp, readings.count, readings.host_s)
        add(decoded, readings, placed)


_BYTES = np.arange(256)[:, None]
_CONDITIONS = axis_flags(_BYTES & [1, 2, 4] == 0, GYRO_AXES) | axis_flags(_BYTES & [16, 32, 64] == 0, ACCEL_AXES)
"""Named conditions of each status byte: an axis is valid while its bit is set."""
