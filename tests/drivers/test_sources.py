"""What a line said, whatever file it was kept in: captures, bare bytes, hexadecimal text; and what becomes of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from driver_bench import counting_samples, encoded

from drivers.capture import CaptureError, CaptureWriter
from drivers.continuity import Gap
from drivers.counters import Counters
from drivers.hex_text import HexTextError, looks_like_hex, read_hex
from drivers.mcap_log import SCHEMAS, write_mcap
from drivers.messages import Identity, Received
from drivers.protocols import get_protocol
from drivers.samples import Status
from drivers.sources import SourceKind, read_source, source_kind

NATIVE = get_protocol("native")
SAMPLES = counting_samples(300)
STREAM = b"".join(encoded(SAMPLES))


def kept_as(kind: SourceKind, path: Path) -> Path:
    """Keep the stream as one kind of file."""
    if kind is SourceKind.CAPTURE:
        writer = CaptureWriter(path)
        for start in range(0, len(STREAM), 500):
            writer.write(STREAM[start : start + 500], start / 6000)
        writer.close()
    elif kind is SourceKind.HEX:
        lines = [STREAM[start : start + 60].hex() for start in range(0, len(STREAM), 60)]
        path.write_text("# a remark\n" + "\n".join(lines) + " # another\n\n")
    else:
        path.write_bytes(STREAM)
    return path


@pytest.mark.parametrize("kind", SourceKind)
def test_every_kind_of_file_gives_the_same_samples(tmp_path: Path, kind: SourceKind) -> None:
    path = kept_as(kind, tmp_path / "line")
    assert source_kind(path) is kind
    counters = Counters()
    found = [batch.samples for batch in read_source(path, NATIVE, counters=counters)]
    assert np.concatenate(found).tobytes() == SAMPLES.tobytes()
    assert (counters.bytes_in, counters.bytes_discarded, counters.gaps) == (len(STREAM), 0, 0)


def test_bare_bytes_of_other_devices_are_read_in_pieces(tmp_path: Path) -> None:
    """A protocol without a table goes the slow way, to the same end."""
    protocol = get_protocol("vectornav")
    (tmp_path / "line").write_bytes(protocol.encode_samples(SAMPLES))
    (batch,) = read_source(tmp_path / "line", protocol)
    assert len(batch.samples) == 300


def test_hexadecimal_text_allows_spaces_and_remarks_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "line.hex"
    path.write_text("# head\n0a 0B\t0c # tail\n\n0d\n")
    assert read_hex(path) == bytes([10, 11, 12, 13])
    path.write_text("0a0b\n0a0\n")
    with pytest.raises(HexTextError, match=r"line 2 holds an odd number of digits"):
        read_hex(path)
    path.write_text("0a0b\n\nxx\n")
    with pytest.raises(HexTextError, match=r"line 3 holds something"):
        read_hex(path)


def test_a_remark_alone_or_a_word_is_no_hexadecimal_text() -> None:
    assert not looks_like_hex(b"# only a remark\n")
    assert not looks_like_hex(b"deadbeef and more\n")
    assert looks_like_hex(b"# remark\ndeadbeef\n")


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    (tmp_path / "empty").touch()
    for name, words in (("empty", "is empty"), ("absent", "No such file")):
        with pytest.raises(CaptureError, match=words):
            list(read_source(tmp_path / name, NATIVE))
    (tmp_path / "odd.hex").write_text("0a\n0\n")
    with pytest.raises(CaptureError, match=r"odd\.hex: line 2"):
        list(read_source(tmp_path / "odd.hex", NATIVE))


def test_the_real_power_up_is_read_as_its_readme_says(shared_data: Path) -> None:
    """8,392 good datagrams at 2000 Hz and a cut one; the start-up bit clears at datagram 562, 0.281 s."""
    path = shared_data / "captures" / "stim300_0x93_powerup_2000Hz_30g.hex"
    counters = Counters()
    (batch,) = read_source(path, get_protocol("stim300", accel_range_g="30"), counters=counters)
    assert (counters.frames, counters.crc_failures, counters.gaps) == (8392, 0, 0)
    starting = (batch.samples["status"] & Status.START_UP) != 0
    assert starting[:562].all()
    assert not starting[562:].any()
    assert batch.samples["time"][562] - batch.samples["time"][0] == pytest.approx(0.281, abs=1e-9)
    gravity = np.linalg.norm(batch.samples["dv"][4000:].mean(axis=0) * 2000)
    assert gravity == pytest.approx(9.80665, rel=0.01)


def messages_of(path: Path) -> list[tuple[str, dict[str, Any], int]]:
    """Return (topic, content, log time [ns]) of a log, by mcap's own reader."""
    reader = pytest.importorskip("mcap.reader", reason="the extra mcap is not installed")
    with path.open("rb") as file:
        found = []
        for schema, channel, message in reader.make_reader(file).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert json.loads(schema.data)["type"] == "object"
            found.append((channel.topic, json.loads(message.data), message.log_time))
    return found


def test_a_log_opens_with_mcaps_own_reader_and_says_all(tmp_path: Path) -> None:
    identity = Received(Identity("A", "B", "C", "dtg"), 0, 1.0, 12.5)
    host_s = 10.0 + SAMPLES["time"]
    samples = SAMPLES.copy()
    samples["status"][7] = Status.OVERLOAD
    samples["supply"][7] = np.nan
    pytest.importorskip("mcap")
    write_mcap(tmp_path / "a.mcap", samples, host_s, [identity], [Gap(3, 2, 0.02)])
    found = messages_of(tmp_path / "a.mcap")
    rows = [content for topic, content, _ in found if topic == "/imu"]
    assert len(rows) == 300
    assert [row["time_s"] for row in rows] == samples["time"].tolist()
    assert [[row["dv_mps"][axis] for axis in "xyz"] for row in rows] == samples["dv"].tolist()
    assert rows[7]["conditions"] == ["OVERLOAD"]
    assert rows[7]["supply_v"] is None
    assert rows[9]["gyro_radps"]["x"] == pytest.approx(samples["dtheta"][9, 0] / 0.01)
    times = [time_ns for _, _, time_ns in found]
    assert times == sorted(times)
    ((block, block_ns),) = [(content, time_ns) for topic, content, time_ns in found if topic == "/block"]
    assert (block["kind"], block["content"]["serial"], block_ns) == ("Identity", "B", 12_500_000_000)
    ((line, line_ns),) = [(content, time_ns) for topic, content, time_ns in found if topic == "/line"]
    assert (line, line_ns) == ({"sequence": 3, "frames": 2, "duration_s": 0.02}, round(host_s[3] * 1e9))
    assert {topic for topic, _, _ in found} == set(SCHEMAS)
