"""One input of a fuzzer, run through everything that reads a line; ``test_fuzz.py`` and ``fuzz_run.py`` feed it."""

from __future__ import annotations

import random
from functools import cache
from itertools import accumulate
from pathlib import Path

import numpy as np
from protocol_bench import CASES, reseal

from drivers.framing import Splitter, sync_finder
from drivers.protocols import get_protocol
from drivers.protocols.base import Frame, Protocol
from drivers.stream import StreamDecoder

CORPUS = Path(__file__).with_name("corpus")
PROTOCOLS: list[Protocol] = [*(case.protocol for case in CASES), get_protocol("novatel")]
NAMES = [*map(str, CASES), "novatel"]
LONGEST_INPUT = 128
CHUNKS = (LONGEST_INPUT, LONGEST_INPUT, 64, 23)
BYTE_S = 10 / 921600
PAUSE_S = 0.3
CHANGES = (0, 1, 1, 2, 5)
INTERESTING = [bytes([byte]) for byte in (0, 1, 0x7F, 0x80, 0xFF)] + [bytes(4), b"\xff" * 4, b"\x7f\xc0\0\0"]
# What the second byte of an input asks for, bit by bit; bits 6 and 7 choose the size of the reads. What costs most
# is asked for by two bits, and so less often by chance.
PAUSES, OPENED_AGAIN, TAKE_BETWEEN, COMPILED = (1 << bit for bit in range(4))
SEAL, COMPARE = 0x10 | COMPILED, 0x20 | COMPILED
WAYS = (0, TAKE_BETWEEN | OPENED_AGAIN | 0x80, SEAL, COMPARE | PAUSES | 0xC0)


def one_input(data: bytes) -> None:
    """Read a stream as a line and as a replay would; raise on anything that must not be.

    The first byte chooses the protocol and the second how the rest arrives. Where it asks for ``SEAL``, whatever
    measures as a frame gets a right checksum, so that decoders meet content that no device would send.
    """
    if len(data) < 3:
        return
    which, how, stream = data[0] % len(PROTOCOLS), data[1], data[2:]
    protocol = PROTOCOLS[which]
    if how & SEAL == SEAL:
        stream = sealed(which, stream)
    size = CHUNKS[how >> 6]
    step_s = PAUSE_S if how & PAUSES else size * BYTE_S
    chunks = [stream[place : place + size] for place in range(0, len(stream), size)]
    times_s = [100.0 + step_s * (number + 1) for number in range(len(chunks))]
    if how & COMPARE == COMPARE:
        compare(protocol, stream, chunks, times_s)
        return
    decoder = StreamDecoder(protocol)
    if how & COMPILED:
        decoder.feed_stretch(*stretch(stream, chunks, times_s))
    else:
        for number, (chunk, time_s) in enumerate(zip(chunks, times_s, strict=True)):
            if how & OPENED_AGAIN and number == len(chunks) // 2:
                decoder.opened(time_s)
            decoder.feed(chunk, time_s)
            if how & TAKE_BETWEEN:
                judge(decoder, decoder.take(time_s).samples)
    decoder.finish()
    judge(decoder, decoder.take().samples)
    assert decoder.counters.bytes_in == len(stream)


def stretch(stream: bytes, chunks: list[bytes], times_s: list[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a stream as a replay feeds it."""
    return np.frombuffer(stream, np.uint8), np.cumsum([len(chunk) for chunk in chunks]), np.array(times_s)


def compare(protocol: Protocol, stream: bytes, chunks: list[bytes], times_s: list[float]) -> None:
    """Split byte for byte and by compiled code: the same frames, and every byte in one or counted as discarded."""
    plain, fast = Splitter(protocol), Splitter(protocol)
    found: list[Frame] = []
    for chunk, time_s in zip(chunks, times_s, strict=True):
        found += plain.feed(chunk, time_s)
        assert plain.pending <= protocol.longest + len(chunk)
    found += plain.restart(times_s[-1])
    assert len(stream) == plain.counters.bytes_discarded + sum(len(frame.data) for frame in found)
    assert [*fast.feed_stretch(*stretch(stream, chunks, times_s)), *fast.restart(times_s[-1])] == found
    assert fast.counters == plain.counters


def judge(decoder: StreamDecoder, samples: np.ndarray) -> None:
    """Hold samples to what everything above relies on."""
    for column in ("time", "dv", "dtheta"):
        assert np.isfinite(samples[column]).all()
    assert len(samples) <= decoder.counters.frames


def sealed(which: int, stream: bytes) -> bytes:
    """Return a stream in which whatever measures as a frame has a right checksum."""
    protocol, out, place = PROTOCOLS[which], bytearray(stream), 0
    find = sync_finder(protocol.sync).search
    while sync := find(out, place):
        start = sync.start()
        length = protocol.measure(out, start, len(out))
        place = start + 1
        if 0 < length <= len(out) - start:
            frame = out[start : start + length]
            reseal(protocol, frame)
            out[start : start + length] = frame
            place = start + length
    return bytes(out)


def lines_of(path: Path) -> list[tuple[str, bytes]]:
    """Return the lines of a corpus file: what each is, ``frame`` or ``junk``, and its bytes."""
    lines = [line.split("#")[0].split() for line in path.read_text().splitlines()]
    return [(words[0], bytes.fromhex("".join(words[1:]))) for words in lines if words]


def seeds() -> list[bytes]:
    """Return the corpus as inputs, each in the ways that reach different code."""
    found = []
    for path in sorted(CORPUS.glob("*.hex")):
        which = NAMES.index(path.stem)
        stream = stream_of(which)[: LONGEST_INPUT - 2]
        found += [bytes([which, how]) + stream for how in WAYS]
    return found


def storm(which: int, seed: int, count: int) -> None:
    """Read ``count`` mutated pieces of the corpus as one stream that goes on and on; raise on what must not be.

    Long streams meet what single inputs cannot, a decoder that remembers, and cost a fiftieth of it. A sixteenth of the
    pieces get right checksums. Every eighth stream is split by both splitters, which must agree; else by each in turn.
    """
    rng, protocol = random.Random(seed), PROTOCOLS[which]
    pieces = mutated(which, rng, count)
    for number in range(0, count, 16):
        pieces[number] = sealed(which, pieces[number])
    stream = b"".join(pieces)
    size = rng.choice((31, 300, 4095))
    chunks = [stream[place : place + size] for place in range(0, len(stream), size)]
    steps_s = [rng.choice((1.0, 1.0, 1.0, rng.expovariate(0.01))) * size * BYTE_S for _ in chunks]
    times_s = list(accumulate(steps_s, initial=100.0))[1:]
    if seed % 8 == 0:
        compare(protocol, stream, chunks, times_s)
        return
    decoder = StreamDecoder(protocol)
    if seed % 2:
        decoder.feed_stretch(*stretch(stream, chunks, times_s))
    else:
        for number, (chunk, time_s) in enumerate(zip(chunks, times_s, strict=True)):
            decoder.feed(chunk, time_s)
            if number % 200 == 199:
                judge(decoder, decoder.take(time_s).samples)
    decoder.finish()
    judge(decoder, decoder.take().samples)
    assert decoder.counters.bytes_in == len(stream)


def mutated(which: int, rng: random.Random, count: int) -> list[bytes]:
    """Return pieces of the corpus' stream, each with bytes changed, put in, taken out or repeated."""
    whole, chance, found = stream_of(which), rng.random, []
    for _ in range(count):
        start = int(chance() * len(whole))
        piece = bytearray(whole[start : start + 1 + int(chance() * LONGEST_INPUT)])
        for _ in range(CHANGES[int(chance() * len(CHANGES))]):
            place, how, size = int(chance() * (len(piece) + 1)), chance(), 1 + int(chance() * 8)
            if how < 0.4:
                piece[place : place + 1] = INTERESTING[int(chance() * len(INTERESTING))]
            elif how < 0.6:
                piece[place:place] = rng.randbytes(size)
            elif how < 0.8:
                del piece[place : place + size]
            else:
                piece[place : place + 4] = piece[:size]
        found.append(bytes(piece))
    return found


@cache
def stream_of(which: int) -> bytes:
    """Return all that the corpus has of one protocol."""
    return b"".join(data for _, data in lines_of(CORPUS / f"{NAMES[which]}.hex"))
