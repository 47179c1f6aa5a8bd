"""Recordings: what is written reads back exactly; what cannot be analysed is refused by place, reason and remedy."""

from __future__ import annotations

import contextlib
import hashlib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from driver_bench import counting_samples
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.recording import Recording, RecordingError, RecordingMeta, read_recording, write_recording
from drivers.recording_meta import BlockMeta, ReferenceMeta, SiteMeta, TurnMeta, WindowMeta
from drivers.samples import SampleArray, intervals_s

TOML = """
[site]
latitude_deg = 35.7
height_m = 1190.0

[reference]
azimuth_deg = 40.0
azimuth_sigma_deg = 0.1

[block]
sample_rate_hz = 100.0
gyro_kind = "laser"

[[motion]]
kind = "rest"
start_s = 0.0
end_s = 0.05

[[motion]]
kind = "turn"
start_s = 0.05
end_s = 0.1
rate_dps = 1.0
axis = [0.0, 0.0, 1.0]
frame = "body"

[[window]]
kind = "align"
start_s = 0.0
end_s = 0.05
"""
HEADER = "time_s,dv_x_mps,dv_y_mps,dv_z_mps,dtheta_x_rad,dtheta_y_rad,dtheta_z_rad"
ROWS = [f"{0.01 * k:.2f},0.001,-0.002,0.098,1e-6,2e-6,{k}e-7" for k in range(1, 11)]
META = RecordingMeta(site=SiteMeta(latitude_deg=35.7, height_m=1190.0), block=BlockMeta(sample_rate_hz=100.0))


def write_pair(folder: Path, toml: str = TOML, rows: list[str] | None = None, header: str = HEADER) -> Path:
    """Write a pair by hand and return its bare name."""
    (folder / "run.toml").write_text(toml)
    (folder / "run.csv").write_text("\n".join([header, *(ROWS if rows is None else rows)]) + "\n")
    return folder / "run"


def refusal(path: Path) -> str:
    """Return why a recording is refused; the whole text is one line that ends in a remedy."""
    with pytest.raises(RecordingError) as caught:
        read_recording(path)
    text = str(caught.value)
    assert "\n" not in text
    assert text.endswith(f"{caught.value.remedy}.")
    assert caught.value.remedy[0].isupper()
    return text


def roundtrip(folder: Path, samples: SampleArray, meta: RecordingMeta = META) -> Recording:
    """Write and read back."""
    return read_recording(write_recording(folder / "out", samples, meta))


def test_a_pair_written_by_hand_reads_as_it_says(tmp_path: Path) -> None:
    recording = read_recording(write_pair(tmp_path))
    assert len(recording.samples) == 10
    assert recording.samples["time"].tolist() == [float(row.split(",")[0]) for row in ROWS]
    assert recording.samples["dv"][0].tolist() == [0.001, -0.002, 0.098]
    assert recording.samples["dtheta"][9].tolist() == [1e-6, 2e-6, 10e-7]
    assert recording.samples["sequence"].tolist() == list(range(10))
    assert np.isnan(recording.samples["temperature"]).all()
    assert recording.meta.reference.azimuth_deg == 40.0
    assert not recording.meta.reference.level_given
    assert [motion.kind for motion in recording.meta.motion] == ["rest", "turn"]


@pytest.mark.parametrize("name", ["run", "run.csv", "run.toml"])
def test_a_recording_has_several_names(tmp_path: Path, name: str) -> None:
    write_pair(tmp_path)
    assert read_recording(str(tmp_path / name)).path == tmp_path / "run.csv"


def test_what_is_written_reads_back_bit_for_bit(tmp_path: Path) -> None:
    samples = counting_samples(300)[np.r_[0:100, 150:300]]
    rng = np.random.default_rng(1)
    samples["dv"], samples["dtheta"] = rng.normal(size=(250, 3)), rng.normal(size=(250, 3)) * 1e-6
    samples["status"][7] = 2**32 - 1
    samples["temperature"][3, 1] = np.nan
    back = roundtrip(tmp_path, samples)
    assert back.samples.tobytes() == samples.tobytes()
    assert back.path == tmp_path / "out.parquet"


numbers = st.floats(-80, 80, allow_nan=False)


@settings(deadline=None, max_examples=40)
@given(numbers, st.floats(0, 300), st.floats(1e-9, 300), numbers)
def test_every_number_of_the_toml_reads_back_exactly(
    tmp_path_factory: pytest.TempPathFactory, angle: float, start: float, length: float, height: float
) -> None:
    end = start + length if start + length > start else start + 1
    meta = RecordingMeta(
        site=SiteMeta(latitude_deg=angle, height_m=height, gravity_mps2=9.80665),
        reference=ReferenceMeta(azimuth_deg=angle, roll_deg=angle, pitch_deg=angle, level_sigma_deg=abs(angle)),
        block=BlockMeta(sample_rate_hz=100.0, gyro_kind="fibre"),
        motion=[
            TurnMeta(kind="turn", start_s=start, end_s=end, rate_dps=angle, axis=[angle, 1.0, 0.0], frame="tangent")
        ],
        window=[WindowMeta(kind="verify", start_s=1.0, end_s=1.0 + abs(angle) / 100 + 1e-9)],
    )
    assert roundtrip(tmp_path_factory.mktemp("toml"), counting_samples(300), meta).meta == meta


def test_writing_replaces_and_leaves_nothing_else_behind(tmp_path: Path) -> None:
    for count in (10, 20):
        assert len(roundtrip(tmp_path, counting_samples(count)).samples) == count
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.parquet", "out.toml"]
    first = (tmp_path / "out.parquet").read_bytes()
    write_recording(tmp_path / "out.parquet", counting_samples(20), META)
    assert (tmp_path / "out.parquet").read_bytes() == first


def test_new_data_never_stand_beside_an_old_toml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: RecordingMeta) -> str:
        raise OSError(28, "No space left on device")

    write_recording(tmp_path / "run", counting_samples(10), META)
    monkeypatch.setattr("drivers.recording.meta_text", fail)
    with pytest.raises(RecordingError, match="No space left on device"):
        write_recording(tmp_path / "run", counting_samples(20), META)
    assert "run.toml: no such file" in refusal(tmp_path / "run")


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot be written"):
        write_recording(tmp_path / "file" / "out", counting_samples(5), META)


def test_frame_numbers_come_from_time_where_there_are_none(tmp_path: Path) -> None:
    rows = [row for number, row in enumerate(ROWS) if number not in (3, 4)]
    samples = read_recording(write_pair(tmp_path, rows=rows)).samples
    assert samples["sequence"].tolist() == [0, 1, 2, 5, 6, 7, 8, 9]
    assert np.allclose(intervals_s(samples), 0.01, rtol=0, atol=1e-12)


def test_another_makers_log_is_mapped(tmp_path: Path) -> None:
    columns = "".join(
        f'{name} = {{ to = "{to}", scale = 0.5, offset = 100.0, per_second = true }}\n'
        for name, to in zip(["ax", "ay", "az", "gx", "gy", "gz"], HEADER.split(",")[1:], strict=True)
    )
    toml = f'{TOML}\n[columns]\nms = {{ to = "time_s", scale = 0.001 }}\n{columns}'
    rows = [f"{10 * k},101,102,103,104,105,106,77" for k in (1, 2, 3, 5, 6, 7, 8)]
    samples = read_recording(write_pair(tmp_path, toml, rows, "ms,ax,ay,az,gx,gy,gz,magnetometer")).samples
    # (raw - offset) * scale is a rate; each row is integrated over its own interval, not over the gap in front of it.
    assert np.allclose(samples["dv"], np.array([0.5, 1.0, 1.5]) * 0.01, rtol=1e-12)
    assert np.allclose(samples["dtheta"], np.array([2.0, 2.5, 3.0]) * 0.01, rtol=1e-12)
    assert np.allclose(samples["time"], [0.01, 0.02, 0.03, 0.05, 0.06, 0.07, 0.08])


def test_optional_columns_are_read_and_may_have_empty_cells(tmp_path: Path) -> None:
    header = HEADER + ",temperature_c,temperature_2_c,supply_v,status,sequence"
    rows = [f"{row},25.5,,28.0,3,{number + 7}" for number, row in enumerate(ROWS)]
    samples = read_recording(write_pair(tmp_path, rows=rows, header=header)).samples
    assert samples["temperature"].shape == (10, 3)
    assert samples["temperature"][0, 0] == 25.5
    assert np.isnan(samples["temperature"][:, 1:]).all()
    assert samples["supply"][0] == 28.0
    assert samples["status"].tolist() == [3] * 10
    assert samples["sequence"].tolist() == list(range(7, 17))


def test_inputs_are_the_hashes_of_all_files_it_consists_of(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "block.json").write_text("{}")
    recording = read_recording(write_pair(tmp_path, TOML.replace("[block]", '[block]\nmodel = "parts/block.json"')))
    assert recording.model_path == tmp_path / "parts" / "block.json"
    files = ["run.csv", "run.toml", "parts/block.json"]
    assert recording.inputs() == {name: hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() for name in files}


def test_what_an_analysis_needs_and_the_recording_does_not_say_is_asked_for(tmp_path: Path) -> None:
    recording = read_recording(write_pair(tmp_path, TOML.replace("latitude_deg = 35.7\n", "")))
    recording.require("site.height_m")
    with pytest.raises(RecordingError, match=r"run\.toml: \[site\] latitude_deg: is missing and needed"):
        recording.require("site.height_m", "site.latitude_deg")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("latitude_deg", "latitude_rad", "[site] latitude_rad: no such key. Units are part of names: latitude"),
        ("= 35.7", "= 95.0", "[site] latitude_deg: Input should be less than or equal to 90 (got 95.0)"),
        ("= 35.7", '= "35 N"', "[site] latitude_deg: Input should be a valid number (got '35 N')"),
        ("latitude_deg = 35.7", "latitude_deg = nan", "[site] latitude_deg: Input should be a finite number"),
        ("latitude_deg = 35.7", "latitude_deg = 35,7", "is not TOML"),
        ("[site]", "[place]", "place: no such key"),
        ("sample_rate_hz = 100.0", "", "[block] sample_rate_hz: is missing"),
        ("sample_rate_hz = 100.0", "sample_rate_hz = 0.0", "[block] sample_rate_hz: Input should be greater than 0"),
        ("sample_rate_hz = 100.0", "sample_rate_hz = 1.0", "column time_s: comes at 100 Hz"),
        ("[block]", '[block]\nmodel = "no.json"', "[block] model: there is no file no.json"),
        ('"laser"', '"lazer"', "[block] gyro_kind: Input should be 'dtg', 'laser', 'fibre' or 'mems'"),
        ("azimuth_deg = 40.0\n", "", "azimuth_sigma_deg is the sigma of azimuth_deg"),
        ("azimuth_deg = 40.0", "azimuth_deg = 40.0\nroll_deg = 0.0", "roll_deg and pitch_deg stand together"),
        ("azimuth_deg = 40.0", "azimuth_deg = 40.0\nlevel_sigma_deg = 0.1", "level_sigma_deg is the sigma of"),
        ("rate_dps", "rate_radps", "[[motion]] no. 2 rate_radps: no such key. Units are part of names: rate_dps"),
        ("rate_dps = 1.0", "", "[[motion]] no. 2 rate_dps: is missing"),
        ('frame = "body"', 'frame = "table"', "[[motion]] no. 2 frame: Input should be 'body' or 'tangent'"),
        ("[0.0, 0.0, 1.0]", "[0.0, 1.0]", "[[motion]] no. 2 axis: List should have at least 3 items"),
        ("[0.0, 0.0, 1.0]", "[0.0, 0.0, 0.0]", "[[motion]] no. 2: axis has no length"),
        ('kind = "turn"', 'kind = "spin"', "[[motion]] no. 2: Input tag 'spin'"),
        ("start_s = 0.05", "start_s = 0.04", "[[motion]] no. 2 begins at 0.04 s, before no. 1 ends at 0.05 s"),
        ("end_s = 0.1\n", "end_s = 0.01\n", "[[motion]] no. 2: end_s (0.01) must come after start_s (0.05)"),
        ('kind = "align"', 'kind = "allign"', "[[window]] no. 1 kind: Input should be 'align'"),
    ],
)
def test_a_wrong_toml_is_refused_by_place(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in TOML
    text = refusal(write_pair(tmp_path, TOML.replace(old, new)))
    assert said in text
    assert "run." in text


def test_a_window_beyond_the_data_is_refused(tmp_path: Path) -> None:
    window = '[[window]]\nkind = "align"\nstart_s = 0.0\nend_s = 30.0\n'
    text = refusal(write_pair(tmp_path, TOML.partition("[[window]]")[0] + window))
    assert "[[window]] no. 1: 0 to 30 s is not within the data. These run from 0.01 to 0.1 s" in text


def test_windows_come_once_each_and_in_their_order(tmp_path: Path) -> None:
    later = '\n[[window]]\nkind = "{}"\nstart_s = 0.05\nend_s = 0.09\n'
    assert "once each, in the order align" in refusal(write_pair(tmp_path, TOML + later.format("align")))
    read_recording(write_pair(tmp_path, TOML + later.format("stage_1")))


@pytest.mark.parametrize(
    ("row", "cell", "value", "said"),
    [
        (4, 0, "0.04", "run.csv: line 6, column time_s: 0.04 s does not come after 0.04 s"),
        (4, 0, "0.01", "run.csv: line 6, column time_s: 0.01 s does not come after 0.04 s"),
        (4, 0, "nan", "run.csv: line 6, column time_s: is nan"),
        (2, 3, "NaN", "run.csv: line 4, column dv_z_mps: is nan"),
        (2, 3, "", "run.csv: line 4, column dv_z_mps: is nan"),
        (2, 3, "inf", "run.csv: line 4, column dv_z_mps: is inf"),
        (2, 6, "oops", "run.csv: line 4, column dtheta_z_rad: 'oops' is not a number"),
        (9, 6, "1;2", "run.csv: line 11, column dtheta_z_rad: '1;2' is not a number"),
    ],
)
def test_a_wrong_cell_is_refused_by_line_and_column(tmp_path: Path, row: int, cell: int, value: str, said: str) -> None:
    cells = [line.split(",") for line in ROWS]
    cells[row][cell] = value
    assert said in refusal(write_pair(tmp_path, rows=[",".join(line) for line in cells]))


def test_lines_are_counted_as_an_editor_counts_them(tmp_path: Path) -> None:
    rows = [*ROWS[:3], "", "", "0.04,0,0,x,0,0,0", *ROWS[4:]]
    assert "line 7, column dv_z_mps" in refusal(write_pair(tmp_path, rows=rows))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("dv_x_mps", "dv_x_g", "column dv_x_mps: is missing; dv_x_g is perhaps the same in another unit"),
        ("time_s", "time_ms", "column time_s: is missing; time_ms"),
        ("dtheta_z_rad", "dv_z_mps", "column dv_z_mps: stands there twice"),
        (HEADER, "a,b,c,d,e,f,g", "column time_s: is missing"),
    ],
)
def test_a_wrong_column_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert said in refusal(write_pair(tmp_path, header=HEADER.replace(old, new)))


@pytest.mark.parametrize(("column", "known"), [("temperature_f", "temperature_c"), ("supply_mv", "supply_v")])
def test_an_optional_column_in_another_unit_is_refused(tmp_path: Path, column: str, known: str) -> None:
    rows = [row + ",70" for row in ROWS]
    assert f"is {known} in another unit" in refusal(write_pair(tmp_path, rows=rows, header=f"{HEADER},{column}"))


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        ("sequence", "5", "column sequence: 5 does not come after 5"),
        ("sequence", "-1", "column sequence: is -1"),
        ("status", "1.5", "column status: is 1.5"),
        ("status", "5000000000", "column status: is 5e+09"),
        ("supply_v", "inf", "column supply_v: is infinite"),
    ],
)
def test_wrong_optional_cells_are_refused(tmp_path: Path, column: str, value: str, said: str) -> None:
    assert said in refusal(write_pair(tmp_path, rows=[f"{row},{value}" for row in ROWS], header=f"{HEADER},{column}"))


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ('acc = { to = "dv_x_mps" }', "[columns] acc: run.csv has no such column"),
        ('time_s = { to = "dv_x_g" }', 'to = "dv_x_g" is no column of a recording; dv_x_mps is probably meant'),
        ('extra = { to = "dv_x_mps" }', "gives dv_x_mps, which run.csv has itself"),
        ('extra = { to = "supply_v", per_second = true }', "supply_v is no increment"),
        ('extra = { to = "supply_v", scale_v = 2.0 }', "[columns] extra scale_v: no such key"),
        ('extra = { to = "supply_v" }\ntime_s = { to = "supply_v" }', "two columns become supply_v"),
    ],
)
def test_a_wrong_mapping_is_refused(tmp_path: Path, columns: str, said: str) -> None:
    rows = [row + ",70" for row in ROWS]
    assert said in refusal(write_pair(tmp_path, f"{TOML}\n[columns]\n{columns}\n", rows, f"{HEADER},extra"))


def test_a_file_that_is_cut_or_empty_is_refused(tmp_path: Path) -> None:
    write_recording(tmp_path / "run", counting_samples(500), META)
    whole = (tmp_path / "run.parquet").read_bytes()
    for size in (0, 3, len(whole) // 2, len(whole) - 1):
        (tmp_path / "run.parquet").write_bytes(whole[:size])
        assert "run.parquet: is not a whole Parquet file" in refusal(tmp_path / "run")


@pytest.mark.parametrize("place", range(1, 100, 7))
def test_a_damaged_parquet_file_is_refused_or_unhurt(tmp_path: Path, place: int) -> None:
    samples = counting_samples(500)
    write_recording(tmp_path / "run", samples, META)
    damaged = bytearray((tmp_path / "run.parquet").read_bytes())
    damaged[len(damaged) * place // 100] ^= 0x55
    (tmp_path / "run.parquet").write_bytes(damaged)
    with contextlib.suppress(RecordingError):
        assert read_recording(tmp_path / "run").samples.tobytes() == samples.tobytes()


def test_too_few_rows_and_ragged_rows_are_refused(tmp_path: Path) -> None:
    assert "holds 0 samples" in refusal(write_pair(tmp_path, rows=[]))
    assert "holds 1 sample." in refusal(write_pair(tmp_path, rows=ROWS[:1]))
    assert "run.csv: is not a CSV" in refusal(write_pair(tmp_path, rows=[*ROWS[:4], "0.05,1"]))
    (tmp_path / "run.csv").write_text("")
    assert "run.csv: is not a CSV" in refusal(tmp_path / "run")
    (tmp_path / "run.csv").write_bytes(bytes(range(256)) * 10)
    assert "run.csv" in refusal(tmp_path / "run")


def test_files_that_are_not_there_are_named(tmp_path: Path) -> None:
    assert "run.parquet or" in refusal(tmp_path / "run")
    assert "run.csv: no such file" in refusal(tmp_path / "run.csv")
    write_pair(tmp_path)
    (tmp_path / "run.toml").unlink()
    assert "run.toml: no such file, and run.csv says nothing without it" in refusal(tmp_path / "run")
    (tmp_path / "run.toml").write_bytes(b"\xff\xfe")
    assert "run.toml: byte 0: is not UTF-8" in refusal(tmp_path / "run")


def test_two_data_files_of_one_name_are_ambiguous_unless_one_is_named(tmp_path: Path) -> None:
    write_recording(tmp_path / "run", counting_samples(5), META)
    (tmp_path / "run.csv").write_text("\n".join([HEADER, *ROWS]))
    assert "both a .parquet and a .csv" in refusal(tmp_path / "run.toml")
    assert len(read_recording(tmp_path / "run.csv").samples) == 10


def test_a_parquet_row_is_named_by_its_number(tmp_path: Path) -> None:
    write_recording(tmp_path / "run", counting_samples(50), META)
    table = pq.read_table(tmp_path / "run.parquet")
    values = table.column("dv_y_mps").to_numpy().copy()
    values[30] = np.nan
    pq.write_table(table.set_column(3, "dv_y_mps", pa.array(values)), tmp_path / "run.parquet")
    assert "run.parquet: row 31, column dv_y_mps: is nan" in refusal(tmp_path / "run")


def test_a_column_of_words_in_parquet_is_refused(tmp_path: Path) -> None:
    write_recording(tmp_path / "run", counting_samples(5), META)
    table = pq.read_table(tmp_path / "run.parquet")
    index = table.column_names.index("dv_y_mps")
    for column in (pa.array([True] * 5), pa.array(["1", "2", "3", "4", "x"]), pa.array(["1"] * 5), pa.nulls(5)):
        pq.write_table(table.set_column(index, "dv_y_mps", column), tmp_path / "run.parquet")
        assert "column dv_y_mps" in refusal(tmp_path / "run")


@pytest.mark.parametrize("name", ["rlg_vehicle_quiet", "rlg_vehicle_disturbed", "xsens_multiposition"])
def test_real_recordings_read(shared_data: Path, name: str) -> None:
    recording = read_recording(shared_data / "recordings" / name)
    gravity = np.linalg.norm(recording.samples["dv"][:1000].mean(axis=0)) / intervals_s(recording.samples[:1000]).mean()
    assert gravity == pytest.approx(9.8, rel=0.1)  # nominal scales and biases
    assert recording.samples["sequence"][-1] == len(recording.samples) - 1


def test_the_documentations_examples_are_recordings(tmp_path: Path) -> None:
    text = (Path(__file__).resolve().parents[2] / "docs" / "recordings.md").read_text(encoding="utf-8")
    for number in (1, 2):
        for suffix, fence in (("csv", "csv"), ("toml", "toml")):
            body = text.split(f"<!-- example {number} {suffix} -->")[1].split(f"```{fence}\n")[1].split("```")[0]
            (tmp_path / f"run{number}.{suffix}").write_text(body)
        samples = read_recording(tmp_path / f"run{number}").samples
        assert samples["dv"][:, 2] / intervals_s(samples) == pytest.approx(9.8, rel=0.01)
