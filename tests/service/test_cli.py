"""The command line: what users do wrong is told in one line with file, place and remedy, and never as a traceback."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from forked import inertrim

from drivers.capture import CaptureWriter
from drivers.protocols.native import encode_samples
from drivers.recording import read_recording
from inertial.documents import BlockModel, Calibration, Result, parse_document
from service import cli

SEED = 3


@dataclass(frozen=True)
class Outcome:
    """What one call of the command line did."""

    code: int
    out: str
    err: str


Run = Callable[..., Outcome]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    def call(*arguments: str | Path) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["inertrim", *map(str, arguments)])
        with pytest.raises(SystemExit) as left:
            cli.main()
        written = capsys.readouterr()
        return Outcome(int(left.value.code or 0), written.out, written.err)

    return call


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording of 280 s, NAME ``run``, made by the command line itself."""
    folder = tmp_path_factory.mktemp("made")
    inertrim("simulate", "--out", folder / "run", "--seed", str(SEED)).check_returncode()
    return folder


@pytest.fixture
def pair(made: Path, tmp_path: Path) -> Path:
    """A copy of the recording that a test may damage."""
    for file in made.glob("run*"):
        shutil.copy(file, tmp_path)
    return tmp_path / "run"


def refused(outcome: Outcome, *words: str) -> None:
    """Assert exit code 2 and one line on standard error that holds these words."""
    assert outcome.code == 2, outcome
    assert outcome.err.count("\n") == 1
    assert outcome.err.startswith("inertrim: ")
    assert "Traceback" not in outcome.err
    for word in words:
        assert word in outcome.err, outcome.err


def rewrite(pair: Path, change: Callable[[dict[str, np.ndarray]], object]) -> None:
    """Change the columns of a recording."""
    table = pq.read_table(pair.with_suffix(".parquet"))
    columns = {name: np.array(table.column(name).to_numpy()) for name in table.column_names}
    change(columns)
    pq.write_table(pa.table(columns), pair.with_suffix(".parquet"))


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_help_is_quick_to_import_nothing_heavy() -> None:
    code = (
        "import sys; sys.argv = ['inertrim', '--help']; from service import cli\n"
        "try: cli.main()\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'numba', 'pyarrow', 'pydantic', 'fastapi', 'scipy'} & set(sys.modules)\n"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for command in ("demo", "serve", "simulate", "capture", "replay", "compensate", "navigate", "report", "model"):
        assert command in done.stdout


def test_compensate_navigate_and_report_make_their_files(run: Run, made: Path, tmp_path: Path) -> None:
    out, page = tmp_path / "result.json", tmp_path / "report.html"
    done = run("compensate", made / "run", "--start", "10", "--out", out, "--report", page, "--json", tmp_path / "j")
    assert done.code == 0, done.err
    result = parse_document(Result, out.read_bytes(), "result.json")
    assert result.verdict == "shift compensated"
    assert json.loads((tmp_path / "j").read_text()) == json.loads(out.read_text())
    assert run("report", out, "--out", tmp_path / "again.html").code == 0
    assert (tmp_path / "again.html").read_bytes() == page.read_bytes()
    for name, more in (("with", ["--result", out]), ("without", [])):
        done = run("navigate", made / "run", *more, "--start", "150", "--json", tmp_path / name)
        assert done.code == 0, done.err
    found = {name: json.loads((tmp_path / name).read_text()) for name in ("with", "without")}
    assert set(found["with"]) == {"time_s", "position_m", "velocity_mps", "radial_m"}
    assert found["with"]["radial_m"][-1] < 0.5 * found["without"]["radial_m"][-1]


def test_json_on_standard_output_is_only_that(run: Run, made: Path) -> None:
    done = run("navigate", made / "run", "--end", "30", "--json", "-")
    assert done.code == 0
    assert len(json.loads(done.out)["time_s"]) == 301


def test_negative_verdict_exits_with_one(run: Run, pair: Path) -> None:
    with pair.with_suffix(".toml").open("a") as toml:
        for kind, start, end in (
            ("align", 100, 130),
            ("stage_1", 130, 150),
            ("stage_2", 150, 170),
            ("stage_3", 170, 190),
            ("verify", 190, 210),
        ):
            toml.write(f'\n[[window]]\nkind = "{kind}"\nstart_s = {start}.0\nend_s = {end}.0\n')

    def shake(columns: dict[str, np.ndarray]) -> None:
        columns["dtheta_y_rad"][14000:14100] += 5e-5

    rewrite(pair, shake)
    done = run("compensate", pair)
    assert done.code == 1, done.err
    assert "moved_in_stage_1" in done.out


def test_model_starts_ideal_with_the_noise_of_a_recording(run: Run, made: Path, tmp_path: Path) -> None:
    assert run("model", "new", "--ideal", "--gyro-kind", "laser", "--out", tmp_path / "free.json").code == 0
    free = parse_document(BlockModel, (tmp_path / "free.json").read_bytes(), "free")
    assert free.noise.free
    assert free.gyro_kind == "laser"
    done = run("model", "new", "--ideal", "--noise-from", made / "run", "--out", tmp_path / "heard.json")
    assert done.code == 0, done.err
    heard = parse_document(BlockModel, (tmp_path / "heard.json").read_bytes(), "heard")
    arw = 0.01 * np.pi / 180 / 60
    assert heard.noise.gyro_x.white == pytest.approx(arw, rel=0.1)


def test_capture_is_replayed_into_a_recording(run: Run, made: Path, tmp_path: Path) -> None:
    samples = read_recording(made / "run").samples[:500]
    writer = CaptureWriter(tmp_path / "line.raw")
    writer.write(encode_samples(samples), 5.0)
    writer.close()
    done = run("replay", tmp_path / "line.raw", "--out", tmp_path / "again", "--json", tmp_path / "facts.json")
    assert done.code == 0, done.err
    facts = json.loads((tmp_path / "facts.json").read_text())
    assert facts["samples"] == 500
    assert facts["frames_lost"] == 0
    assert np.array_equal(read_recording(tmp_path / "again").samples["dtheta"], samples["dtheta"])


def test_simulated_recordings_in_one_folder_keep_their_own_calibrations(run: Run, made: Path) -> None:
    before = (made / "run-calibration.json").read_bytes()
    assert run("simulate", "--out", made / "other", "--seed", "8").code == 0
    assert (made / "run-calibration.json").read_bytes() == before
    assert (made / "other-calibration.json").read_bytes() != before


@pytest.mark.parametrize("command", ["compensate", "navigate"])
def test_missing_recording_is_named(run: Run, tmp_path: Path, command: str) -> None:
    refused(run(command, tmp_path / "nothing"), "nothing.parquet", "no such file", "Give the name of a recording")


def test_wrong_column_is_named(run: Run, pair: Path) -> None:
    rewrite(pair, lambda columns: columns.update(dv_x_mg=columns.pop("dv_x_mps")))
    refused(run("compensate", pair), "run.parquet", "dv_x_mps", "missing", "run.toml")


def test_wrong_unit_is_named(run: Run, pair: Path) -> None:
    edit(pair.with_suffix(".toml"), "latitude_deg = 35.7", "latitude_rad = 0.623")
    refused(run("compensate", pair), "run.toml", "latitude_rad", "latitude_deg")


def test_nan_is_named_by_row(run: Run, pair: Path) -> None:
    rewrite(pair, lambda columns: columns["dtheta_z_rad"].__setitem__(777, np.nan))
    refused(run("navigate", pair), "run.parquet", "row 778", "dtheta_z_rad", "nan")


def test_time_that_runs_back_is_named_by_row(run: Run, pair: Path) -> None:
    rewrite(pair, lambda columns: columns["time_s"].__setitem__(50, 0.1))
    refused(run("compensate", pair), "run.parquet", "time_s", "row 51", "does not come after")


def test_truncated_file_is_named(run: Run, pair: Path) -> None:
    data = pair.with_suffix(".parquet")
    data.write_bytes(data.read_bytes()[:-2000])
    refused(run("compensate", pair), "run.parquet", "not a whole Parquet file", "copy or convert it again")


def test_wrong_calibration_is_named(run: Run, pair: Path) -> None:
    calibration = pair.with_name("run-calibration.json")
    edit(calibration, "inertrim/calibration/1", "inertrim/block/1")
    refused(run("compensate", pair), "run-calibration.json", "inertrim/block/1", "Give a Calibration document")


def test_calibration_that_is_not_there_is_named(run: Run, pair: Path) -> None:
    pair.with_name("run-calibration.json").unlink()
    refused(run("navigate", pair), "run.toml", "[block] calibration", "run-calibration.json")


def test_newer_schema_is_named(run: Run, pair: Path) -> None:
    edit(pair.with_name("run-calibration.json"), "inertrim/calibration/1", "inertrim/calibration/7")
    refused(run("compensate", pair), "run-calibration.json", "newer", "Update inertrim")


def test_damaged_result_is_named(run: Run, made: Path, tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text('{"schema": "inertrim/result/1", "method": ')
    refused(run("navigate", made / "run", "--result", tmp_path / "result.json"), "result.json", "not JSON")


def test_model_without_inverse_is_named(run: Run, tmp_path: Path) -> None:
    assert run("model", "new", "--ideal", "--out", tmp_path / "zero.json").code == 0
    edit(tmp_path / "zero.json", '"scale_positive": 1.0', '"scale_positive": 0.0')
    refused(
        run("simulate", "--out", tmp_path / "x", "--model", tmp_path / "zero.json"), "zero.json", "cannot be inverted"
    )


def test_span_outside_the_data_is_refused(run: Run, made: Path) -> None:
    refused(run("compensate", made / "run", "--start", "1000"), "run.parquet", "0 to 300 s", "within the data")
    refused(run("navigate", made / "run", "--start", "400"), "run.parquet", "within the data")
    refused(run("compensate", made / "run", "--start", "nan"), "--start", "not a time")
    refused(run("navigate", made / "run", "--start", "9", "--end", "3"), "--end", "not after --start")


def test_file_that_could_not_be_written_is_refused_before_the_work(run: Run, made: Path, tmp_path: Path) -> None:
    refused(run("compensate", made / "run", "--out", tmp_path / "no" / "r.json"), "r.json", "does not exist", "Make it")
    refused(run("navigate", made / "run", "--json", tmp_path), str(tmp_path), "is a folder")


def test_budget_of_a_result_with_a_profile(run: Run, made: Path, tmp_path: Path) -> None:
    assert run("compensate", made / "run", "--start", "10", "--out", tmp_path / "r.json").code == 0
    done = run("budget", tmp_path / "r.json", "--at", "60,300", "--json", tmp_path / "rest.json")
    assert done.code == 0, done.err
    assert "CEP" in done.out
    rest = json.loads((tmp_path / "rest.json").read_text())
    assert rest == json.loads((tmp_path / "r.json").read_text())["budget"]
    (tmp_path / "turn.toml").write_text(
        "[site]\n[block]\nsample_rate_hz = 100.0\n[[motion]]\nkind = 'turn'\nstart_s = 0.0\nend_s = 60.0\n"
        "rate_dps = 3.0\naxis = [0.0, 0.0, 1.0]\nframe = 'body'\n"
    )
    done = run("budget", tmp_path / "r.json", "--profile", tmp_path / "turn.toml", "--json", tmp_path / "turned.json")
    assert done.code == 0, done.err
    assert json.loads((tmp_path / "turned.json").read_text())["profile"] == "motion"
    refused(run("budget", tmp_path / "r.json", "--at", "soon"), "--at", "soon", "60,300")


def test_align_noise_and_plan_say_what_they_found(run: Run, made: Path, tmp_path: Path) -> None:
    done = run("align", made / "run", "--start", "150", "--json", tmp_path / "a.json")
    assert done.code == 0, done.err
    found = json.loads((tmp_path / "a.json").read_text())
    assert abs(found["azimuth_deg"] - found["given_azimuth_deg"]) < 3 * found["azimuth_sigma_deg"]
    assert found["azimuth_noise_sigma_deg"] < found["azimuth_sigma_deg"]
    done = run("noise", made / "run", "--start", "150", "--json", tmp_path / "n.json")
    assert done.code == 0, done.err
    white = json.loads((tmp_path / "n.json").read_text())["channels"]["gyro_x"]["terms"]["white"]
    assert white["unit"] == "deg/sqrt(h)"
    assert white["value_in_unit"] == pytest.approx(0.01, rel=0.1)
    done = run("calibrate", made / "run.toml", "--plan", "--steps", "4", "--out", tmp_path / "plan.toml")
    assert done.code == 0, done.err
    assert "conditioning" in done.out
    assert "[[motion]]" in (tmp_path / "plan.toml").read_text()


def test_calibrate_refuses_what_holds_no_attitudes(run: Run, made: Path) -> None:
    refused(run("calibrate", made / "run"), "run.parquet", "rest", "docs/calibration.md")
    refused(run("calibrate", made / "run", "--mounting", "gyro_x"), "--mounting", "gyro_x:accel_x,accel_y")


def test_real_counts_are_calibrated_as_published(run: Run, shared_data: Path, tmp_path: Path) -> None:
    recording = shared_data / "recordings" / "xsens_multiposition"
    done = run("calibrate", recording, "--out", tmp_path / "c.json", "--json", tmp_path / "facts.json")
    assert done.code == 0, done.err
    assert "a = T·K·(raw − b)" in done.out
    accel = json.loads((tmp_path / "facts.json").read_text())["raw"]["accel"]
    assert accel["K"] == pytest.approx([0.00241278, 0.00242712, 0.00241168], rel=1e-3)
    assert accel["b"] == pytest.approx([33124.2, 33275.2, 32364.4], abs=10)
    assert [accel["T"][0][1], accel["T"][0][2], accel["T"][1][2]] == pytest.approx(
        [-0.0033593, -0.00890639, -0.0213341], abs=1e-3
    )
    assert parse_document(Calibration, (tmp_path / "c.json").read_bytes(), "c.json").order


def test_unknown_method_protocol_and_line_are_refused(run: Run, made: Path, tmp_path: Path) -> None:
    refused(run("compensate", made / "run", "--method", "magic"), "magic", "Known: optimal, paper")
    refused(run("simulate", "--pty", tmp_path / "p", "--protocol", "nope"), "nope", "native")
    refused(run("replay", made / "run.parquet"), "run.parquet", "no whole record of a capture")
    refused(run("capture", tmp_path / "c", "--link", "nosuch://x"), "nosuch://x", "socket://host:port")


def test_scenario_with_a_wrong_key_is_named(run: Run, tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text("[site]\nlatitude_deg = 35.0\n[block]\nsample_rate_hz = 100.0\ngyro = 1\n")
    refused(run("simulate", "--out", tmp_path / "x", "--scenario", tmp_path / "s.toml"), "s.toml", "gyro")


def test_settings_that_are_wrong_are_named(run: Run, tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text("[site]\nlatitude_rad = 0.6\n")
    refused(run("serve", "--config", tmp_path / "c.toml"), "c.toml", "latitude_rad", "latitude_deg")


def test_fault_of_the_program_is_one_line_too(run: Run, made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise KeyError("lost")

    monkeypatch.setattr("service.compensate.compensate", broken)
    done = run("compensate", made / "run")
    assert done.code == 70
    assert done.err.count("\n") == 1
    assert "internal error at test_cli.py" in done.err
    assert "--debug" in done.err
    assert "Traceback" in run("--debug", "compensate", made / "run").err
