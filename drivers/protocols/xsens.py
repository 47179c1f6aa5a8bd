"""Xsens MTData2: packets of inertial data, encoder."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers.protocols.base import NEED_MORE, NOT_A_FRAME, Buffer, Decoded, Decoder, Frame, Protocol
from drivers.protocols.fields import Field, Fields, alike, column
from drivers.protocols.options import choice, positive, switch
from drivers.protocols.readings import Bytes, Readings, add, arrivals, encoding_intervals_s, flags, floats, repeats
from drivers.protocols.timelines import ClockTimeline, HostTimeline
from drivers.samples import SampleArray, Status

SYNC = b"\xfa\xff\x36"
EXTENDED = 0xFF
LONGEST_DATA = 2048
"""Longest data of a message, by the maker's own limit."""
PACKET_COUNTER, SAMPLE_TIME, STATUS_WORD = 0x1020, 0x1060, 0xE020
TEMPERATURE, DELTA_VELOCITY, ACCELERATION, RATE, DELTA_Q = 0x0810, 0x4010, 0x4020, 0x8020, 0x8030
VALUES = {TEMPERATURE: 1, DELTA_VELOCITY: 3, ACCELERATION: 3, RATE: 3, DELTA_Q: 4}
"""Numbers in a field whose format the low bits of its identifier choose."""
FIXED_SIZES = {PACKET_COUNTER: 2, SAMPLE_TIME: 4, STATUS_WORD: 4}
NUMBER_SIZES = (4, 4, 6, 8)
GROUPS = frozenset((0x08, 0x10, 0x20, 0x30, 0x40, 0x50, 0x70, 0x80, 0x88, 0xA0, 0xC0, 0xD0, 0xE0))
_TICK_S = 1e-4
_SELF_TEST_PASSED = 0x1
_CLIPPED = 0x3F00
FACTORY_RATE_HZ = 100.0


class Xsens(Protocol):
    """MTData2 messages.

    Parameters
    ----------
    message : what samples are made of where a message holds both, and what the encoder sends: incremental or rate.
    rate_hz : of the messages, checked against the host's clock; messages without sample time need it when there is
        no host's clock either.
    self_test_bit : whether bit 0 of the status word means anything; the MTi-600 and MTi-1 series leave it 0.

    Raises
    ------
    ProtocolError
        An option's value is not legal.
    """

    name: ClassVar[str] = "xsens"
    bit_rates: ClassVar[tuple[int, ...]] = (115200, 921600, 460800, 230400, 2000000)
    checksum_bits: ClassVar[int] = 8
    sync = (SYNC,)
    longest = 6 + LONGEST_DATA + 1

    def __init__(
        self, *, message: object = "incremental", rate_hz: object = None, self_test_bit: object = True
    ) -> None:
        self.message = choice("message", message, ("incremental", "rate"))
        self.rate_hz = positive("rate_hz", rate_hz)
        self.self_test_bit = switch("self_test_bit", self_test_bit)

    def measure(self, data: Buffer, start: int, stop: int) -> int:
        """Return the length, where the fields that are there can be and fit into it.

        The checksum is a byte and lets one false message in 256 pass; the fields let hardly any.
        """
        head = data_start(data, start, stop)
        if head == NEED_MORE:
            return NEED_MORE
        length = data[start + 3] if head == start + 4 else int.from_bytes(data[start + 4 : start + 6], "big")
        end = head + length
        if not 3 <= length <= LONGEST_DATA or (head == start + 6 and length < EXTENDED):
            return NOT_A_FRAME
        return NOT_A_FRAME if _impossible(data, head, end, stop) else end - start + 1

    def check(self, data: Buffer, start: int, stop: int) -> bool:
        """Let all behind the preamble add up to 0."""
        return sum(data[start + 1 : stop]) & 0xFF == 0

    def decoder(self) -> Decoder:
        """Return a decoder; it remembers counter and clock."""
        return XsensDecoder(self)

    def encode_samples(self, samples: SampleArray) -> bytes:
        """Return messages with packet counter, sample time, inertial data as float32, temperature and status."""
        interval_s = encoding_intervals_s(samples, 1.0 / (self.rate_hz or FACTORY_RATE_HZ))[:, None]
        if self.message == "incremental":
            inertial = ((DELTA_VELOCITY, samples["dv"]), (DELTA_Q, _quaternions(samples["dtheta"])))
        else:
            inertial = ((ACCELERATION, samples["dv"] / interval_s), (RATE, samples["dtheta"] / interval_s))
        ticks = np.rint(samples["time"] / _TICK_S).astype(np.int64) % 2**32
        word = np.where(samples["status"] & Status.SELF_TEST_FAILED, 0, _SELF_TEST_PASSED)
        word |= np.where(samples["status"] & Status.OVERLOAD, _CLIPPED, 0)
        celsius = np.nan_to_num(samples["temperature"][:, :1])
        messages = []
        for row in range(len(samples)):
            data = _field(PACKET_COUNTER, int(samples["sequence"][row] % 2**16).to_bytes(2, "big"))
            data += _field(SAMPLE_TIME, int(ticks[row]).to_bytes(4, "big"))
            data += _field(TEMPERATURE, celsius[row].astype(">f4").tobytes())
            data += b"".join(_field(kind, values[row].astype(">f4").tobytes()) for kind, values in inertial)
            data += _field(STATUS_WORD, int(word[row]).to_bytes(4, "big"))
            body = SYNC + bytes([len(data)]) + data
            messages.append(body + bytes([-sum(body[1:]) & 0xFF]))
        return b"".join(messages)


def _field(kind: int, data: bytes) -> bytes:
    return kind.to_bytes(2, "big") + bytes([len(data)]) + data


def data_start(data: Buffer, start: int, stop: int) -> int:
    """Return where the data of the message at ``start`` begin; :data:`NEED_MORE` where that cannot be told yet."""
    if stop - start < 4:
        return NEED_MORE
    if data[start + 3] != EXTENDED:
        return start + 4
    return start + 6 if stop - start >= 6 else NEED_MORE


def _impossible(data: Buffer, place: int, end: int, stop: int) -> bool:
    """Whether the fields from ``place`` on, as far as they have come, are none that a device sends."""
    seen = set()
    while place + 3 <= min(end, stop):
        kind, size = data[place] << 8 | data[place + 1], data[place + 2]
        if not _legal(kind, size) or kind & 0xFFF0 in seen:
            return True
        seen.add(kind & 0xFFF0)
        place += 3 + size
    return place > end or (place < end < place + 3)


def _legal(kind: int, size: int) -> bool:
    """Whether a field of this kind may have this size."""
    base = kind & 0xFFF0
    if base in FIXED_SIZES:
        return size == FIXED_SIZES[base]
    if base in VALUES:
        return size == VALUES[base] * NUMBER_SIZES[kind & 3]
    return kind >> 8 & 0xF8 in GROUPS and size > 0


def fields_of(data: bytes) -> Fields:
    """Return the fields of a whole message."""
    fields, place = [], data_start(data, 0, len(data))
    while place < len(data) - 1:
        fields.append(Field(data[place] << 8 | data[place + 1], place + 3, place + 3 + data[place + 2]))
        place = fields[-1].stop
    return tuple(fields)


def numbers(rows: Bytes, field: Field) -> NDArray[np.float64]:
    """Return the values (n, k) of a field in the format that its identifier chooses."""
    match field.kind & 3:
        case 0:
            return floats(column(rows, field, ">f4"))
        case 1:
            return column(rows, field, ">i4").astype(np.float64) * 2.0**-20
        case 3:
            return floats(column(rows, field, ">f8"))
    octets = np.ascontiguousarray(rows[:, field.start : field.stop]).reshape(len(rows), -1, 6)
    fraction = np.ascontiguousarray(octets[:, :, :4]).view(">u4")[:, :, 0]
    whole = np.ascontiguousarray(octets[:, :, 4:]).view(">i2")[:, :, 0]
    fixed: NDArray[np.float64] = whole + fraction * 2.0**-32
    return fixed


class XsensDecoder(Decoder):
    """Messages to samples; those without inertial data are rejected and counted."""

    def __init__(self, protocol: Xsens) -> None:
        self._protocol = protocol
        self.stated_rate_hz = protocol.rate_hz
        self._timeline: ClockTimeline | HostTimeline | None = None
        self._held: Readings | None = None
        self._before = b""
        self._others = 0  # messages without inertial data so far; the packet counter counts them too

    def decode(self, frames: Sequence[Frame]) -> Decoded:
        """Decode runs of messages with the same fields together."""
        decoded = Decoded()
        host_s = arrivals(frames)
        for fields, run, rows in alike(frames, fields_of):
            by_kind = {field.kind & 0xFFF0: field for field in fields}
            sources = _sources(by_kind, self._protocol.message)
            if sources is None:
                decoded.rejects += len(run)
                self._others += len(run) * (PACKET_COUNTER in by_kind)
            else:
                self._place(self._read(rows, run, host_s[run], by_kind, *sources), by_kind, decoded)
        return decoded

    def _place(self, readings: Readings, by_kind: dict[int, Field], decoded: Decoded) -> None:
        """Give readings their time and interval, and append them."""
        timed, counted = SAMPLE_TIME in by_kind, PACKET_COUNTER in by_kind
        if self._timeline is None or isinstance(self._timeline, ClockTimeline) != timed:
            modulus, rate_hz = 2**16 if counted else None, self._protocol.rate_hz
            by_host = partial(HostTimeline, rate_hz or FACTORY_RATE_HZ, rate_hz is not None, modulus or 1)
            self._timeline, self._held = ClockTimeline(2**32, _TICK_S, modulus) if timed else by_host(), None
        if self._held is not None:
            readings, self._held = readings.behind(self._held), None
        if isinstance(self._timeline, HostTimeline):
            placed = self._timeline.place(readings.count, readings.host_s, readings.same, self.host_latency_s)
        elif len(readings) == 1 and not self._timeline.interval_known:
            self._held = readings
            return
        else:
            placed = self._timeline.place(readings.stamp, readings.count if counted else None, readings.host_s)
        add(decoded, readings, placed)

    def _read(
        self,
        rows: Bytes,
        run: NDArray[np.intp],
        host_s: NDArray[np.float64],
        by_kind: dict[int, Field],
        gyro: int,
        accel: int,
    ) -> Readings:
        """Return the readings of like messages in SI."""
        same = repeats(rows, self._before)
        self._before = rows[-1].tobytes()

        def whole(kind: int, dtype: str) -> NDArray[np.int64]:
            if kind not in by_kind:
                return np.zeros(len(rows), np.int64)
            return column(rows, by_kind[kind], dtype)[:, 0].astype(np.int64)

        turned = numbers(rows, by_kind[gyro])
        celsius = numbers(rows, by_kind[TEMPERATURE]) if TEMPERATURE in by_kind else np.full((len(rows), 1), np.nan)
        readings = Readings(
            frame=run,
            host_s=host_s,
            gyro=_rotation_vectors(turned) if gyro == DELTA_Q else turned,
            accel=numbers(rows, by_kind[accel]),
            temperature=celsius,
            status=np.zeros(len(rows), np.uint32),
            count=(whole(PACKET_COUNTER, ">u2") - self._others) % 2**16,
            stamp=whole(SAMPLE_TIME, ">u4"),
            same=same,
            gyro_is_rate=gyro == RATE,
            accel_is_rate=accel == ACCELERATION,
        )
        if STATUS_WORD in by_kind:
            word = whole(STATUS_WORD, ">u4")
            readings.status |= flags((word & _CLIPPED) != 0, Status.OVERLOAD)
            if self._protocol.self_test_bit:
                readings.status |= flags((word & _SELF_TEST_PASSED) == 0, Status.SELF_TEST_FAILED)
        readings.drop_what_is_no_number()
        return readings


def _sources(kinds: dict[int, Field], message: str) -> tuple[int, int] | None:
    """Return the fields that gyros and accelerometers are read from, None where one is missing."""
    gyros, accels = [DELTA_Q, RATE], [DELTA_VELOCITY, ACCELERATION]
    if message == "rate":
        gyros, accels = gyros[::-1], accels[::-1]
    gyro = next((kind for kind in gyros if kind in kinds), None)
    accel = next((kind for kind in accels if kind in kinds), None)
    return None if gyro is None or accel is None else (gyro, accel)


def _quaternions(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit quaternions (n, 4), scalar first, of rotation vectors (n, 3) [rad]."""
    angle = np.linalg.norm(rotation, axis=1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), rotation / 2 * np.sinc(angle / (2 * np.pi))], axis=1)


def _rotation_vectors(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation vectors (n, 3) [rad] of quaternions (n, 4), scalar first."""
    scalar, vector = quaternions[:, :1], quaternions[:, 1:]
    vector = np.where(scalar < 0, -vector, vector)
    size = np.linalg.norm(vector, axis=1, keepdims=True)
    angle = 2 * np.arctan2(size, np.abs(scalar))
    return vector * np.where(size > 0, angle / np.where(size > 0, size, 1.0), 2.0)
