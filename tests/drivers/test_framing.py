"""The splitter: no untouched frame is lost, whatever else the line carries, and nothing stalls or grows."""

from __future__ import annotations

import itertools
import random
import struct
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import pytest
from driver_bench import counting_samples, encoded
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.counters import Counters
from drivers.framing import Splitter
from drivers.messages import Start
from drivers.protocols import get_protocol
from drivers.protocols.base import NEED_MORE, NOT_A_FRAME, Buffer, Decoder, Frame, Protocol
from drivers.protocols.native import encode_message
from drivers.samples import SampleArray

NATIVE = get_protocol("native")
FRAMES = encoded(counting_samples(400))
BIT_RATE = 921600
BYTE_S = 10 / BIT_RATE


class FramesOnly(Protocol):
    """A protocol as a splitter sees it: what frames hold it never asks."""

    def decoder(self) -> Decoder:
        raise AssertionError("a splitter does not decode")

    def encode_samples(self, samples: SampleArray) -> bytes:
        raise AssertionError(f"a splitter does not encode ({len(samples)} samples)")


class LongFrames(FramesOnly):
    """The hardest kind to split: one byte of sync, any length up to 64 kB, in the style of public receivers' logs."""

    name: ClassVar[str] = "long"
    sync = (b"\xfa", b"\xfb\xfb")
    longest = 65535 + 7

    def measure(self, data: Buffer, start: int, stop: int) -> int:
        if stop - start < 3:
            return NEED_MORE
        length = int(struct.unpack_from("<H", data, start + 1)[0])
        return length + 7 if length else NOT_A_FRAME

    def check(self, data: Buffer, start: int, stop: int) -> bool:
        return zlib.crc32(data[start : stop - 4]) == int.from_bytes(data[stop - 4 : stop], "little")

    @staticmethod
    def frame(body: bytes) -> bytes:
        head = b"\xfa" + struct.pack("<H", len(body)) + body
        return head + struct.pack("<I", zlib.crc32(head))


class NovAtel(FramesOnly):
    """Just enough of NovAtel's binary framing for the public resynchronisation case."""

    name: ClassVar[str] = "novatel"
    sync = (b"\xaa\x44\x12", b"\xaa\x44\x13")
    longest = 65535 + 32

    def measure(self, data: Buffer, start: int, stop: int) -> int:
        if stop - start < 12:
            return NEED_MORE
        if data[start + 2] == 0x13:
            return 12 + data[start + 3] + 4
        return int(data[start + 3] + struct.unpack_from("<H", data, start + 8)[0]) + 4

    def check(self, data: Buffer, start: int, stop: int) -> bool:
        crc = zlib.crc32(data[start : stop - 4], 0xFFFFFFFF) ^ 0xFFFFFFFF
        return crc == int.from_bytes(data[stop - 4 : stop], "little")


def chunks(data: bytes, rng: random.Random, longest: int = 300) -> Iterator[bytes]:
    """Cut a stream as reads cut it."""
    place = 0
    while place < len(data):
        size = rng.randint(1, longest)
        yield data[place : place + size]
        place += size


def split(stream: bytes, protocol: Protocol = NATIVE, seed: int = 0) -> tuple[list[bytes], Counters]:
    """Split a stream that comes at the bit rate and then ends."""
    splitter = Splitter(protocol, BIT_RATE)
    frames: list[Frame] = []
    now_s = 0.0
    for chunk in chunks(stream, random.Random(seed)):
        now_s += len(chunk) * BYTE_S
        frames += splitter.feed(chunk, now_s)
    frames += splitter.restart(now_s)
    counters = splitter.counters
    assert counters.bytes_in == len(stream) == counters.bytes_discarded + sum(len(frame.data) for frame in frames)
    assert counters.frames == len(frames)
    assert splitter.pending == 0
    return [frame.data for frame in frames], counters


def false_header(rng: random.Random) -> bytes:
    """Return the head of the longest native frame there is, with nothing behind it."""
    return bytes.fromhex("c749549e01065000") + rng.randbytes(rng.randint(0, 20))


@pytest.mark.parametrize("seed", range(20))
def test_no_untouched_frame_is_lost_on_a_damaged_line(seed: int) -> None:
    rng = random.Random(seed)
    stream, untouched, touched = bytearray(), [], 0
    for frame in FRAMES:
        sent = bytearray(frame)
        if rng.random() < 0.01:  # a bit flips
            sent[rng.randrange(len(sent))] ^= 1 << rng.randrange(8)
        if rng.random() < 0.01:  # the frame is cut
            del sent[rng.randrange(len(sent)) :]
        if rng.random() < 0.01:
            stream += rng.randbytes(rng.randint(1, 200))
        if rng.random() < 0.01:
            stream += false_header(rng)
        stream += sent
        untouched += [frame] * (sent == frame)
        touched += sent != frame
    found, counters = split(bytes(stream), seed=seed)
    assert found == untouched
    assert counters.resyncs > 0
    assert touched > 0


@settings(deadline=None)
@given(st.lists(st.one_of(st.sampled_from(FRAMES[:5]), st.binary(max_size=100)), max_size=30), st.integers(0, 2**32))
def test_good_frames_between_anything_at_all_are_found(parts: list[bytes], seed: int) -> None:
    found, _ = split(b"".join(parts), seed=seed)
    wanted = [part for part in parts if part in FRAMES[:5]]
    assert [frame for frame in found if frame in FRAMES[:5]] == wanted


@settings(deadline=None)
@given(st.binary(max_size=2000), st.integers(0, 2**32))
def test_garbage_alone_gives_nothing_and_keeps_little(data: bytes, seed: int) -> None:
    splitter = Splitter(NATIVE, BIT_RATE)
    for chunk in chunks(data, random.Random(seed)):
        splitter.feed(chunk, 0.0)
        assert splitter.pending <= NATIVE.longest


@settings(deadline=None)
@given(st.lists(st.integers(0, 60 * 20), max_size=40))
def test_frames_do_not_depend_on_where_reads_cut_the_stream(cuts: list[int]) -> None:
    stream = b"".join(FRAMES[:20])
    places = [0, *sorted(cuts), len(stream)]
    splitter = Splitter(NATIVE, BIT_RATE)
    found = [f.data for a, b in itertools.pairwise(places) for f in splitter.feed(stream[a:b], a * BYTE_S)]
    assert found == FRAMES[:20]


def test_a_frame_is_given_as_soon_as_its_last_byte_is_there() -> None:
    splitter = Splitter(NATIVE, BIT_RATE)
    assert splitter.feed(FRAMES[0][:-1], 0.0) == []
    assert [frame.data for frame in splitter.feed(FRAMES[0][-1:], 0.001)] == [FRAMES[0]]


def test_a_false_header_with_the_longest_length_delays_the_frames_behind_it_by_a_bounded_time() -> None:
    good = [LongFrames.frame(bytes([number]) * 40) for number in range(100)]
    splitter = Splitter(LongFrames(), BIT_RATE, latency_s=0.05)
    found = [frame.data for frame in splitter.feed(b"\xfa\xff\xff", 0.0)]
    bound_s = 2 * LongFrames.longest * BYTE_S + 0.05
    late_s = []
    for number, frame in enumerate(good):  # ten frames a second: 64 kB of them would take two minutes
        now_s = 0.1 * (number + 1)
        new = splitter.feed(frame, now_s)
        late_s += [now_s - 0.1 * (good.index(one.data) + 1) for one in new]
        found += [one.data for one in new]
    assert found == good
    assert 0 < max(late_s) <= bound_s + 0.1
    assert splitter.counters.timeouts == 1


def test_frames_behind_a_false_header_are_found_though_nothing_more_comes() -> None:
    good = LongFrames.frame(b"alone")
    splitter = Splitter(LongFrames(), BIT_RATE, latency_s=0.05)
    assert splitter.feed(b"\xfa\xff\xff" + good, 0.0) == []
    assert splitter.expire(1.0) == []
    assert [frame.data for frame in splitter.expire(1.5)] == [good]


def test_a_pause_inside_a_good_frame_loses_nothing() -> None:
    splitter = Splitter(NATIVE, BIT_RATE, latency_s=0.05)
    splitter.feed(FRAMES[0][:30], 0.0)
    assert splitter.expire(10.0) == []
    assert splitter.counters.timeouts == 1
    assert [frame.data for frame in splitter.feed(FRAMES[0][30:], 20.0)] == [FRAMES[0]]


def test_two_false_headers_one_behind_the_other_cost_one_time_limit() -> None:
    good = [LongFrames.frame(bytes([number]) * 40) for number in range(50)]
    splitter = Splitter(LongFrames(), BIT_RATE, latency_s=0.05)
    stream = b"\xfa\xff\xff" + b"\xfa\xfe\xff" + b"".join(good)
    assert splitter.feed(stream, 0.0) == []
    assert [frame.data for frame in splitter.expire(2.0)] == good


@pytest.mark.parametrize("piece", [b"\xfa\xff\xff", b"\xfa\x01\x00", b"\xfa", b"\xfb\xfb\x05\x00", b"\x00"])
def test_hostile_streams_cost_time_in_proportion_and_little_memory(piece: bytes) -> None:
    splitter = Splitter(LongFrames(), BIT_RATE)
    stream = piece * (80_000 // len(piece))
    started = time.process_time()
    for place in range(0, len(stream), 100):
        splitter.feed(stream[place : place + 100], place * BYTE_S)
        assert splitter.pending <= LongFrames.longest + 100
    # A CRC over 64 kB for each false header is the worst there is. A new search at each read would take hours.
    assert time.process_time() - started < 30


def test_bytes_are_dated_back_by_the_bit_rate_but_not_before_the_read_ahead() -> None:
    splitter = Splitter(NATIVE, BIT_RATE)
    first, second = splitter.feed(FRAMES[0] + FRAMES[1], 1.0)
    assert second.host_time_s == 1.0
    assert first.host_time_s == pytest.approx(1.0 - 60 * BYTE_S, abs=1e-12)
    (third, fourth) = splitter.feed(FRAMES[2] + FRAMES[3], 1.0001)
    assert (third.host_time_s, fourth.host_time_s) == (1.0, 1.0001)


def test_restart_gives_up_a_half_received_frame_and_no_whole_one() -> None:
    splitter = Splitter(LongFrames(), BIT_RATE)
    good = LongFrames.frame(b"kept")
    splitter.feed(b"\xfa\xff\xff" + good + good[:5], 0.0)
    assert [frame.data for frame in splitter.restart(0.1)] == [good]
    assert splitter.pending == 0
    assert [frame.data for frame in splitter.feed(good, 0.2)] == [good]


def test_each_kind_of_damage_has_its_own_count() -> None:
    flipped = bytearray(FRAMES[1])
    flipped[30] ^= 1
    _, counters = split(FRAMES[0] + bytes(flipped) + FRAMES[2] + b"junk" + FRAMES[3] + encode_message(Start(), 1))
    assert (counters.frames, counters.crc_failures, counters.resyncs) == (4, 1, 2)
    assert counters.bytes_discarded == 60 + 4


def test_the_hardest_public_resynchronisation_case(shared_data: Path) -> None:
    lines = (shared_data / "captures" / "novatel_resync_trick.hex").read_text().splitlines()
    stream = bytes.fromhex("".join(line.strip() for line in lines if not line.startswith("#")))
    found, counters = split(stream, NovAtel())
    assert [len(frame) for frame in found] == [56]
    assert stream.index(found[0]) == 3 + 10 + 1
    assert counters.bytes_discarded == len(stream) - 56
