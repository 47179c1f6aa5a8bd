"""Raw captures: nothing written is lost to a cut, and a replay is what a live line would have said."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from driver_bench import counting_samples, encoded, until

from drivers.capture import CaptureError, CaptureWriter, RecordKind, describe_line, read_capture, replay
from drivers.capture_parts import pieces
from drivers.counters import Counters
from drivers.messages import Start
from drivers.protocols import get_protocol
from drivers.protocols.native import encode_message

NATIVE = get_protocol("native")
SAMPLES = counting_samples(500)
STREAM = b"".join(encoded(SAMPLES))


def write_stream(path: Path, stream: bytes = STREAM, seed: int = 0) -> list[tuple[float, bytes]]:
    """Write a stream in uneven chunks, as a line delivers it; return them."""
    rng, chunks, place = random.Random(seed), [], 0
    writer = CaptureWriter(path)
    writer.write(describe_line(url="loop://", protocol="native"), 0.0, RecordKind.OPENED)
    while place < len(stream):
        size = rng.randint(1, 200)
        chunks.append((place / 6000, stream[place : place + size]))
        writer.write(chunks[-1][1], chunks[-1][0])
        place += size
    writer.close()
    return chunks


def test_every_record_reads_back_as_written(tmp_path: Path) -> None:
    chunks = write_stream(tmp_path / "a.cap")
    opened, *records = read_capture(tmp_path / "a.cap")
    assert opened.kind is RecordKind.OPENED
    assert [(record.host_time_s, record.data) for record in records] == chunks


def test_replay_gives_every_sample(tmp_path: Path) -> None:
    write_stream(tmp_path / "a.cap")
    counters = Counters()
    batches = list(replay(tmp_path / "a.cap", NATIVE, counters=counters, batch_bytes=4096))
    assert len(batches) > 1
    assert np.concatenate([batch.samples for batch in batches]).tobytes() == SAMPLES.tobytes()
    assert np.all(np.diff(np.concatenate([batch.host_time_s for batch in batches])) >= 0)
    assert (counters.samples, counters.bytes_discarded) == (500, 0)


@pytest.mark.parametrize("seed", range(30))
def test_cut_anywhere_the_rest_reads(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "a.cap"
    chunks = write_stream(path)
    whole = path.read_bytes()
    cut = random.Random(seed).randrange(60, len(whole))
    path.write_bytes(whole[:cut])
    records = [record for record in read_capture(path) if record.kind is RecordKind.RECEIVED]
    assert [(record.host_time_s, record.data) for record in records] == chunks[: len(records)]
    assert len(whole[:cut]) - sum(24 + len(record.data) for record in records) < 24 + 24 + 200 + 60


@pytest.mark.parametrize("seed", range(10))
def test_a_hole_costs_the_records_it_touches_and_no_other(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "a.cap"
    chunks = write_stream(path)
    whole, rng = path.read_bytes(), random.Random(seed)
    start = rng.randrange(60, len(whole) - 500)
    path.write_bytes(whole[:start] + whole[start + rng.randint(1, 400) :])
    kept = [(record.host_time_s, record.data) for record in read_capture(path) if record.kind is RecordKind.RECEIVED]
    assert set(kept) < set(chunks)
    assert kept == sorted(kept)
    assert sum(len(data) for _, data in chunks) - sum(len(data) for _, data in kept) <= 400 + 2 * 200


def parts_of(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def write_split(path: Path, stream: bytes, packed: bool = False, size: int = 77) -> None:
    """Write a stream in chunks that hold no whole frame for sure, in parts of about 5000 bytes."""
    writer = CaptureWriter(path, protocol=NATIVE, part_bytes=5000, packed=packed)
    for start in range(0, len(stream), size):
        data = stream[start : start + size]
        writer.write(data, (start + len(data)) / 92160)
    writer.close()


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("size", [1, 7, 60, 977])
def test_parts_begin_with_whole_frames_and_say_together_what_one_would(tmp_path: Path, size: int, packed: bool) -> None:
    write_split(tmp_path / "a.cap", STREAM, packed, size)
    ending = ".cap.gz" if packed else ".cap"
    count = len(parts_of(tmp_path))
    assert parts_of(tmp_path) == sorted([f"a{ending}", *(f"a.{number}{ending}" for number in range(1, count))])
    assert count > 3
    found = list(replay(tmp_path / "a.cap", NATIVE))
    assert np.concatenate([batch.samples for batch in found]).tobytes() == SAMPLES.tobytes()
    arrivals = np.concatenate([batch.host_time_s for batch in found])
    assert arrivals == pytest.approx(np.arange(1, 501) * 60 / 92160, abs=size / 92160 + 1e-6)
    for name in (f"a{ending}", f"a.1{ending}", f"a.2{ending}"):  # each can be read alone
        (tmp_path / name).rename(tmp_path / f"alone{ending}")
        counters = Counters()
        assert list(replay(tmp_path / f"alone{ending}", NATIVE, counters=counters))
        assert counters.bytes_discarded == 0


def test_where_no_frame_ends_a_part_ends_all_the_same(tmp_path: Path) -> None:
    writer = CaptureWriter(tmp_path / "a.cap", protocol=NATIVE, part_bytes=1000)
    for number in range(3):
        writer.write(bytes(2**20), float(number))
    writer.close()
    assert parts_of(tmp_path) == ["a.1.cap", "a.cap"]
    assert len(list(read_capture(tmp_path / "a.cap"))) == 3


def test_a_closed_capture_goes_on_in_another_part(tmp_path: Path) -> None:
    write_split(tmp_path / "a.cap", STREAM[:3000], packed=True)
    write_split(tmp_path / "a.cap", STREAM[3000:6000], packed=True)
    assert parts_of(tmp_path) == ["a.1.cap.gz", "a.cap.gz"]
    data = b"".join(record.data for record in read_capture(tmp_path / "a.cap"))
    assert data == STREAM[:6000]
    assert [record.data for record in read_capture(tmp_path / "a.cap.gz")] == [
        record.data for record in read_capture(tmp_path / "a.cap")
    ]


def test_compressing_twice_gives_the_same_bytes_and_a_crash_meanwhile_loses_nothing(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_split(tmp_path / f"{name}.cap", STREAM[:3000], packed=True)
    assert (tmp_path / "a.cap.gz").read_bytes() == (tmp_path / "b.cap.gz").read_bytes()
    (tmp_path / "b.cap").write_bytes(b"".join(pieces(tmp_path / "b.cap.gz")))  # between rename and removal
    (tmp_path / ".b.cap.gz.part").write_bytes(b"cut")
    assert b"".join(record.data for record in read_capture(tmp_path / "b.cap")) == STREAM[:3000]


@pytest.mark.parametrize("seed", range(12))
def test_a_compressed_part_cut_or_damaged_gives_back_the_rest(tmp_path: Path, seed: int) -> None:
    path, rng = tmp_path / "a.cap", random.Random(seed)
    noise = [rng.randbytes(4000) for _ in range(1000)]  # four members
    writer = CaptureWriter(path, packed=True)
    for number, data in enumerate(noise):
        writer.write(data, float(number))
    writer.close()
    packed = tmp_path / "a.cap.gz"
    whole = bytearray(packed.read_bytes())
    place = rng.randrange(len(whole))
    if seed % 2:
        del whole[place:]
    else:
        whole[place] ^= 0x55
    packed.write_bytes(whole)
    found = [record.data for record in read_capture(path)]
    assert set(found) <= set(noise)
    if seed % 2:  # noise is not made smaller: all ahead of the cut, but for what the deflater still holds
        assert len(found) >= place // 4024 - 40
    else:  # one member of a mebibyte at most
        assert len(found) >= len(noise) - 2**20 // 4000 - 3


def test_writing_goes_on_behind_a_cut_record(tmp_path: Path) -> None:
    path = tmp_path / "a.cap"
    write_stream(path, STREAM[:6000])
    path.write_bytes(path.read_bytes()[:-7])
    write_stream(path, STREAM[6000:])
    data = b"".join(record.data for record in read_capture(path) if record.kind is RecordKind.RECEIVED)
    assert STREAM.startswith(data[:5000])
    assert data.endswith(STREAM[6000:])


def test_a_killed_writer_loses_nothing_it_had_written(tmp_path: Path) -> None:
    path = tmp_path / "a.cap"
    script = (
        "import sys, itertools; from drivers.capture import CaptureWriter\n"
        "writer = CaptureWriter(sys.argv[1])\n"
        "for number in itertools.count():\n"
        "    writer.write(number.to_bytes(4, 'little') * 20, number)\n"
        "    print(number, flush=True)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", script, str(path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for _ in range(200):
        said = int(process.stdout.readline())
    os.kill(process.pid, signal.SIGKILL)
    said = max([said, *(int(line) for line in process.stdout.read().split("\n")[:-1])])
    process.wait()
    numbers = [int.from_bytes(record.data[:4], "little") for record in read_capture(path)]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) > said


def test_what_was_sent_is_replayed_when_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "a.cap"
    writer = CaptureWriter(path)
    writer.write(STREAM[:600], 1.0)
    writer.write(encode_message(Start(), 5), 1.1, RecordKind.SENT)
    writer.close()
    (sent,) = replay(path, NATIVE, direction=RecordKind.SENT)
    assert [received.message for received in sent.messages] == [Start()]
    (received,) = replay(path, NATIVE)
    assert len(received.samples) == 10


def test_a_line_opened_again_is_marked_and_its_half_frame_let_go(tmp_path: Path) -> None:
    writer = CaptureWriter(tmp_path / "a.cap")
    for time_s, data in ((0.0, STREAM[:630]), (0.1, STREAM[1200:1800])):
        writer.write(b"{}", time_s, RecordKind.OPENED)
        writer.write(data, time_s + 0.1)
    writer.close()
    counters = Counters()
    before, batch = replay(tmp_path / "a.cap", NATIVE, counters=counters)
    assert (len(before.samples), len(batch.samples)) == (10, 10)
    assert (before.reopened, batch.reopened) == ([], [0])
    assert [(gap.index, gap.frames) for gap in batch.gaps] == [(0, 10)]
    assert counters.bytes_discarded == 30


def test_what_is_no_capture_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.cap").write_bytes(b"not one at all" * 100)
    with pytest.raises(CaptureError, match=r"a\.cap: holds no whole record"):
        list(read_capture(tmp_path / "a.cap"))
    with pytest.raises(CaptureError, match="No such file"):
        list(read_capture(tmp_path / "b.cap"))
    with pytest.raises(CaptureError, match="cannot be written"):
        CaptureWriter(tmp_path / "a.cap" / "c.cap")


def test_a_closed_writer_takes_no_more_and_harms_nothing(tmp_path: Path) -> None:
    writer = CaptureWriter(tmp_path / "a.cap")
    writer.close()
    writer.close()
    writer.write(b"late", 1.0)
    assert list(read_capture(tmp_path / "a.cap")) == []


def test_records_can_be_read_while_they_are_written(tmp_path: Path) -> None:
    writer = CaptureWriter(tmp_path / "a.cap")
    writer.write(b"first", 1.0)
    started = time.monotonic()
    until(lambda: len(list(read_capture(tmp_path / "a.cap"))) == 1)
    assert time.monotonic() - started < 5
    writer.close()
