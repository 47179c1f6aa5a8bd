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
    (batch,) = replay(tmp_path / "a.cap", NATIVE, counters=counters)
    assert len(batch.samples) == 20
    assert batch.reopened == [10]
    assert [gap.frames for gap in batch.gaps] == [10]
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
