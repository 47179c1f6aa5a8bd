"""VectorNav VN-100, VN-200, VN-300: binary messages of the common and IMU groups, encoder."""

from __future__ import annotations

import itertools
from binascii import crc_hqx
from collections.abc import Sequence
from functools import cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers.protocols.base import NEED_MORE, NOT_A_FRAME, Buffer, Decoded, Decoder, Frame, Protocol
from drivers.protocols.options import choice, positive
from drivers.protocols.readings import (
    Readings,
    add,
    arrivals,
    encoding_intervals_s,
    flags,
    floats,
    repeats,
    table,
)
from drivers.protocols.timelines import ClockTimeline, HostTimeline
from drivers.samples import SampleArray, Status

SYNC = 0xFA
_F3 = ("<f4", (3,))
_DELTA = [("interval", "<f4"), ("dtheta_deg", *_F3)]

COMMON_SIZES = (8, 8, 8, 12, 16, 12, 24, 12, 12, 24, 20, 28, 2, 4, 8)
IMU_SIZES = (2, 12, 12, 12, 4, 4, 16, 12, 12, 12, 12, 2, 40)
SIZES = {0: COMMON_SIZES, 2: IMU_SIZES}
_WANTED = {
    (0, 0): np.dtype([("startup_ns", "<i8")]),
    (0, 5): np.dtype([("rate", *_F3)]),
    (0, 8): np.dtype([("accel", *_F3)]),
    (0, 10): np.dtype([("magnetic", *_F3), ("celsius", "<f4"), ("pressure", "<f4")]),
    (0, 11): np.dtype([*_DELTA, ("dv", *_F3)]),
    (0, 12): np.dtype([("ins_status", "<u2")]),
    (2, 2): np.dtype([("raw_accel", *_F3)]),
    (2, 3): np.dtype([("raw_rate", *_F3)]),
    (2, 4): np.dtype([("celsius", "<f4")]),
    (2, 6): np.dtype(_DELTA),
    (2, 7): np.dtype([("dv", *_F3)]),
    (2, 9): np.dtype([("accel", *_F3)]),
    (2, 10): np.dtype([("rate", *_F3)]),
    (2, 11): np.dtype([("saturation", "<u2")]),
}
"""What is read, by group and bit; all other fields are passed over by their size."""
_IMU_ERROR = 0x0010
_SATURATED = 0x01F8
FACTORY_RATE_HZ = 40.0
PATIENCE = 50
"""Messages of another usable layout in a row after which samples are made of them."""


class Masks(tuple[tuple[int, tuple[int, ...]], ...]):
    """Groups of a message with their field bits, ascending."""


def read_header(data: Buffer, start: int, stop: int) -> tuple[int, Masks] | int:
    """Return header length and masks; :data:`NEED_MORE` or :data:`NOT_A_FRAME` where there are none."""
    if stop - start < 2:
        return NEED_MORE
    # Bit 7 would announce groups from 7 on, which these devices have not.
    groups = [group for group in range(8) if data[start + 1] >> group & 1]
    place = start + 2
    if not groups or any(group not in SIZES for group in groups):
        return NOT_A_FRAME
    masks = []
    for group in groups:
        bits: list[int] = []
        for word in itertools.count():
            if stop - place < 2:
                return NEED_MORE
            mask = int.from_bytes(data[place : place + 2], "little")
            bits += [15 * word + bit for bit in range(15) if mask >> bit & 1]
            place += 2
            if not mask & 0x8000:
                break
            if 15 * (word + 1) >= len(SIZES[group]):
                return NOT_A_FRAME
        if not bits or bits[-1] >= len(SIZES[group]):
            return NOT_A_FRAME
        masks.append((group, tuple(bits)))
    return place - start, Masks(masks)


@cache
def layout_of(header: bytes) -> np.dtype[np.void]:
    """Return the layout of messages that begin with ``header``, the fields wanted by name; the IMU group's win."""
    found = read_header(header, 0, len(header))
    assert not isinstance(found, int)
    names: dict[str, tuple[np.dtype[np.void], int]] = {}
    offset = found[0]
    for group, bits in found[1]:
        for bit in bits:
            wanted = _WANTED.get((group, bit))
            for name in (wanted.names or ()) if wanted is not None else ():
                assert wanted is not None
                kind, inside = wanted.fields[name][:2]  # type: ignore[index]
                names[name] = (kind, offset + inside)
            offset += SIZES[group][bit]
    return np.dtype(
        {
            "names": list(names),
            "formats": [kind for kind, _ in names.values()],
            "offsets": [place for _, place in names.values()],
            "itemsize": offset + 2,
        }
    )


class VectorNav(Protocol):
    """Binary messages, whose length is the sum of the fields that their masks name.

    Parameters
    ----------
    message : what samples are made of, and what the encoder sends: incremental (delta angle and velocity) or rate.
        A stream that holds only the other kind is read all the same.
    rate_hz : of the messages, checked against the host's clock; needed only by messages without a time since startup.

    Raises
    ------
    ProtocolError
        An option's value is not legal.
    """

    name: ClassVar[str] = "vectornav"
    bit_rates: ClassVar[tuple[int, ...]] = (115200, 921600, 460800, 230400, 128000, 57600, 38400, 19200, 9600)
    checksum_bits: ClassVar[int] = 16
    sync = tuple(bytes([SYNC, sum(1 << group for group in groups)]) for groups in ((0,), (2,), (0, 2)))
    longest = 2 + 4 + sum(COMMON_SIZES) + sum(IMU_SIZES) + 2

    def __init__(self, *, message: object = "incremental", rate_hz: object = None) -> None:
        self.message = choice("message", message, ("incremental", "rate"))
        self.rate_hz = positive("rate_hz", rate_hz)

    def measure(self, data: Buffer, start: int, stop: int) -> int:
        """Return the length that the masks add up to."""
        found = read_header(data, start, stop)
        if isinstance(found, int):
            return found
        length, masks = found
        return length + sum(SIZES[group][bit] for group, bits in masks for bit in bits) + 2

    def check(self, data: Buffer, start: int, stop: int) -> bool:
        """Let the CRC-16 run over all behind the sync, itself included: it is 0."""
        return crc_hqx(data[start + 1 : stop], 0) == 0

    def decoder(self) -> Decoder:
        """Return a decoder; it remembers which messages samples are made of, and the clock."""
        return VectorNavDecoder(self)

    def encode_samples(self, samples: SampleArray) -> bytes:
        """Return messages of time since startup, the increments or rates, temperature and saturation."""
        interval_s = encoding_intervals_s(samples, 1.0 / (self.rate_hz or FACTORY_RATE_HZ))
        if self.message == "incremental":
            header = _header(common=(0,), imu=(4, 6, 7, 11))
            values = {"interval": interval_s, "dtheta_deg": np.rad2deg(samples["dtheta"]), "dv": samples["dv"]}
        else:
            header = _header(common=(0,), imu=(4, 9, 10, 11))
            rates = (samples["dtheta"] / interval_s[:, None], samples["dv"] / interval_s[:, None])
            values = dict(zip(("rate", "accel"), rates, strict=True))
        values["startup_ns"] = np.rint(samples["time"] * 1e9).astype(np.int64)
        values["celsius"] = np.nan_to_num(samples["temperature"][:, 0])
        values["saturation"] = np.where(samples["status"] & Status.OVERLOAD, _SATURATED, 0)
        layout = layout_of(header)
        octets = np.zeros((len(samples), layout.itemsize), np.uint8)
        octets[:, : len(header)] = np.frombuffer(header, np.uint8)
        frames = octets.view(layout)[:, 0]
        for name, column in values.items():
            frames[name] = column
        bodies = [row[:-2].tobytes() for row in octets]
        return b"".join(body + crc_hqx(body[1:], 0).to_bytes(2, "big") for body in bodies)


def _header(common: tuple[int, ...], imu: tuple[int, ...]) -> bytes:
    """Return the header of messages with these fields."""
    masks = [sum(1 << bit for bit in bits).to_bytes(2, "little") for bits in (common, imu)]
    return bytes([SYNC, 0b101]) + b"".join(masks)


class VectorNavDecoder(Decoder):
    """Messages of one layout to samples; others that a device sends between them are passed over."""

    def __init__(self, protocol: VectorNav) -> None:
        self._protocol = protocol
        self.stated_rate_hz = protocol.rate_hz
        self._header = b""
        self._others = 0
        self._timeline: ClockTimeline | HostTimeline
        self._held: Readings | None = None
        self._before = b""

    def decode(self, frames: Sequence[Frame]) -> Decoded:
        """Decode the messages of the layout in use together."""
        decoded = Decoded()
        chosen: list[int] = []
        for index, frame in enumerate(frames):
            header = _header_of(frame.data)
            if header == self._header:
                self._others = 0
                chosen.append(index)
            elif not _usable(layout_of(header)):
                decoded.rejects += 1
            elif not self._header or self._others >= PATIENCE:
                self._decode(frames, chosen, decoded)
                self._begin(header)
                chosen = [index]
            else:
                self._others += 1
        self._decode(frames, chosen, decoded)
        return decoded

    def _begin(self, header: bytes) -> None:
        """Make samples of messages with this header from now on."""
        self._header, self._others, self._held = header, 0, None
        if "startup_ns" in (layout_of(header).names or ()):
            self._timeline = ClockTimeline(2**62, 1e-9)
        else:
            rate_hz = self._protocol.rate_hz
            self._timeline = HostTimeline(rate_hz or FACTORY_RATE_HZ, rate_hz is not None)

    def _decode(self, frames: Sequence[Frame], chosen: list[int], decoded: Decoded) -> None:
        if not chosen:
            return
        run, layout = np.array(chosen, np.intp), layout_of(self._header)
        rows = table(frames, run, 0, layout.itemsize)
        readings = self._read(rows, layout, run, arrivals(frames)[run])
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
        self, rows: NDArray[np.uint8], layout: np.dtype[np.void], run: NDArray[np.intp], host_s: NDArray[np.float64]
    ) -> Readings:
        """Return the readings of messages in SI."""
        names, frames = layout.names or (), np.ascontiguousarray(rows).view(layout)[:, 0]
        same = repeats(rows, self._before)
        self._before = rows[-1].tobytes()
        zeros = np.zeros(len(rows), np.int64)
        gyro_name, accel_name = _sources(names, self._protocol.message)
        gyro = floats(frames[gyro_name])
        celsius = floats(frames["celsius"]) if "celsius" in names else np.full(len(rows), np.nan)
        readings = Readings(
            frame=run,
            host_s=host_s,
            gyro=np.deg2rad(gyro) if gyro_name == "dtheta_deg" else gyro,
            accel=floats(frames[accel_name]),
            temperature=celsius[:, None],
            status=_conditions(frames, names),
            count=zeros,
            stamp=frames["startup_ns"].astype(np.int64) if "startup_ns" in names else zeros,
            same=same,
            gyro_is_rate=gyro_name != "dtheta_deg",
            accel_is_rate=accel_name != "dv",
        )
        readings.drop_what_is_no_number()
        return readings


def _header_of(data: bytes) -> bytes:
    """Return the header of a message."""
    found = read_header(data, 0, len(data))
    assert not isinstance(found, int)
    return data[: found[0]]


def _sources(names: Sequence[str], message: str) -> tuple[str, str]:
    """Return the fields that gyros and accelerometers are read from; empty where there are none."""
    gyros, accels = ["dtheta_deg", "rate", "raw_rate"], ["dv", "accel", "raw_accel"]
    if message == "rate":
        gyros, accels = [*gyros[1:], gyros[0]], [*accels[1:], accels[0]]
    return next((name for name in gyros if name in names), ""), next((name for name in accels if name in names), "")


@cache
def _usable(layout: np.dtype[np.void]) -> bool:
    """Whether messages of a layout hold both gyros and accelerometers."""
    return all(_sources(layout.names or (), "incremental"))


def _conditions(frames: NDArray[np.void], names: Sequence[str]) -> NDArray[np.uint32]:
    """Return the named conditions: saturated inertial sensors, and an error of the inertial unit."""
    status = np.zeros(len(frames), np.uint32)
    if "saturation" in names:
        status |= flags((frames["saturation"] & _SATURATED) != 0, Status.OVERLOAD)
    if "ins_status" in names:
        status |= flags((frames["ins_status"] & _IMU_ERROR) != 0, Status.INTEGRITY)
    return status
