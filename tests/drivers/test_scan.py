"""The compiled splitter: frame for frame, count for count and time for time what the live one says, on any bytes."""

from __future__ import annotations

import random
import zlib

import numpy as np
import pytest
from driver_bench import counting_samples
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.counters import Counters
from drivers.crc import mpeg2_tables, zlib_tables
from drivers.framing import Splitter
from drivers.messages import Identity, SelfTestResult
from drivers.protocols import get_protocol
from drivers.protocols.base import Frame, Protocol
from drivers.samples import Status
from drivers.stream import StreamDecoder

PROTOCOLS = {
    "native": get_protocol("native"),
    "stim300": get_protocol("stim300"),
    "stim300 with CR LF": get_protocol("stim300", crlf="true"),
    "stim300 without CR LF": get_protocol("stim300", crlf="false"),
    "kvh1750": get_protocol("kvh1750"),
    "hg4930": get_protocol("hg4930"),
}
OTHERS = {
    "native": [Identity("A", "1", "2"), SelfTestResult(Status(0))],
    "stim300": [Identity("A", "1", "2"), SelfTestResult(Status(0))],
    "kvh1750": [SelfTestResult(Status(0))],
}
"""Frames of other lengths and checksums that stand between the samples."""
LATENCY_S = 0.1


def stream_of(protocol: Protocol, count: int) -> bytes:
    """Return frames at 2000 Hz, which every protocol here can send."""
    samples = counting_samples(count)
    samples["time"] = (samples["sequence"] + 1) / 2000
    half = count // 2
    others = b"".join(protocol.encode_message(message) for message in OTHERS.get(protocol.name, []))
    return protocol.encode_samples(samples[:half]) + others + protocol.encode_samples(samples[half:])


def damaged(stream: bytes, rng: random.Random, faults: int) -> bytes:
    """Flip bits, cut and repeat spans, put in garbage and heads of frames that do not follow."""
    data = bytearray(stream)
    for _ in range(faults):
        if not data:
            break
        place = rng.randrange(len(data))
        match rng.randrange(4):
            case 0:
                data[place] ^= 1 << rng.randrange(8)
            case 1:
                del data[place : place + rng.randrange(1, 50)]
            case 2:
                data[place:place] = rng.randbytes(rng.randrange(1, 80))
            case _:
                start = rng.randrange(len(data))
                data[place:place] = data[start : start + rng.randrange(1, 12)]
    return bytes(data)


def chunks_of(data: bytes, rng: random.Random, longest: int) -> list[tuple[bytes, float]]:
    """Cut a stream into chunks, some empty, with pauses long enough to time out now and then."""
    chunks, place, time_s = [], 0, 5.0
    while place < len(data):
        size = rng.choice([0, 1, 3, longest // 2, longest, rng.randrange(1, longest + 1)])
        time_s += size / 92160 + rng.choice([0, 0, 0, 0.001, 0.08, 0.15, 0.4])
        chunks.append((data[place : place + size], time_s))
        place += size
    return chunks


def live(protocol: Protocol, stretches: list[list[tuple[bytes, float]]]) -> tuple[list[Frame], Counters]:
    splitter = Splitter(protocol, latency_s=LATENCY_S)
    frames = [frame for chunks in stretches for data, time_s in chunks for frame in splitter.feed(data, time_s)]
    return frames + splitter.restart(float("-inf")), splitter.counters


def compiled(protocol: Protocol, stretches: list[list[tuple[bytes, float]]]) -> tuple[list[Frame], Counters]:
    splitter = Splitter(protocol, latency_s=LATENCY_S)
    frames: list[Frame] = []
    for chunks in stretches:
        data = np.frombuffer(b"".join(data for data, _ in chunks), np.uint8)
        ends = np.cumsum([len(data) for data, _ in chunks])
        frames += splitter.feed_stretch(data, ends, np.array([time_s for _, time_s in chunks]))
    return frames + splitter.restart(float("-inf")), splitter.counters


@pytest.mark.parametrize("name", PROTOCOLS)
@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_compiled_splitter_says_what_the_live_one_says(name: str, seed: int) -> None:
    rng, protocol = random.Random(seed), PROTOCOLS[name]
    stream = stream_of(protocol, rng.randrange(1, 60))
    stream = damaged(stream, rng, rng.randrange(12))
    if not stream:
        return
    chunks = chunks_of(stream, rng, rng.choice([2, 20, 200, 2000]))
    cuts = sorted(rng.sample(range(len(chunks) + 1), min(3, len(chunks))))
    stretches = [chunks[low:high] for low, high in zip([0, *cuts], [*cuts, len(chunks)], strict=True)]
    assert compiled(protocol, stretches) == live(protocol, stretches)


@settings(max_examples=200, deadline=None)
@given(data=st.binary(max_size=400), size=st.integers(1, 50), step_s=st.sampled_from([0.0, 0.01, 0.2]))
def test_on_bytes_that_mean_nothing_too(data: bytes, size: int, step_s: float) -> None:
    for protocol in PROTOCOLS.values():
        pieces = [data[start : start + size] for start in range(0, len(data), size)]
        chunks = [(piece, number * step_s) for number, piece in enumerate(pieces)]
        assert compiled(protocol, [chunks]) == live(protocol, [chunks])


def test_live_chunks_and_stretches_may_follow_each_other() -> None:
    protocol = PROTOCOLS["native"]
    stream = stream_of(protocol, 30)
    mixed, plain = Splitter(protocol), Splitter(protocol)
    frames = mixed.feed(stream[:100], 1.0)
    frames += mixed.feed_stretch(np.frombuffer(stream[100:1000], np.uint8), np.array([450, 900]), np.array([1.1, 1.2]))
    frames += mixed.feed(stream[1000:], 1.3)
    expected = [(stream[:100], 1.0), (stream[100:550], 1.1), (stream[550:1000], 1.2), (stream[1000:], 1.3)]
    assert frames == [frame for data, time_s in expected for frame in plain.feed(data, time_s)]
    assert len(frames) == 32


@pytest.mark.parametrize("name", PROTOCOLS)
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_stream_decodes_alike_by_chunk_and_by_stretch(name: str, seed: int) -> None:
    """What a live line does when it has fallen behind: the same batches, samples and marks, of damaged streams too."""
    rng, protocol = random.Random(seed), PROTOCOLS[name]
    stream = damaged(stream_of(protocol, 300), rng, 6)
    chunks = [(time_s, data) for data, time_s in chunks_of(stream, rng, 300)]
    behind, plain = StreamDecoder(protocol), StreamDecoder(protocol)
    behind.prepare()
    for start in range(0, len(chunks), 100):
        behind.feed_chunks(chunks[start : start + 100])
        for time_s, data in chunks[start : start + 100]:
            plain.feed(data, time_s)
        batches = behind.take(), plain.take()
        assert batches[0].samples.tobytes() == batches[1].samples.tobytes()
        assert batches[0].host_time_s.tolist() == batches[1].host_time_s.tolist()
        assert (batches[0].gaps, batches[0].restarts) == (batches[1].gaps, batches[1].restarts)
    assert behind.counters == plain.counters


@pytest.mark.parametrize("name", PROTOCOLS)
def test_no_untouched_frame_is_lost(name: str) -> None:
    """A bit in each tenth frame is flipped, and garbage stands ahead of each seventh."""
    rng, protocol, count = random.Random(4), PROTOCOLS[name], 2000
    samples = counting_samples(count)
    samples["time"] = (samples["sequence"] + 1) / 2000
    stream = protocol.encode_samples(samples)
    size = len(stream) // count
    frames = [bytearray(stream[start : start + size]) for start in range(0, len(stream), size)]
    touched = set(range(0, count, 10))
    for index in touched:
        frames[index][rng.randrange(size)] ^= 1 << rng.randrange(8)
    spoiled = b"".join((rng.randbytes(9) if number % 7 == 0 else b"") + frame for number, frame in enumerate(frames))
    found, _ = compiled(protocol, [[(spoiled, 0.0)]])
    bodies = {frame.data.strip(b"\r\n") for frame in found}
    assert all(bytes(frames[index]).strip(b"\r\n") in bodies for index in set(range(count)) - touched)


def test_tables_give_the_known_answers() -> None:
    """CRC-32 of "123456789" is CBF43926; its MPEG-2 form 0376E6E7."""
    word = b"123456789"
    crc = 0xFFFFFFFF
    for byte in word:
        crc = int(zlib_tables()[0, (crc ^ byte) & 255]) ^ crc >> 8
    assert crc ^ 0xFFFFFFFF == zlib.crc32(word) == 0xCBF43926
    crc = 0xFFFFFFFF
    for byte in word:
        crc = int(mpeg2_tables()[0, crc >> 24 ^ byte]) ^ crc << 8 & 0xFFFFFFFF
    assert crc == 0x0376E6E7
