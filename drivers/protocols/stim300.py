"""Sensonor STIM300: normal and special datagrams, encoder. ``docs/protocols.md`` lists the facts used."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.differences import differences
from drivers.layout import Checksum, FrameLayout, Head
from drivers.messages import Configuration, Identity, Message, Received, SelfTestResult
from drivers.protocols.base import (
    NEED_MORE,
    NOT_A_FRAME,
    Buffer,
    Decoded,
    Decoder,
    Frame,
    FrameRun,
    Protocol,
    ProtocolError,
)
from drivers.protocols.checksums import crc32_mpeg2
from drivers.protocols.options import choice
from drivers.protocols.readings import (
    ACCEL_AXES,
    ACCEL_INVALID,
    GYRO_AXES,
    STANDARD_GRAVITY_MPS2,
    Readings,
    add,
    arrivals,
    encoding_intervals_s,
    first_bytes,
    repeats,
    table,
)
from drivers.protocols.stim300_unpack import TEMPERATURES, Counts
from drivers.protocols.timelines import CounterTimeline
from drivers.samples import SampleArray, Status, empty_samples

CRLF = b"\r\n"
INTERNAL_RATE_HZ = 2000
RATES_HZ = (125.0, 250.0, 500.0, 1000.0, 2000.0)
BIT_RATES = (374400, 460800, 921600, 1843200)
GYRO_RANGE_RADPS = np.deg2rad(400.0)
_RATE_LSB_RADPS = np.deg2rad(2.0**-14)
_ANGLE_LSB_RAD = np.deg2rad(2.0**-21)
_ANGLE_TURN_RAD = np.deg2rad(8.0)
"""An integrated angle wraps in [−4°, 4°)."""
_TEMPERATURE_LSB_C = 2.0**-8
_WRAP = 2.0**24
_UNITS = ("rate", "incremental", "average", "integrated")


class Range(NamedTuple):
    """Scales of one accelerometer range: steps of g and of m/s, where integrated velocity wraps [m/s], its code."""

    g_bits: int
    velocity_bits: int
    wrap_mps: float
    code: int


RANGES = {
    5.0: Range(20, 23, 1.0, 3),
    10.0: Range(19, 22, 2.0, 0),
    30.0: Range(18, 21, 4.0, 4),
    80.0: Range(16, 19, 16.0, 6),
}


class Content(NamedTuple):
    """What a normal datagram holds besides gyros."""

    accel: bool
    inclination: bool
    temperature: bool
    auxiliary: bool

    @property
    def clusters(self) -> int:
        """Return the number of clusters of three axes."""
        return 1 + self.accel + self.inclination

    @property
    def temperature_at(self) -> int:
        """Return where temperatures begin, 0 where there are none."""
        return (1 + 10 * self.clusters) * self.temperature

    @property
    def length(self) -> int:
        """Return the length without CR LF [bytes]."""
        return 1 + 10 * self.clusters + 7 * self.clusters * self.temperature + 4 * self.auxiliary + 7


def _contents() -> dict[int, Content]:
    """Return the content by identifier: a table of eight contents, in four series of identifiers."""
    plain, extra = (0x90, 0x91, 0x92, 0x93, 0x94, 0xA5, 0xA6, 0xA7), (0x98, 0x99, 0x9A, 0x9B, 0x9C, 0xAD, 0xAE, 0xAF)
    found = {0x97: Content(True, True, True, False)}
    for number in range(8):
        accel, inclination, temperature = (0, 1, 0, 1)[number % 4], (0, 0, 1, 1)[number % 4], number >= 4
        content = Content(bool(accel), bool(inclination), temperature, False)
        found[plain[number]] = content
        found[extra[number]] = found[0xF0 + number] = content._replace(auxiliary=True)
    return found


CONTENTS = _contents()
IDENTIFIERS = {
    "rate": 0x90,
    "rate+acc": 0x91,
    "rate+incl": 0x92,
    "rate+acc+incl": 0x93,
    "rate+temp": 0x94,
    "rate+acc+temp": 0xA5,
    "rate+incl+temp": 0xA6,
    "rate+acc+incl+temp": 0xA7,
    "rate+acc+incl+temp+pps": 0xF7,
    "rate+acc+incl+temp+aux": 0xAF,
}


class Special(NamedTuple):
    """A special datagram: identifiers without and with CR LF, length without CR LF [bytes]."""

    plain: int
    terminated: int
    length: int


PART_NUMBER = Special(0xB1, 0xB3, 20)
SERIAL_NUMBER = Special(0xB5, 0xB7, 20)
CONFIGURATION = Special(0xBC, 0xBD, 26)
BIAS_TRIM = Special(0xD1, 0xD2, 40)
EXTENDED_ERROR = Special(0xBE, 0xBF, 21)
SPECIALS = (PART_NUMBER, SERIAL_NUMBER, CONFIGURATION, BIAS_TRIM, EXTENDED_ERROR)
LENGTHS = {
    **{identifier: content.length for identifier, content in CONTENTS.items()},
    **{identifier: special.length for special in SPECIALS for identifier in special[:2]},
}
_TERMINATED = frozenset(special.terminated for special in SPECIALS)


@dataclass(frozen=True, slots=True)
class Setting:
    """How a device is set: what its datagrams cannot say of themselves."""

    accel_range_g: float = 10.0
    gyro_output: str = "rate"
    accel_output: str = "rate"
    rate_hz: float | None = None
    gyro_off: tuple[bool, bool, bool] = (False, False, False)
    accel_off: tuple[bool, bool, bool] = (False, False, False)


class Stim300(Protocol):
    """Datagrams of the STIM300.

    Parameters
    ----------
    accel_range_g : 5, 10, 30 or 80, until a configuration datagram says otherwise; so are the next three.
    gyro_output, accel_output : rate, incremental, average or integrated.
    rate_hz : 125, 250, 500, 1000 or 2000; without it the counter's steps tell.
    crlf : whether datagrams end in CR LF: true, false, or auto, which takes CR LF ahead of a datagram as part of it.
    datagram : what the encoder sends, such as rate+acc+incl+temp.

    Raises
    ------
    ProtocolError
        An option's value is not legal.
    """

    name: ClassVar[str] = "stim300"
    bit_rates: ClassVar[tuple[int, ...]] = BIT_RATES
    requests: ClassVar[Mapping[bytes, type]] = {b"C\r": Configuration, b"I\r": Identity}
    temperatures = TEMPERATURES
    rates_hz = RATES_HZ

    def __init__(
        self,
        *,
        accel_range_g: object = 10.0,
        gyro_output: object = "rate",
        accel_output: object = "rate",
        rate_hz: object = None,
        crlf: object = "auto",
        datagram: object = "rate+acc+incl+temp",
    ) -> None:
        self.setting = Setting(
            choice("accel_range_g", accel_range_g, RANGES),
            choice("gyro_output", gyro_output, _UNITS),
            choice("accel_output", accel_output, _UNITS),
            None if rate_hz is None else choice("rate_hz", rate_hz, RATES_HZ),
        )
        self._crlf = choice("crlf", crlf, ("auto", "true", "false"))
        self._identifier = IDENTIFIERS[choice("datagram", datagram, IDENTIFIERS)]
        ids = [bytes([identifier]) for identifier in LENGTHS]
        self.sync = (*ids, *(CRLF + one for one in ids)) if self._crlf == "auto" else tuple(ids)
        self._lengths = {identifier: length + self._trailer(identifier) for identifier, length in LENGTHS.items()}
        self.longest = max(LENGTHS.values()) + len(CRLF)
        self._wound: NDArray[np.float64] = np.zeros(6)  # what the encoder's integrated outputs have reached

    def _trailer(self, identifier: int) -> int:
        """Return the length of what must follow the CRC of a datagram."""
        if self._crlf == "auto":
            return 0
        with_crlf = identifier in _TERMINATED or (identifier in CONTENTS and self._crlf == "true")
        return len(CRLF) if with_crlf else 0

    def measure(self, data: Buffer, start: int, stop: int) -> int:
        """Return the length that the identifier stands for, with CR LF ahead of it."""
        ahead = len(CRLF) if data[start] == CRLF[0] else 0
        if stop - start <= ahead:
            return NEED_MORE
        length = self._lengths.get(data[start + ahead])
        return NOT_A_FRAME if length is None else ahead + length

    def check(self, data: Buffer, start: int, stop: int) -> bool:
        """Compare the CRC, and CR LF where it must be."""
        start += len(CRLF) if data[start] == CRLF[0] else 0
        length = LENGTHS[data[start]]
        body = start + length - 4
        if bytes(data[start + length : stop]) not in (b"", CRLF):
            return False
        return crc32_mpeg2(data[start:body], -(length - 4) % 4) == data[body : body + 4]

    def layout(self) -> FrameLayout:
        """Return the identifiers as a table; where CR LF ahead is part of a datagram, with it and without."""
        heads = [
            Head(bytes([identifier]), self._lengths[identifier], -(length - 4) % 4, CRLF[: self._trailer(identifier)])
            for identifier, length in LENGTHS.items()
        ]
        if self._crlf == "auto":
            ahead = len(CRLF)
            heads += [Head(CRLF + one.pattern, ahead + one.length, one.padding, lead=ahead) for one in heads]
        return FrameLayout(tuple(heads), Checksum.CRC32_MPEG2_BIG, 1)

    def decoder(self) -> Decoder:
        """Return a decoder that begins with the options' setting and follows the configuration datagrams."""
        return Stim300Decoder(self.setting)

    def encode_samples(self, samples: SampleArray) -> bytes:
        """Return normal datagrams; the last setting given by options scales them.

        Increments beyond the range are sent as the limit, with the overload bit.

        Raises
        ------
        ProtocolError
            The samples come at a rate that the device has not.
        """
        content = CONTENTS[self._identifier]
        interval_s = encoding_intervals_s(samples, 1.0 / (self.setting.rate_hz or INTERNAL_RATE_HZ))
        step = INTERNAL_RATE_HZ * float(np.median(interval_s)) if len(samples) else 1.0
        if round(step) not in (1, 2, 4, 8, 16) or abs(step - round(step)) > 1e-3 * step:
            rate_hz = INTERNAL_RATE_HZ / step
            raise ProtocolError(f"a STIM300 samples at 125, 250, 500, 1000 or 2000 Hz, not at {rate_hz:g} Hz")
        gyro, gyro_over = self._gyro_counts(samples, interval_s)
        accel, accel_over = self._accel_counts(samples, interval_s)
        gyro_status = _status_byte(samples["status"], GYRO_AXES, gyro_over)
        accel_status = _status_byte(samples["status"], ACCEL_AXES, accel_over)
        counts = [(gyro, gyro_status)]
        if content.accel:
            counts.append((accel, accel_status))
        if content.inclination:
            tilt = np.rint(samples["dv"] / interval_s[:, None] / STANDARD_GRAVITY_MPS2 * 2**22)
            counts.append((_limited(tilt, 2**23)[0], accel_status))
        columns = [np.full((len(samples), 1), self._identifier, np.uint8)]
        for values, status in counts:
            columns += [_int24(values), status[:, None]]
        if content.temperature:
            for cluster in range(content.clusters):
                columns += [_temperatures(samples["temperature"], cluster), np.zeros((len(samples), 1), np.uint8)]
        if content.auxiliary:
            columns.append(np.zeros((len(samples), 4), np.uint8))
        counter = (samples["sequence"].astype(np.int64) * round(step) % 256).astype(np.uint8)
        columns += [counter[:, None], np.broadcast_to(np.array([0x01, 0xF0], np.uint8), (len(samples), 2))]
        bodies = np.concatenate(columns, axis=1)
        return b"".join(self._finished(row.tobytes()) for row in bodies)

    def encode_message(self, message: Message, sequence: int = 0, time_s: float = 0.0) -> bytes:
        """Return the special datagrams of an identity, a configuration or a self-test result."""
        match message:
            case Identity():
                digits = "".join(letter for letter in message.serial if letter.isdigit())[-14:].rjust(14, "0")
                return self._special(PART_NUMBER, bytes(15)) + self._special(
                    SERIAL_NUMBER, b"N" + bytes.fromhex(digits) + bytes(7)
                )
            case Configuration():
                return self._special(CONFIGURATION, self._configuration(message))
            case SelfTestResult():
                return self._special(EXTENDED_ERROR, bytes([not message.passed]).rjust(16, b"\0"))
        return super().encode_message(message, sequence, time_s)

    def _special(self, special: Special, payload: bytes) -> bytes:
        identifier = special.plain if self._crlf == "false" else special.terminated
        return self._finished(bytes([identifier]) + payload)

    def _finished(self, body: bytes) -> bytes:
        """Return a datagram with its CRC and, where so set, CR LF."""
        crc = crc32_mpeg2(body, -len(body) % 4)
        return body + crc + (b"" if self._crlf == "false" else CRLF)

    def _configuration(self, message: Configuration) -> bytes:
        """Return the payload of a configuration datagram."""
        content, payload = CONTENTS[self._identifier], bytearray(21)
        rate = RATES_HZ.index(message.sample_rate_hz) if message.sample_rate_hz in RATES_HZ else 5
        bit_rate = BIT_RATES.index(message.bit_rate) if message.bit_rate in BIT_RATES else 2
        payload[0] = ord("D")
        payload[2] = rate << 5 | content.auxiliary << 4 | content.temperature << 3 | content.inclination << 2
        payload[2] |= content.accel << 1 | (self._crlf != "false")
        payload[3] = bit_rate << 4
        payload[4] = 0x70 | _UNITS.index(self.setting.gyro_output)
        payload[7] = 0x70 | _UNITS.index(self.setting.accel_output)
        code = RANGES[self.setting.accel_range_g].code
        payload[16], payload[17] = code << 4 | code, code << 4
        return bytes(payload)

    def _gyro_counts(
        self, samples: SampleArray, interval_s: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        values = samples["dtheta"]
        if self.setting.gyro_output in ("rate", "average"):
            return _limited(np.rint(values / interval_s[:, None] / _RATE_LSB_RADPS), 2**23)
        if self.setting.gyro_output == "integrated":
            values = self._wind(values, slice(0, 3), _ANGLE_TURN_RAD)
        return _limited(np.rint(values / _ANGLE_LSB_RAD), 2**23)

    def _accel_counts(
        self, samples: SampleArray, interval_s: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        scale, values = RANGES[self.setting.accel_range_g], samples["dv"]
        if self.setting.accel_output in ("rate", "average"):
            steps = values / interval_s[:, None] / STANDARD_GRAVITY_MPS2 * 2.0**scale.g_bits
            return _limited(np.rint(steps), 2**23)
        if self.setting.accel_output == "integrated":
            values = self._wind(values, slice(3, 6), 2 * scale.wrap_mps)
        return _limited(np.rint(values * 2.0**scale.velocity_bits), 2**23)

    def _wind(self, increments: NDArray[np.float64], axes: slice, turn: float) -> NDArray[np.float64]:
        """Return what an integrating output shows after each increment, and go on from there next time."""
        total = self._wound[axes] + np.cumsum(increments, axis=0)
        if len(total):
            self._wound[axes] = total[-1]
        shown: NDArray[np.float64] = (total + turn / 2) % turn - turn / 2
        return shown


def _limited(counts: NDArray[np.float64], limit: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return counts within their field, and which went beyond."""
    inside = np.clip(counts, -limit, limit - 1)
    return inside.astype(np.int64), inside != counts


def _int24(counts: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return (n, 3) counts as (n, 9) bytes, big-endian."""
    octets = counts.astype(">i4").view(np.uint8).reshape(len(counts), 3, 4)[:, :, 1:]
    joined: NDArray[np.uint8] = np.ascontiguousarray(octets).reshape(len(counts), 9)
    return joined


def _temperatures(celsius: NDArray[np.float32], cluster: int) -> NDArray[np.uint8]:
    """Return the (n, 6) bytes of one cluster's temperatures; unknown ones read 0 °C, as the frame has no mark."""
    wanted = np.arange(3 * cluster, 3 * cluster + 3)
    columns = celsius[:, np.minimum(wanted, celsius.shape[1] - 1)].astype(np.float64)
    counts = np.clip(np.rint(np.nan_to_num(columns) / _TEMPERATURE_LSB_C), -(2**15), 2**15 - 1)
    octets: NDArray[np.uint8] = np.ascontiguousarray(counts.astype(">i2")).view(np.uint8).reshape(len(celsius), 6)
    return octets


def _status_byte(status: NDArray[np.uint32], axes: NDArray[np.uint32], over: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return the status byte of one cluster."""
    bad = (status[:, None] & axes) != 0
    which = ((bad | over) * np.array([1, 2, 4])).sum(axis=1)
    byte = which + 8 * bad.any(axis=1) + 16 * (over.any(axis=1) | ((status & Status.OVERLOAD) != 0))
    byte += 32 * ((status & Status.OUT_OF_RANGE) != 0) + 64 * ((status & Status.START_UP) != 0)
    octets: NDArray[np.uint8] = (byte + 128 * ((status & Status.INTEGRITY) != 0)).astype(np.uint8)
    return octets


class Stim300Decoder(Decoder):
    """Datagrams to samples and messages; follows the configuration that the device reports."""

    def __init__(self, setting: Setting) -> None:
        self._setting = setting
        step = None if setting.rate_hz is None else INTERNAL_RATE_HZ / setting.rate_hz
        self._timeline = CounterTimeline(256, 1 / INTERNAL_RATE_HZ, step)
        self._identity = Identity("STIM300", "", "", "mems")
        self._held: Readings | None = None  # a first row, whose interval is not known before the second's counter
        self._before = b""
        self._reached: NDArray[np.float64] | None = None  # what the integrating outputs showed last
        self._sequence = -1
        self._starting = True

    def decode(self, frames: Sequence[Frame]) -> Decoded:
        """Decode runs of like datagrams together and special ones one by one."""
        decoded = Decoded(samples=empty_samples(0, TEMPERATURES))
        if not len(frames):
            return decoded
        if isinstance(frames, FrameRun):
            ahead = len(CRLF) * (first_bytes(frames) == CRLF[0])
            frames = FrameRun(frames.data, frames.starts + ahead, frames.stops, frames.host_time_s)
        else:
            frames = [_without_crlf(frame) for frame in frames]
        first = first_bytes(frames)
        edges = [0, *(np.flatnonzero(first[1:] != first[:-1]) + 1).tolist(), len(first)]
        for low, high in itertools.pairwise(edges):
            run = np.arange(low, high)
            content = CONTENTS.get(int(first[low]))
            if content is not None:
                self._normal(frames, run, content, decoded)
                continue
            for index in run.tolist():
                self._special(frames[index], decoded)
        return decoded

    def _normal(self, frames: Sequence[Frame], run: NDArray[np.intp], content: Content, decoded: Decoded) -> None:
        """Decode normal datagrams of one content; a start-up bit set anew says that the device was switched on."""
        rows = table(frames, run, 0, content.length)
        host_s = arrivals(frames)[run]
        starting = (rows[:, 10] & 0x40) != 0
        switched_on = np.flatnonzero(starting & ~np.concatenate([[self._starting], starting[:-1]])).tolist()
        self._starting = bool(starting[-1])
        for low, high in itertools.pairwise(sorted({0, *switched_on, len(rows)})):
            if low in switched_on:
                self._restart()
            self._place(self._read(rows[low:high], content, run[low:high], host_s[low:high]), decoded)

    def _restart(self) -> None:
        self._timeline.restart()
        self._held, self._reached, self._sequence = None, None, -1

    def _place(self, readings: Readings, decoded: Decoded) -> None:
        """Give readings their time and interval, and append them."""
        if self._held is not None:
            readings, self._held = readings.behind(self._held), None
        if len(readings) == 1 and not self._timeline.interval_known:
            self._held = readings
        elif len(readings):
            placed = self._timeline.place(readings.count, readings.host_s, readings.same, self.host_latency_s)
            self._share_gaps(readings, placed.sequence)
            add(decoded, readings, placed)

    def _share_gaps(self, readings: Readings, sequence: NDArray[np.int64]) -> None:
        """Share what an integrating output gained over a gap among the frames lost in it.

        A sample's increments are those of one interval, whatever was lost before it.
        """
        before, self._sequence = self._sequence, int(sequence[-1])
        if "integrated" not in (self._setting.gyro_output, self._setting.accel_output):
            return
        frames = np.maximum(differences(sequence, before), 1)[:, None]
        if self._setting.gyro_output == "integrated":
            readings.gyro /= frames
        if self._setting.accel_output == "integrated":
            readings.accel /= frames

    def _read(
        self, rows: NDArray[np.uint8], content: Content, run: NDArray[np.intp], host_s: NDArray[np.float64]
    ) -> Readings:
        """Return the readings of normal datagrams in SI."""
        setting, scale = self._setting, RANGES[self._setting.accel_range_g]
        read = Counts(rows, content.accel, content.temperature_at, *_CONDITIONS)
        counts = read.axes
        off = int(GYRO_AXES[list(setting.gyro_off)].sum() + ACCEL_AXES[list(setting.accel_off)].sum())
        read.status |= np.uint32(off if content.accel else off | int(ACCEL_INVALID))
        same = repeats(rows, self._before)
        self._before = rows[-1].tobytes()
        first, integrating = self._reached is None, "integrated" in (setting.gyro_output, setting.accel_output)
        gained = self._gained(counts) if integrating else counts
        if setting.gyro_output == "integrated":
            gyro = gained[:, :3] * _ANGLE_LSB_RAD
        else:
            gyro = counts[:, :3] * (_ANGLE_LSB_RAD if setting.gyro_output == "incremental" else _RATE_LSB_RADPS)
        if setting.accel_output == "integrated":
            accel = gained[:, 3:] * 2.0**-scale.velocity_bits
        else:
            incremental = setting.accel_output == "incremental"
            step = 2.0**-scale.velocity_bits if incremental else 2.0**-scale.g_bits * STANDARD_GRAVITY_MPS2
            accel = counts[:, 3:] * step
        readings = Readings(
            frame=run,
            host_s=host_s - read.latency_us * 1e-6,
            gyro=gyro,
            accel=accel,
            temperature=read.celsius,
            status=read.status,
            count=read.counter,
            stamp=read.latency_us,
            same=same,
            gyro_is_rate=setting.gyro_output in ("rate", "average"),
            accel_is_rate=setting.accel_output in ("rate", "average"),
        )
        return readings.rows(slice(1, None)) if first and integrating else readings

    def _gained(self, counts: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return by how much wrapping counts went on from row to row, each the shortest way."""
        before = counts[:1] if self._reached is None else self._reached[None, :]
        self._reached = counts[-1]
        gained: NDArray[np.float64] = np.diff(counts, axis=0, prepend=before)
        return (gained + _WRAP / 2) % _WRAP - _WRAP / 2

    def _special(self, frame: Frame, decoded: Decoded) -> None:
        """Take what a special datagram says."""
        data = frame.data
        message: Message | None = None
        match data[0]:
            case PART_NUMBER.plain | PART_NUMBER.terminated | BIAS_TRIM.plain | BIAS_TRIM.terminated:
                return
            case SERIAL_NUMBER.plain | SERIAL_NUMBER.terminated:
                self._identity = replace(self._identity, serial="N" + data[2:9].hex())
                message = self._identity
            case CONFIGURATION.plain | CONFIGURATION.terminated:
                message = self._configured(data)
            case EXTENDED_ERROR.plain | EXTENDED_ERROR.terminated:
                message = SelfTestResult(Status.SELF_TEST_FAILED if any(data[1:17]) else Status(0))
        if message is None:
            decoded.rejects += 1
        else:
            decoded.messages.append(Received(message, 0, 0.0, frame.host_time_s))

    def _configured(self, data: bytes) -> Configuration | None:
        """Adapt to a configuration datagram; None where it holds a code that the data sheet has not."""
        ranges = {scale.code: g for g, scale in RANGES.items()}
        code, bit_rate, gyro_unit, accel_unit = data[17] >> 4, data[4] >> 4, data[5] & 15, data[8] & 15
        rate = data[3] >> 5
        if code not in ranges or bit_rate >= len(BIT_RATES) or max(gyro_unit, accel_unit) > 3 or rate > 5:
            return None
        gyro_on, accel_on = data[5] >> 4, data[8] >> 4
        setting = Setting(
            accel_range_g=ranges[code],
            gyro_output=_UNITS[gyro_unit],
            accel_output=_UNITS[accel_unit],
            rate_hz=RATES_HZ[rate] if rate < 5 else None,
            gyro_off=(not gyro_on & 4, not gyro_on & 2, not gyro_on & 1),
            accel_off=(not accel_on & 4, not accel_on & 2, not accel_on & 1),
        )
        if setting != self._setting:
            self._reached, self._held = None, None
        self._setting = setting
        self._timeline.frame.step = None if setting.rate_hz is None else INTERNAL_RATE_HZ / setting.rate_hz
        self._identity = replace(self._identity, firmware=f"{chr(data[1] & 127)} {data[2]}")
        return Configuration(
            setting.rate_hz or 0.0,
            BIT_RATES[bit_rate],
            setting.accel_range_g * STANDARD_GRAVITY_MPS2,
            float(GYRO_RANGE_RADPS),
            True,
        )


def _without_crlf(frame: Frame) -> Frame:
    """Return a frame without CR LF ahead of it."""
    return frame._replace(data=frame.data[len(CRLF) :]) if frame.data[0] == CRLF[0] else frame


def _condition_table(axes: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return the conditions for each of the 256 status bytes; an error of no named axis is one of all three."""
    words = np.zeros(256, np.uint32)
    for byte in range(256):
        named = [Status.OVERLOAD, Status.OUT_OF_RANGE, Status.START_UP, Status.INTEGRITY]
        word = sum(int(one) for bit, one in zip((16, 32, 64, 128), named, strict=True) if byte & bit)
        if byte & 8:
            which = [int(axis) for bit, axis in zip((1, 2, 4), axes, strict=True) if byte & bit or not byte & 7]
            word |= sum(which)
        words[byte] = word
    return words


_CONDITIONS = (_condition_table(GYRO_AXES), _condition_table(ACCEL_AXES))
