"""Streams of every protocol for the drivers' tests, and the damage that lines do to them."""

from __future__ import annotations

import random
import zlib
from binascii import crc_hqx
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.counters import Counters
from drivers.framing import Splitter
from drivers.protocols import get_protocol
from drivers.protocols.base import Frame, Protocol
from drivers.protocols.checksums import crc32_mpeg2, fletcher16, word_sum
from drivers.protocols.stim300 import CRLF, LENGTHS
from drivers.samples import SampleArray, empty_samples
from drivers.stream import Batch, StreamDecoder


@dataclass(frozen=True)
class Case:
    """One protocol with options, its sample rate, and a header that announces its longest frame."""

    name: str
    options: dict[str, object]
    rate_hz: float
    longest_header: bytes

    @property
    def protocol(self) -> Protocol:
        return get_protocol(self.name, **self.options)

    def __str__(self) -> str:
        return "-".join([self.name, *(str(value) for value in self.options.values())])


CASES = [
    Case("native", {}, 100.0, bytes.fromhex("c749549e01065000")),
    Case("stim300", {}, 2000.0, b"\xf7"),
    Case("stim300", {"crlf": "false", "datagram": "rate+acc"}, 125.0, b"\xaf"),
    Case("stim300", {"crlf": "true", "gyro_output": "incremental", "accel_output": "incremental"}, 500.0, b"\xf7"),
    Case("stim300", {"gyro_output": "integrated", "accel_output": "integrated"}, 1000.0, b"\xf7"),
    Case("kvh1750", {"format": "A"}, 1000.0, bytes.fromhex("fe81ff56")),
    Case(
        "kvh1750", {"format": "B", "gyro_output": "incremental", "angle_unit": "deg"}, 1000.0, bytes.fromhex("fe81ff56")
    ),
    Case("kvh1750", {"format": "C", "accel_output": "incremental"}, 1000.0, bytes.fromhex("fe81ff56")),
    Case("vectornav", {}, 200.0, bytes.fromhex("fa05ff7fff1f")),
    Case("vectornav", {"message": "rate"}, 200.0, bytes.fromhex("fa05ff7fff1f")),
    Case("mip", {}, 500.0, bytes.fromhex("756580ff0e04")),
    Case("mip", {"message": "rate"}, 500.0, bytes.fromhex("756580ff")),
    Case("xsens", {}, 100.0, bytes.fromhex("faff36ff08005040")),
    Case("xsens", {"message": "rate"}, 100.0, bytes.fromhex("faff36fe")),
    Case("hg4930", {}, 100.0, bytes.fromhex("0e02")),
    Case("hg4930", {"message": "control"}, 600.0, bytes.fromhex("0e01")),
]


def moving_samples(count: int, rate_hz: float, first: int = 0, seed: int = 0) -> SampleArray:
    """Return samples of a block that turns and shakes within every device's range, from frame ``first`` on."""
    rng = np.random.default_rng(seed)
    samples = empty_samples(count, 3)
    samples["sequence"] = np.arange(first, first + count)
    samples["time"] = (np.arange(first, first + count) + 1) / rate_hz
    samples["dv"] = (rng.normal(0, 1.0, (count, 3)) + np.array([0.3, -0.2, 9.8])) / rate_hz
    samples["dtheta"] = rng.normal(0, 0.2, (count, 3)) / rate_hz
    samples["temperature"] = 25.0 + rng.integers(-20, 20, (count, 3))
    samples["supply"] = np.float32(28.0)
    return samples


def frames_of(case: Case, samples: SampleArray) -> list[bytes]:
    """Return the frames of samples one by one; fields of all have one length in these streams."""
    data = case.protocol.encode_samples(samples)
    size = len(data) // max(len(samples), 1)
    return [data[start : start + size] for start in range(0, len(data), size)]


def bare(case: Case, frames: list[bytes]) -> list[bytes]:
    """Return frames of a case as :func:`bare_of` its protocol."""
    return bare_of(case.protocol, frames)


def bare_of(protocol: Protocol, frames: list[bytes]) -> list[bytes]:
    """Return frames without the CR LF of a STIM300, which stands behind them as sent and ahead of them as found."""
    if protocol.name != "stim300":
        return frames
    stripped = [frame.removeprefix(b"\r\n") for frame in frames]
    return [frame[: LENGTHS[frame[0]]] for frame in stripped]


def reseal(protocol: Protocol, frame: bytearray) -> None:
    """Put a right checksum on a frame whose fields were made up."""
    match protocol.name:
        case "native":
            frame[-4:] = zlib.crc32(frame[:-4]).to_bytes(4, "little")
        case "novatel":
            frame[-4:] = (zlib.crc32(frame[:-4], 0xFFFFFFFF) ^ 0xFFFFFFFF).to_bytes(4, "little")
        case "xsens":
            frame[-1] = -sum(frame[1:-1]) & 0xFF
        case "hg4930":
            frame[-2:] = word_sum(frame[:-2]).to_bytes(2, "little")
        case "vectornav":
            frame[-2:] = crc_hqx(frame[1:-2], 0).to_bytes(2, "big")
        case "mip":
            frame[-2:] = fletcher16(frame[:-2])
        case "stim300":
            start = len(CRLF) if frame.startswith(CRLF) else 0
            end = start + LENGTHS.get(frame[start], len(frame) - start)
            frame[end - 4 : end] = crc32_mpeg2(frame[start : end - 4], -(end - start - 4) % 4)
            frame[end:] = CRLF[: len(frame) - end]
        case "kvh1750" if frame[2] == 0:  # a self-test frame
            frame[-1] = sum(frame[:-1]) & 0xFF
        case _:
            frame[-4:] = crc32_mpeg2(frame[:-4], -len(frame) % 4)


def split(stream: bytes, protocol: Protocol, seed: int = 0, bit_rate: float = 921600) -> tuple[list[bytes], Counters]:
    """Split a stream that comes in reads of chance at the bit rate and then ends."""
    rng = random.Random(seed)
    splitter = Splitter(protocol, bit_rate)
    frames: list[Frame] = []
    place, now_s = 0, 0.0
    while place < len(stream):
        chunk = stream[place : place + rng.randint(1, 300)]
        place += len(chunk)
        now_s += len(chunk) * 10 / bit_rate
        frames += splitter.feed(chunk, now_s)
    frames += splitter.restart(now_s)
    counters = splitter.counters
    assert counters.bytes_in == len(stream) == counters.bytes_discarded + sum(len(frame.data) for frame in frames)
    return [frame.data for frame in frames], counters


def decode(
    case: Case | Protocol,
    frames: list[bytes],
    host_s: Callable[[int], float] | None = None,
    together: int = 50,
) -> tuple[Batch, StreamDecoder]:
    """Decode frames that arrive at ``host_s(index)``, ``together`` in a batch; without it at no time at all."""
    protocol = case.protocol if isinstance(case, Case) else case
    decoder = StreamDecoder(protocol, 1e9)
    batches = []
    for start in range(0, len(frames), together):
        for index in range(start, min(start + together, len(frames))):
            decoder.feed(frames[index], host_s(index) if host_s else 0.0)
        batches.append(decoder.take())
    decoder.finish()
    batches.append(decoder.take())
    rows = np.cumsum([0, *(len(batch.samples) for batch in batches)]).tolist()
    whole = Batch(
        np.concatenate([batch.samples for batch in batches]),
        np.concatenate([batch.host_time_s for batch in batches]),
        [received for batch in batches for received in batch.messages],
        [gap for batch in batches for gap in batch.gaps],
        [row + base for batch, base in zip(batches, rows, strict=False) for row in batch.restarts],
    )
    whole.conditions = batches[-1].conditions
    return whole, decoder
