"""Recordings too long to be kept whole: read in pieces, neighbours summed, nothing lost, and memory that stays."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from hypothesis import given
from hypothesis import strategies as st

import drivers.recording
from drivers.recording import RecordingError, RecordingMeta, read_recording, write_recording
from drivers.samples import SampleArray, empty_samples
from drivers.summing import summed

META = RecordingMeta.model_validate({"site": {}, "reference": {}, "block": {"sample_rate_hz": 100.0}})


def samples_of(count: int, first: int = 0, seed: int = 1) -> SampleArray:
    rng = np.random.default_rng(seed)
    samples = empty_samples(count)
    samples["sequence"] = (first + np.arange(count)).astype(np.uint32)
    samples["time"] = 0.01 * np.arange(1, count + 1)
    samples["dv"], samples["dtheta"] = rng.standard_normal((2, count, 3))
    samples["temperature"][:, 0], samples["supply"] = 20.0 + rng.random(count), 28.0
    samples["status"] = 1 << rng.integers(0, 4, count)
    return samples


@given(
    count=st.integers(2, 200),
    together=st.integers(1, 9),
    first=st.sampled_from([0, 7, 2**32 - 50]),
    cuts=st.lists(st.integers(1, 199), max_size=5),
    lost=st.sets(st.integers(1, 198), max_size=20),
)
def test_sums_are_those_of_their_frames_however_the_recording_was_cut(
    count: int, together: int, first: int, cuts: list[int], lost: set[int]
) -> None:
    kept = np.array([k not in lost for k in range(count)])
    samples = samples_of(count, first)[kept]
    pieces = [piece for piece in np.split(samples, sorted({cut for cut in cuts if cut < len(samples)})) if len(piece)]
    found = summed(pieces, together)
    frames = np.flatnonzero(kept)
    wanted = [g for g in range(count // together) if np.sum(frames // together == g) == together]
    assert found["sequence"].tolist() == wanted
    for one, group in zip(found, wanted, strict=True):
        rows = samples[frames // together == group]
        np.testing.assert_allclose(one["dv"], rows["dv"].sum(axis=0), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(one["dtheta"], rows["dtheta"].sum(axis=0), rtol=1e-12, atol=1e-12)
        assert one["time"] == rows["time"][-1]
        assert one["temperature"][0] == pytest.approx(rows["temperature"].mean(), rel=1e-6)
        assert one["status"] == np.bitwise_or.reduce(rows["status"])


@pytest.mark.parametrize("suffix", ["", ".csv"])
@pytest.mark.parametrize("numbered", [True, False])
def test_reading_in_pieces_is_reading_whole_and_summing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, numbered: bool
) -> None:
    monkeypatch.setattr(drivers.recording, "PIECE", 64)
    samples = samples_of(1000)[np.r_[0:300, 340:1000]]
    path = write_recording(tmp_path / f"long{suffix}", samples, META)
    if not numbered and not suffix:
        table = pa.parquet.read_table(path).drop_columns(["sequence"])
        pa.parquet.write_table(table, path)
    whole, short = read_recording(path), read_recording(path, 250)
    np.testing.assert_array_equal(short.samples, summed([whole.samples], 4))
    assert short.meta.block.sample_rate_hz == 25.0
    np.testing.assert_array_equal(read_recording(path, 1001).samples, whole.samples)


def test_a_bad_row_in_a_later_piece_is_named_as_in_the_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drivers.recording, "PIECE", 64)
    samples = samples_of(500)
    samples["dv"][399, 1] = np.nan
    samples["time"][450:] -= 1.0
    path = write_recording(tmp_path / "bad", samples, META)
    for limit in (None, 100):
        with pytest.raises(RecordingError, match=r"row (451|400)\b"):
            read_recording(path, limit)


def test_a_column_that_stands_there_twice_is_refused_however_long_the_recording(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "twice", samples_of(500), META)
    table = pa.parquet.read_table(path)
    pa.parquet.write_table(table.append_column("dv_x_mps", table.column("dv_x_mps")), path)
    for limit in (None, 100):
        with pytest.raises(RecordingError, match="dv_x_mps: stands there twice"):
            read_recording(path, limit)


READ = """
import sys
from drivers.recording import read_recording

def most_kb():
    lines = open("/proc/self/status").read().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))

before = most_kb()
read_recording(sys.argv[1], int(sys.argv[2]) or None)
print(most_kb() - before)
"""


def test_memory_does_not_grow_with_the_length(tmp_path: Path) -> None:
    """Whole groups of 2²⁰ rows, as Parquet keeps them, so that what is read at once is alike."""

    def taken_kb(groups: int, limit: int) -> int:
        path = write_recording(tmp_path / f"{groups}", samples_of(groups << 20), META)
        told = subprocess.run([sys.executable, "-c", READ, str(path), str(limit)], capture_output=True, check=True)
        return int(told.stdout)

    grown, grown_whole = (taken_kb(2, limit) - taken_kb(1, limit) for limit in (20_000, 0))
    assert grown < 0.25 * grown_whole
