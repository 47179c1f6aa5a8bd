"""MicroStrain MIP: IMU data packets (descriptor set 80), encoder."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers.protocols.base import NEED_MORE, NOT_A_FRAME, Buffer, Decoded, Decoder, Frame, Protocol
from drivers.protocols.checksums import fletcher16
from drivers.protocols.fields import Field, Fields, alike, column
from drivers.protocols.options import choice, positive
from drivers.protocols.readings import (
    STANDARD_GRAVITY_MPS2,
    Bytes,
    Readings,
    add,
    arrivals,
    encoding_intervals_s,
    floats,
    repeats,
)
from drivers.protocols.timelines import ClockTimeline, HostTimeline
from drivers.samples import SampleArray

SYNC = b"\x75\x65"
IMU_SET = 0x80
ACCELERATION, RATE, DELTA_ANGLE, DELTA_VELOCITY, REFERENCE_TIME = 0x04, 0x05, 0x07, 0x08, 0xD5
SIZES = {ACCELERATION: 12, RATE: 12, DELTA_ANGLE: 12, DELTA_VELOCITY: 12, REFERENCE_TIME: 8}
_HEADER = 4
FACTORY_RATE_HZ = 100.0


class Mip(Protocol):
    """Packets of MicroStrain's inertial sensors.

    Parameters
    ----------
    message : what samples are made of where a packet holds both, and what the encoder sends: incremental or rate.
    rate_hz : of the packets, checked against the host's clock; packets without a reference time need it when there is
        no host's clock either.

    Raises
    ------
    ProtocolError
        An option's value is not legal.
    """

    name: ClassVar[str] = "mip"
    bit_rates: ClassVar[tuple[int, ...]] = (115200, 921600, 460800, 230400)
    checksum_bits: ClassVar[int] = 16
    sync = (SYNC,)
    longest = _HEADER + 255 + 2

    def __init__(self, *, message: object = "incremental", rate_hz: object = None) -> None:
        self.message = choice("message", message, ("incremental", "rate"))
        self.rate_hz = positive("rate_hz", rate_hz)

    def measure(self, data: Buffer, start: int, stop: int) -> int:
        """Return the length, where the fields that are there fit into it."""
        if stop - start < _HEADER:
            return NEED_MORE
        length = data[start + 3]
        end = start + _HEADER + length
        place = start + _HEADER
        while place < min(end, stop):
            if data[place] < 2 or place + data[place] > end:
                return NOT_A_FRAME
            place += data[place]
        return _HEADER + length + 2 if length >= 2 else NOT_A_FRAME

    def check(self, data: Buffer, start: int, stop: int) -> bool:
        """Compare the Fletcher sums."""
        return fletcher16(data[start : stop - 2]) == data[stop - 2 : stop]

    def decoder(self) -> Decoder:
        """Return a decoder; it remembers the clock."""
        return MipDecoder(self)

    def encode_samples(self, samples: SampleArray) -> bytes:
        """Return packets of set 80 with reference time."""
        interval_s = encoding_intervals_s(samples, 1.0 / (self.rate_hz or FACTORY_RATE_HZ))[:, None]
        if self.message == "incremental":
            kinds = (DELTA_ANGLE, DELTA_VELOCITY)
            values = (samples["dtheta"], samples["dv"] / STANDARD_GRAVITY_MPS2)
        else:
            kinds = (RATE, ACCELERATION)
            values = (samples["dtheta"] / interval_s, samples["dv"] / interval_s / STANDARD_GRAVITY_MPS2)
        stamps = np.rint(samples["time"] * 1e9).astype(">u8")
        packets = []
        for row in range(len(samples)):
            payload = bytes([10, REFERENCE_TIME]) + stamps[row : row + 1].tobytes()
            for kind, data in zip(kinds, values, strict=True):
                payload += bytes([14, kind]) + data[row].astype(">f4").tobytes()
            packet = SYNC + bytes([IMU_SET, len(payload)]) + payload
            packets.append(packet + fletcher16(packet))
        return b"".join(packets)


def fields_of(data: bytes) -> Fields:
    """Return the fields of a packet of the IMU set; none for other sets."""
    fields, place = [], _HEADER
    while data[2] == IMU_SET and place < len(data) - 2:
        fields.append(Field(data[place + 1], place + 2, place + data[place]))
        place += data[place]
    return tuple(fields)


class MipDecoder(Decoder):
    """IMU packets to samples; packets of other sets, answers to commands among them, are rejected and counted."""

    def __init__(self, protocol: Mip) -> None:
        self._protocol = protocol
        self.stated_rate_hz = protocol.rate_hz
        self._timeline: ClockTimeline | HostTimeline | None = None
        self._held: Readings | None = None
        self._before = b""

    def decode(self, frames: Sequence[Frame]) -> Decoded:
        """Decode runs of packets with the same fields together."""
        decoded = Decoded()
        host_s = arrivals(frames)
        for fields, run, rows in alike(frames, fields_of):
            by_kind = {field.kind: field for field in fields if SIZES.get(field.kind) == field.stop - field.start}
            sources = _sources(by_kind, self._protocol.message)
            if sources is None:
                decoded.rejects += len(run)
            else:
                self._place(self._read(rows, run, host_s[run], by_kind, *sources), REFERENCE_TIME in by_kind, decoded)
        return decoded

    def _place(self, readings: Readings, timed: bool, decoded: Decoded) -> None:
        """Give readings their time and interval, and append them."""
        if self._timeline is None or isinstance(self._timeline, ClockTimeline) != timed:
            rate_hz = self._protocol.rate_hz
            by_host = partial(HostTimeline, rate_hz or FACTORY_RATE_HZ, rate_hz is not None)
            self._timeline, self._held = ClockTimeline(2**62, 1e-9) if timed else by_host(), None
        if self._held is not None:
            readings, self._held = readings.behind(self._held), None
        if isinstance(self._timeline, HostTimeline):
            placed = self._timeline.place(readings.count, readings.host_s, readings.same, self.host_latency_s)
        elif len(readings) == 1 and not self._timeline.interval_known:
            self._held = readings
            return
        else:
            placed = self._timeline.place(readings.stamp, None, readings.host_s)
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
        """Return the readings of like packets in SI."""
        same = repeats(rows, self._before)
        self._before = rows[-1].tobytes()
        zeros = np.zeros(len(rows), np.int64)
        time = by_kind.get(REFERENCE_TIME)
        readings = Readings(
            frame=run,
            host_s=host_s,
            gyro=floats(column(rows, by_kind[gyro], ">f4")),
            accel=floats(column(rows, by_kind[accel], ">f4")) * STANDARD_GRAVITY_MPS2,
            temperature=np.full((len(rows), 1), np.nan),
            status=np.zeros(len(rows), np.uint32),
            count=zeros,
            stamp=zeros if time is None else column(rows, time, ">i8")[:, 0].astype(np.int64),
            same=same,
            gyro_is_rate=gyro == RATE,
            accel_is_rate=accel == ACCELERATION,
        )
        readings.drop_what_is_no_number()
        return readings


def _sources(kinds: dict[int, Field], message: str) -> tuple[int, int] | None:
    """Return the fields that gyros and accelerometers are read from, None where one is missing."""
    gyros, accels = [DELTA_ANGLE, RATE], [DELTA_VELOCITY, ACCELERATION]
    if message == "rate":
        gyros, accels = gyros[::-1], accels[::-1]
    gyro = next((kind for kind in gyros if kind in kinds), None)
    accel = next((kind for kind in accels if kind in kinds), None)
    return None if gyro is None or accel is None else (gyro, accel)
