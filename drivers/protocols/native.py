"""The native frame: layout, encoder and decoder. ``docs/native-protocol.md`` says the same byte by byte."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from enum import IntEnum
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers.layout import Checksum, FrameLayout, Head
from drivers.messages import (
    GYRO_KINDS,
    Acknowledgement,
    Compensation,
    Configuration,
    Identity,
    Message,
    Outcome,
    ReadCompensation,
    ReadConfiguration,
    ReadIdentity,
    Received,
    SelfTest,
    SelfTestResult,
    SetRate,
    Start,
    Stop,
    WriteCompensation,
    pack_terms,
    terms_crc,
)
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
from drivers.samples import SampleArray, Status, empty_samples

SYNC = bytes.fromhex("c749549e")
"""No byte is 00 or FF, which fill the upper bytes of counters and small increments; no end of it is its beginning."""
VERSION = 1
DV_LSB_MPS = 2.0**-24
"""Step of a velocity increment [m/s]."""
DTHETA_LSB_RAD = 2.0**-30
"""Step of an angle increment [rad]."""
TEMPERATURES = 3
TEMPERATURE_LSB_C = 2.0**-8
NO_TEMPERATURE = -(2**15)
NO_SUPPLY = 2**16 - 1
DEFAULT_BIT_RATE = 921600

HEADER = struct.Struct("<4sBBHIQ")
CRC = struct.Struct("<I")
DATA_DTYPE = np.dtype(
    [
        ("sync", "V4"),
        ("version", "u1"),
        ("type", "u1"),
        ("length", "<u2"),
        ("sequence", "<u4"),
        ("time_us", "<u8"),
        ("dv", "<i4", (3,)),
        ("dtheta", "<i4", (3,)),
        ("temperature", "<i2", (TEMPERATURES,)),
        ("supply_mv", "<u2"),
        ("status", "<u4"),
        ("crc", "<u4"),
    ]
)
DATA_LENGTH = DATA_DTYPE.itemsize


class Kind(IntEnum):
    """Types of frame: the block's below 0x80, commands from there on."""

    DATA = 0x01
    IDENTITY = 0x02
    CONFIGURATION = 0x03
    SELF_TEST_RESULT = 0x04
    ACKNOWLEDGEMENT = 0x05
    COMPENSATION = 0x06
    START = 0x81
    STOP = 0x82
    SELF_TEST = 0x83
    SET_RATE = 0x84
    WRITE_COMPENSATION = 0x85
    READ_COMPENSATION = 0x86
    READ_IDENTITY = 0x87
    READ_CONFIGURATION = 0x88


_COMMANDS: dict[int, type] = {
    Kind.START: Start,
    Kind.STOP: Stop,
    Kind.SELF_TEST: SelfTest,
    Kind.SET_RATE: SetRate,
    Kind.WRITE_COMPENSATION: WriteCompensation,
    Kind.READ_COMPENSATION: ReadCompensation,
    Kind.READ_IDENTITY: ReadIdentity,
    Kind.READ_CONFIGURATION: ReadConfiguration,
}
_TYPES: dict[type, int] = {
    Identity: Kind.IDENTITY,
    Configuration: Kind.CONFIGURATION,
    SelfTestResult: Kind.SELF_TEST_RESULT,
    Acknowledgement: Kind.ACKNOWLEDGEMENT,
    Compensation: Kind.COMPENSATION,
    **{command: number for number, command in _COMMANDS.items()},
}
_NAMES = {command.__name__: number for number, command in _COMMANDS.items()}

_IDENTITY = struct.Struct("<16s16s16sB3x")
_CONFIGURATION = struct.Struct("<IIffB3x")
_STATUS = struct.Struct("<I")
_ACKNOWLEDGEMENT = struct.Struct("<BB2x")
_COMPENSATION = struct.Struct("<6dII")
_RATE = struct.Struct("<I")
_WRITE = struct.Struct("<6dI")
_PAYLOADS = {
    Kind.IDENTITY: _IDENTITY.size,
    Kind.CONFIGURATION: _CONFIGURATION.size,
    Kind.SELF_TEST_RESULT: _STATUS.size,
    Kind.ACKNOWLEDGEMENT: _ACKNOWLEDGEMENT.size,
    Kind.COMPENSATION: _COMPENSATION.size,
    **dict.fromkeys(_COMMANDS, 0),
    Kind.SET_RATE: _RATE.size,
    Kind.WRITE_COMPENSATION: _WRITE.size,
}
_LENGTHS = {Kind.DATA: DATA_LENGTH, **{kind: HEADER.size + size + CRC.size for kind, size in _PAYLOADS.items()}}
# Version, type and length stand together: one look-up of these four bytes tells a header from anything else.
_HEADS = {struct.pack("<BBH", VERSION, kind, length): length for kind, length in _LENGTHS.items()}


class Native(Protocol):
    """The frame that our own blocks and the simulator speak, either way along the line."""

    name: ClassVar[str] = "native"
    commands: ClassVar[bool] = True
    sync = (SYNC,)
    longest = max(_LENGTHS.values())
    temperatures = TEMPERATURES

    def measure(self, data: Buffer, start: int, stop: int) -> int:
        """Return the length that version, type and length field agree on."""
        if stop - start < 8:
            return NEED_MORE
        return _HEADS.get(bytes(data[start + 4 : start + 8]), NOT_A_FRAME)

    def check(self, data: Buffer, start: int, stop: int) -> bool:
        """Compare the CRC-32 over everything before it."""
        body = stop - CRC.size
        return zlib.crc32(data[start:body]) == int.from_bytes(data[body:stop], "little")

    def layout(self) -> FrameLayout:
        """Return the frames' sync, version, type and length fields as a table."""
        heads = tuple(Head(SYNC + head, length) for head, length in _HEADS.items())
        return FrameLayout(heads, Checksum.CRC32_LITTLE, len(SYNC))

    def decoder(self) -> Decoder:
        """Return a decoder; native frames say all about themselves, so it remembers nothing."""
        return NativeDecoder()

    def encode_samples(self, samples: SampleArray) -> bytes:
        """Return data frames; see :func:`encode_samples`."""
        return encode_samples(samples)

    def encode_message(self, message: Message, sequence: int = 0, time_s: float = 0.0) -> bytes:
        """Return the frame of any message or command."""
        return encode_message(message, sequence, time_s)


class NativeDecoder(Decoder):
    """Native frames to samples and messages."""

    def decode(self, frames: Sequence[Frame]) -> Decoded:
        """Decode data frames together and the few others one by one."""
        if isinstance(frames, FrameRun):
            return self._decode_run(frames)
        data = [index for index, frame in enumerate(frames) if frame.data[5] == Kind.DATA]
        decoded = Decoded(
            samples=decode_samples(b"".join([frames[index].data for index in data])),
            frame_of_sample=np.array(data, np.intp),
        )
        if len(data) == len(frames):
            return decoded
        for frame in frames:
            if frame.data[5] != Kind.DATA:
                received = decode_message(frame)
                if received is None:
                    decoded.rejects += 1
                else:
                    decoded.messages.append(received)
        return decoded

    def _decode_run(self, frames: FrameRun) -> Decoded:
        """Decode data frames where they stand."""
        from drivers.protocols.native_unpack import rows_of_kind, unpack  # a live line does not wait for compiled code

        data = rows_of_kind(frames.data, frames.starts, int(Kind.DATA))
        if len(data) == len(frames):
            return Decoded(unpack(frames.data, frames.starts), data)
        decoded = Decoded(unpack(frames.data, frames.starts[data]), data)
        others = np.delete(np.arange(len(frames)), data).tolist()
        said = self.decode([frames[index] for index in others])
        decoded.messages, decoded.rejects = said.messages, said.rejects
        return decoded


def encode_samples(samples: SampleArray) -> bytes:
    """Return one data frame for each sample, rounded to the frame's steps.

    An increment beyond the range of its field is sent as the limit with ``Status.OVERLOAD`` set. Unknown (NaN)
    temperatures and supply are sent as the marks for unknown; sensors beyond the third are not sent.

    Raises
    ------
    ValueError
        An increment or a time is not a number, or a time is negative.
    """
    frames = np.zeros(len(samples), DATA_DTYPE)
    frames["sync"] = np.void(SYNC)
    frames["version"] = VERSION
    frames["type"] = Kind.DATA
    frames["length"] = DATA_LENGTH
    frames["sequence"] = samples["sequence"]
    if not np.all(samples["time"] >= 0):
        raise ValueError("a native frame needs device times of 0 or more")
    frames["time_us"] = np.rint(samples["time"] * 1e6)
    frames["dv"], dv_over = _steps(samples["dv"], DV_LSB_MPS)
    frames["dtheta"], dtheta_over = _steps(samples["dtheta"], DTHETA_LSB_RAD)
    frames["status"] = samples["status"] | np.where(dv_over | dtheta_over, np.uint32(Status.OVERLOAD), np.uint32(0))
    temperatures = samples["temperature"][:, :TEMPERATURES]
    frames["temperature"] = NO_TEMPERATURE
    frames["temperature"][:, : temperatures.shape[1]] = _marked(
        temperatures / TEMPERATURE_LSB_C, NO_TEMPERATURE + 1, 2**15 - 1, NO_TEMPERATURE
    )
    frames["supply_mv"] = _marked(samples["supply"] * 1e3, 0, NO_SUPPLY - 1, NO_SUPPLY)
    raw = memoryview(frames.tobytes())
    body = DATA_LENGTH - CRC.size
    frames["crc"] = [zlib.crc32(raw[start : start + body]) for start in range(0, len(raw), DATA_LENGTH)]
    return frames.tobytes()


def _steps(values: NDArray[np.float64], step: float) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Return increments in whole steps, and which rows went beyond the field."""
    if not np.all(np.isfinite(values)):
        raise ValueError("a native frame needs finite increments")
    counts = np.rint(values / step)
    limited = np.clip(counts, -(2**31), 2**31 - 1)
    over: NDArray[np.bool_] = (limited != counts).any(axis=1)
    return limited.astype(np.int32), over


def _marked(values: NDArray[np.floating], low: int, high: int, mark: int) -> NDArray[np.float64]:
    """Return values rounded and limited, with ``mark`` where they are not known."""
    counts = np.clip(np.rint(values.astype(np.float64)), low, high)
    return np.where(np.isnan(counts), float(mark), counts)


def decode_samples(data: bytes) -> SampleArray:
    """Return the samples of data frames that stand one after another and whose checksums hold."""
    frames = np.frombuffer(data, DATA_DTYPE)
    samples = empty_samples(len(frames), TEMPERATURES)
    samples["sequence"] = frames["sequence"]
    samples["time"] = frames["time_us"] / 1e6
    samples["dv"] = frames["dv"] * DV_LSB_MPS
    samples["dtheta"] = frames["dtheta"] * DTHETA_LSB_RAD
    known = frames["temperature"] != NO_TEMPERATURE
    samples["temperature"] = np.where(known, frames["temperature"] * TEMPERATURE_LSB_C, np.nan)
    samples["supply"] = np.where(frames["supply_mv"] != NO_SUPPLY, frames["supply_mv"] / 1e3, np.nan)
    samples["status"] = frames["status"]
    return samples


def encode_message(message: Message, sequence: int = 0, time_s: float = 0.0) -> bytes:
    """Return the frame of one message or command.

    Parameters
    ----------
    sequence : number of the command that this is or answers; 0 when nobody asked.
    time_s : the sender's clock [s].

    Raises
    ------
    ProtocolError
        A value does not fit its field.
    """
    kind = _TYPES[type(message)]
    try:
        head = HEADER.pack(SYNC, VERSION, kind, _LENGTHS[kind], sequence, round(time_s * 1e6))
        frame = head + _payload(message)
    except (struct.error, UnicodeEncodeError, OverflowError, ValueError) as error:
        raise ProtocolError(f"{type(message).__name__} does not fit its native frame: {error}") from None
    return frame + CRC.pack(zlib.crc32(frame))


def _payload(message: Message) -> bytes:
    """Return what stands between header and CRC."""
    match message:
        case Identity():
            texts = [_text(text) for text in (message.model, message.serial, message.firmware)]
            return _IDENTITY.pack(*texts, GYRO_KINDS.index(message.gyro_kind))
        case Configuration():
            return _CONFIGURATION.pack(
                round(message.sample_rate_hz * 1e3),
                message.bit_rate,
                message.accel_range_mps2,
                message.gyro_range_radps,
                message.streaming,
            )
        case SelfTestResult():
            return _STATUS.pack(message.status)
        case Acknowledgement():
            return _ACKNOWLEDGEMENT.pack(_NAMES.get(message.command, 0), message.outcome)
        case Compensation():
            terms = pack_terms(message.f_mps2, message.g_radps)
            return terms + struct.pack("<II", message.writes, message.crc)
        case SetRate():
            return _RATE.pack(round(message.rate_hz * 1e3))
        case WriteCompensation():
            terms = pack_terms(message.f_mps2, message.g_radps)
            return terms + CRC.pack(terms_crc(message.f_mps2, message.g_radps))
        case _:
            return b""


def _text(text: str) -> bytes:
    """Return an ASCII text that fits sixteen bytes."""
    raw = text.encode("ascii")
    if len(raw) > 16 or b"\0" in raw:
        raise ValueError(f"{text!r} is not a text of 16 ASCII characters or fewer")
    return raw


def decode_message(frame: Frame) -> Received | None:
    """Return what a frame other than data says, or None where its content is none that this version knows."""
    _, _, kind, _, sequence, time_us = HEADER.unpack_from(frame.data)
    try:
        message = _message(kind, frame.data[HEADER.size : -CRC.size])
    except (
        ValueError,
        IndexError,
    ):  # an unknown outcome or gyro kind, a text that is not ASCII, terms with a wrong CRC
        return None
    return Received(message, sequence, time_us / 1e6, frame.host_time_s)


def _message(kind: int, payload: bytes) -> Message:
    """Return the message of a payload whose length fits its type."""
    match kind:
        case Kind.IDENTITY:
            *texts, gyro = _IDENTITY.unpack(payload)
            model, serial, firmware = (text.rstrip(b"\0").decode("ascii") for text in texts)
            return Identity(model, serial, firmware, GYRO_KINDS[gyro])
        case Kind.CONFIGURATION:
            rate_mhz, bit_rate, accel_range, gyro_range, streaming = _CONFIGURATION.unpack(payload)
            return Configuration(rate_mhz / 1e3, bit_rate, accel_range, gyro_range, bool(streaming))
        case Kind.SELF_TEST_RESULT:
            return SelfTestResult(Status(_STATUS.unpack(payload)[0]))
        case Kind.ACKNOWLEDGEMENT:
            command, outcome = _ACKNOWLEDGEMENT.unpack(payload)
            return Acknowledgement(_COMMANDS[command].__name__ if command in _COMMANDS else "", Outcome(outcome))
        case Kind.COMPENSATION:
            *terms, writes, crc = _COMPENSATION.unpack(payload)
            return Compensation((terms[0], terms[1], terms[2]), (terms[3], terms[4], terms[5]), writes, crc)
        case Kind.SET_RATE:
            return SetRate(_RATE.unpack(payload)[0] / 1e3)
        case Kind.WRITE_COMPENSATION:
            *terms, crc = _WRITE.unpack(payload)
            if crc != zlib.crc32(payload[: -CRC.size]):
                raise ValueError("the terms do not match their CRC")
            return WriteCompensation((terms[0], terms[1], terms[2]), (terms[3], terms[4], terms[5]))
        case _:
            command_without_payload: Message = _COMMANDS[kind]()
            return command_without_payload
