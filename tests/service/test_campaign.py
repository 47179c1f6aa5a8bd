"""Campaigns: what is refused, what a trial depends on, and that neither a killed worker nor a killed run changes it."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import distributed
import numpy as np
import psutil
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from service import cli
from service.campaign import read_campaign, run_campaign
from service.campaign.chunks import Chunks
from service.campaign.design import levels_of, trial_seed
from service.campaign.engine import run_chunk
from service.errors import RefusedInput
from simulators.scenarios import demo_model, demo_scenario, effect
from simulators.simulate import simulate_recording

GRID = """
[campaign]
study = "grid"
repeats = 2
seed = 5
chunk = 1

[vary]
stage_s = 10
noise_source = "model"
storage_months = [6.0, 36.0]
attitudes = [1, 2]
"""
CUBE = """
[campaign]
study = "latin_hypercube"
trials = 20

[vary]
latitude_deg = { low = -50.0, high = 50.0 }
noise = { low = 0.1, high = 10.0, scale = "log" }
method = ["paper", "optimal"]
"""


def spec_at(folder: Path, text: str) -> Path:
    path = folder / "study.toml"
    path.write_text(text)
    return path


def untimed(table: pa.Table) -> pa.Table:
    return table.drop_columns([name for name in table.column_names if name.startswith("wall_")])


# ------------------------------------------------------------------ what is refused


@pytest.mark.parametrize(
    ("old", "new", "place", "remedy"),
    [
        ("latitude_deg", "latitude_rad", "[vary] latitude_rad", "Did you mean latitude_deg?"),
        ("trials = 20", "trial = 20", "[campaign] trial", "Did you mean trials?"),
        ("trials = 20", "", "[campaign] trials", "--trials"),
        ("high = 50.0", "high = 95.0", "[vary] latitude_deg", "not within -89 to 89"),
        ("high = 50.0", "high = -60.0", "[vary] latitude_deg", "Give low < high"),
        ('"paper"', '"guess"', "[vary] method", "none of optimal, paper"),
        ('"latin_hypercube"', '"monte_carlo"', "[campaign] study", "grid"),
        ('"latin_hypercube"', '"grid"', "[vary] latitude_deg", "latin_hypercube"),
        ('"latin_hypercube"', '"reanalysis"', "[campaign] study", "[[block]]"),
        ("[vary]", '[[block]]\nname = "a"\nmodel = "b"\nrecordings = ["c"]\n[vary]', "[campaign] study", "[[block]]"),
        ("low = 0.1", "low = 0.0", "[vary] noise", "0.01"),
        ('"log"', '"cube"', "[vary] noise scale", "'linear' or 'log'"),
        ("trials = 20", "trials = 20\nrepeats = 2", "[campaign] repeats", "only a grid"),
        ("trials = 20", "trials = true", "[campaign] trials", "got True"),
        ("low = 0.1", "low = true", "[vary] noise low", "got True"),
        ('"paper"', "true", "[vary] method 0", "got True"),
    ],
)
def test_a_spec_is_refused_by_file_key_and_remedy(tmp_path: Path, old: str, new: str, place: str, remedy: str) -> None:
    path = spec_at(tmp_path, CUBE.replace(old, new, 1))
    with pytest.raises(RefusedInput) as refused:
        read_campaign(path)
    assert f"{path}: {place}" in str(refused.value)
    assert remedy in str(refused.value)


def test_a_hypercube_takes_its_number_of_trials_from_the_command_line(tmp_path: Path) -> None:
    assert read_campaign(spec_at(tmp_path, CUBE.replace("trials = 20", "")), trials=3).trials == 3


def test_recordings_of_a_fleet_must_be_there(tmp_path: Path) -> None:
    text = '[campaign]\nstudy = "reanalysis"\n[[block]]\nname = "a"\nmodel = "a.json"\nrecordings = ["a/*.parquet"]\n'
    with pytest.raises(RefusedInput, match=r"no\. 1 model.*there is no file"):
        read_campaign(spec_at(tmp_path, text))
    (tmp_path / "a.json").write_text("{}")
    with pytest.raises(RefusedInput, match=r"no\. 1 recordings"):
        read_campaign(spec_at(tmp_path, text))
    (tmp_path / "a").mkdir()
    for name in ("two", "one"):
        (tmp_path / "a" / f"{name}.parquet").write_text("")
    spec = read_campaign(spec_at(tmp_path, text))
    assert [[path.stem for path in subject.recordings] for subject in spec.subjects] == [["one"], ["two"]]
    assert spec.trials == 2
    with pytest.raises(RefusedInput, match=r"\[campaign\] trials: 3 are more than the 2"):
        read_campaign(tmp_path / "study.toml", trials=3)
    with pytest.raises(RefusedInput, match=r"\[campaign\] navigate: means nothing"):
        read_campaign(spec_at(tmp_path, text.replace("[[block]]", "navigate = true\n[[block]]")))


def test_without_the_extra_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(RefusedInput, match=r"pip install 'inertrim\[cluster\]'"):
        run_campaign(read_campaign(spec_at(tmp_path, GRID)), tmp_path / "out.parquet")
    assert not list(tmp_path.glob("out*"))


def test_a_second_call_leaves_a_running_campaign_alone(tmp_path: Path) -> None:
    spec, out = read_campaign(spec_at(tmp_path, GRID)), tmp_path / "out.parquet"
    with Chunks(spec, out).held():
        with pytest.raises(RefusedInput, match="another call works on this campaign"):
            run_campaign(spec, out)
        assert (tmp_path / "out.parquet.parts" / "campaign.json").is_file()
    assert not list(tmp_path.glob("out*"))  # nothing was finished, so nothing is kept


def test_an_address_that_is_none_is_refused_at_once_and_leaves_nothing(tmp_path: Path) -> None:
    began_s = time.monotonic()
    with pytest.raises(RefusedInput, match=r"--scheduler: nonsense does not answer.*tcp://"):
        run_campaign(read_campaign(spec_at(tmp_path, GRID)), tmp_path / "out.parquet", scheduler="nonsense")
    assert time.monotonic() - began_s < 20.0  # a client that was half made took 40 s to end
    assert not list(tmp_path.glob("out*"))


def test_a_cluster_that_is_there_already_gives_the_same(tmp_path: Path) -> None:
    spec, out = read_campaign(spec_at(tmp_path, GRID), trials=2), tmp_path / "out.parquet"
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        dashboard_address=None,
        local_directory=str(tmp_path / "scratch"),
    ) as cluster:
        done = run_campaign(spec, out, scheduler=cluster.scheduler_address)
        assert not list((tmp_path / "scratch").rglob("inertrim-trial-*"))
    assert (done.now, done.workers) == (2, 2)
    expected = _in_one_go(spec.text(), 2)
    assert untimed(pq.read_table(out).replace_schema_metadata(None)).equals(untimed(expected))


def test_a_full_disk_is_told_and_leaves_what_was_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spec, out = read_campaign(spec_at(tmp_path, GRID)), tmp_path / "out.parquet"
    table = pa.table({"trial": [0]})

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    chunks = Chunks(spec, out)
    with chunks.held():
        chunks.save(0, table)
        monkeypatch.setattr(os, "fsync", full)
        with pytest.raises(RefusedInput, match=r"No space left on device.*what was finished is kept"):
            chunks.save(1, table)
    assert sorted(path.name for path in tmp_path.glob("out*/*")) == ["000000000.parquet", "campaign.json", "lock"]


def test_parts_that_a_kill_left_beside_the_file_are_cleared(tmp_path: Path) -> None:
    spec, out = read_campaign(spec_at(tmp_path, GRID)), tmp_path / "out.parquet"
    chunks = Chunks(spec, out)
    with chunks.held():
        for chunk in range(chunks.count):
            chunks.save(chunk, pa.table({"trial": [chunk]}))
        shutil.copytree(tmp_path / "out.parquet.parts", tmp_path / "kept")
        chunks.finish()
    (tmp_path / "kept").rename(tmp_path / "out.parquet.parts")
    assert run_campaign(spec, out).now == 0
    assert not (tmp_path / "out.parquet.parts").exists()


def test_the_file_keeps_many_chunks_together_in_the_order_of_trials(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.campaign.chunks.GROUP_ROWS", 3)
    spec, out = read_campaign(spec_at(tmp_path, GRID)), tmp_path / "out.parquet"
    chunks = Chunks(spec, out)
    with chunks.held():
        for chunk in reversed(range(chunks.count)):
            chunks.save(chunk, pa.table({"trial": [chunk]}))
        chunks.finish()
    groups = pq.read_metadata(out)
    assert [groups.row_group(k).num_rows for k in range(groups.num_row_groups)] == [3, 3, 2]
    assert pq.read_table(out).column("trial").to_pylist() == list(range(8))


def test_the_command_line_refuses_with_two(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        sys, "argv", ["inertrim", "campaign", str(tmp_path / "none.toml"), "--out", str(tmp_path / "o")]
    )
    with pytest.raises(SystemExit) as left:
        cli.main()
    assert left.value.code == 2
    assert "--scheduler" in CliRunner().invoke(cli.app, ["campaign", "--help"], env={"COLUMNS": "200"}).output


# ------------------------------------------------------------------ design


def test_a_latin_hypercube_takes_every_slice_of_every_factor_once(tmp_path: Path) -> None:
    spec = read_campaign(spec_at(tmp_path, CUBE))
    points = [levels_of(spec, trial) for trial in range(20)]
    latitude = np.array([point["latitude_deg"] for point in points])
    noise = np.log10([point["noise"] for point in points])
    assert sorted(((latitude + 50.0) / 5.0).astype(int)) == list(range(20))
    assert sorted(((noise + 1.0) * 10.0).astype(int)) == list(range(20))
    assert [point["method"] for point in points].count("paper") == 10


def test_a_longer_hypercube_keeps_whole_cubes_and_needs_no_list_of_all(tmp_path: Path) -> None:
    spec = read_campaign(spec_at(tmp_path, CUBE), trials=10**9)
    last = [levels_of(spec, trial)["latitude_deg"] for trial in range(10**9 - 1000, 10**9)]
    assert sorted(((np.array(last) + 50.0) * 10.0).astype(int)) == list(range(1000))


def test_a_grid_takes_every_combination_as_often(tmp_path: Path) -> None:
    spec = read_campaign(spec_at(tmp_path, GRID))
    assert spec.trials == 8
    points = [(levels_of(spec, k)["storage_months"], levels_of(spec, k)["attitudes"]) for k in range(8)]
    assert points[:4] == [(6.0, 1.0), (6.0, 2.0), (36.0, 1.0), (36.0, 2.0)]
    assert points[4:] == points[:4]


def test_seeds_of_trials_are_their_own() -> None:
    states = {tuple(trial_seed(5, trial).generate_state(4)) for trial in range(1000)}
    assert len(states) == 1000
    assert tuple(trial_seed(6, 0).generate_state(4)) not in states


# ------------------------------------------------------------------ kills


def _workers(parent: int) -> list[int]:
    """Return the worker processes of a campaign that runs."""
    found = []
    for child in psutil.Process(parent).children(recursive=True):
        try:
            if "spawn_main" in " ".join(child.cmdline()):
                found.append(child.pid)
        except psutil.Error:
            continue
    return found


def _until(folder: Path, count: int, process: subprocess.Popen[bytes]) -> None:
    while len(list(folder.glob("0*.parquet"))) < count:
        assert process.poll() is None, "it ended before it could be killed"
        time.sleep(0.02)


def _in_one_go(text: str, trials: int) -> pa.Table:
    """Work out all trials in one process, one after the other, its linear algebra on one thread as in a worker's."""
    code = f"""
import sys
from service.campaign.engine import run_chunk
sys.stdout.buffer.write(run_chunk({text!r}, 0, {trials}))
"""
    one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, check=True, env={**os.environ, **one_thread}
    )
    return pa.ipc.open_stream(done.stdout).read_all()


@pytest.mark.long
def test_neither_a_killed_worker_nor_a_killed_run_changes_a_bit(tmp_path: Path) -> None:
    spec, out = spec_at(tmp_path, GRID), tmp_path / "out.parquet"
    parts = out.with_name("out.parquet.parts")
    command = [sys.executable, "-m", "service.cli", "campaign", str(spec), "--out", str(out), "--workers"]
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    running = subprocess.Popen(
        [*command, "2"],
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        env={**os.environ, "TMPDIR": str(temporary)},
    )
    try:
        _until(parts, 1, running)
        workers = _workers(running.pid)
        assert len(workers) == 2
        os.kill(workers[0], signal.SIGKILL)
        _until(parts, 4, running)
        orphans = _workers(running.pid)
    finally:
        running.kill()
        running.wait()
    kept = {path.name: path.stat().st_mtime_ns for path in parts.glob("0*.parquet")}
    assert 4 <= len(kept) < 8
    assert psutil.wait_procs([psutil.Process(pid) for pid in orphans if psutil.pid_exists(pid)], timeout=30)[1] == []
    assert list(temporary.glob("inertrim*")) == []  # recordings of killed workers lie where they are cleared away
    (parts / ".000000007.parquet.part").write_bytes(b"PAR1 cut")  # what a kill leaves of a chunk being written

    ended = subprocess.run([*command, "1", "--json", str(tmp_path / "facts.json")], capture_output=True, check=False)
    assert ended.returncode == 0, ended.stderr
    facts = json.loads((tmp_path / "facts.json").read_text())
    assert facts["run"]["now"] == 8 - len(kept)
    assert not parts.exists()
    assert "By `storage_months`" in out.with_name("out.parquet.md").read_text()

    study = read_campaign(spec)
    expected = _in_one_go(study.text(), 8)
    found = pq.read_table(out).replace_schema_metadata(None)
    assert untimed(found).equals(untimed(expected))
    assert found.column("trial").to_pylist() == list(range(8))
    # Once more is nothing more; another campaign does not overwrite it.
    assert run_campaign(study, out).now == 0
    with pytest.raises(RefusedInput, match="not the result of this campaign"):
        run_campaign(read_campaign(spec, trials=9), out)


@pytest.mark.long
def test_ctrl_c_ends_all_processes_in_one_line_and_keeps_what_was_finished(tmp_path: Path) -> None:
    spec, out = spec_at(tmp_path, GRID), tmp_path / "out.parquet"
    parts = out.with_name("out.parquet.parts")
    command = [sys.executable, "-m", "service.cli", "campaign", str(spec), "--out", str(out), "--workers", "2"]
    running = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
    try:
        _until(parts, 2, running)
        workers = _workers(running.pid)
        os.killpg(running.pid, signal.SIGINT)  # as a terminal does
        said, errors = running.communicate(timeout=60)
    finally:
        running.kill()
    assert running.returncode == 130
    lines = [line for line in errors.decode().splitlines() if line.strip()]
    assert lines[-1] == "Stopped: what was finished of 8 trials is kept. Call again to go on."
    assert b"Traceback" not in said + errors
    assert not any(psutil.pid_exists(pid) for pid in workers)
    assert len(list(parts.glob("0*.parquet"))) >= 2


# ------------------------------------------------------------------ a fleet again


def test_a_fleet_is_analysed_again_and_a_damaged_recording_is_a_row(tmp_path: Path) -> None:
    model = demo_model(1)
    (tmp_path / "block.json").write_text(model.canonical_json())
    shift = effect("bias_shift", "gyro_z", shift=(40.0, "deg/h"))
    scenario = demo_scenario(1).warmed_up().with_motion([], 60.0).model_copy(update={"effect": [shift]})
    simulate_recording(scenario, tmp_path / "fleet" / "good", model=model)
    (tmp_path / "fleet" / "zcut.parquet").write_bytes((tmp_path / "fleet" / "good.parquet").read_bytes()[:3000])
    (tmp_path / "fleet" / "zcut.toml").write_bytes((tmp_path / "fleet" / "good.toml").read_bytes())
    text = '[campaign]\nstudy = "reanalysis"\n[[block]]\nname = "a"\nmodel = "block.json"\nrecordings = ["fleet/*"]\n'
    spec = read_campaign(spec_at(tmp_path, text))
    good, cut = pa.ipc.open_stream(run_chunk(spec.text(), 0, 2)).read_all().to_pylist()
    # At rest a constant is a constant: a bias among what it may be, and each of them on that gyro.
    (finding,) = json.loads(good["findings"])
    assert "bias_shift" in [finding["effect"], *(other["effect"] for other in finding["alternatives"])]
    (named,) = good["effects"]
    assert named.startswith(f"{finding['effect']}:gyro_z")
    assert good["verdict"] == "tie"
    assert good["heldout_rms_after"] < good["heldout_rms_before"]
    assert (cut["verdict"], cut["effects"]) == ("refused", None)
    assert "zcut.parquet" in cut["reason"]


@pytest.mark.long
def test_a_killed_reanalysis_goes_on_where_it_was_and_finds_the_same(tmp_path: Path) -> None:
    """Six recordings, each its own chunk; the run and its workers are killed after two, at whatever they are doing."""
    model = demo_model(1)
    (tmp_path / "block.json").write_text(model.canonical_json())
    scenario = demo_scenario(1).warmed_up().with_motion([], 20.0)
    for number in range(6):
        shift = effect("bias_shift", "gyro_z", shift=(10.0 * number, "deg/h"))
        seeded = scenario.model_copy(
            update={"effect": [shift], "scenario": scenario.scenario.model_copy(update={"seed": number})}
        )
        simulate_recording(seeded, tmp_path / "fleet" / f"block-{number}", model=model)
    text = (
        '[campaign]\nstudy = "reanalysis"\nchunk = 1\n'
        '[[block]]\nname = "a"\nmodel = "block.json"\nrecordings = ["fleet/*"]\n'
    )
    spec, out = spec_at(tmp_path, text), tmp_path / "out.parquet"
    parts = out.with_name("out.parquet.parts")
    command = [sys.executable, "-m", "service.cli", "campaign", str(spec), "--out", str(out), "--workers", "2"]
    running = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    try:
        _until(parts, 2, running)
        orphans = _workers(running.pid)
    finally:
        running.kill()
        running.wait()
    kept = list(parts.glob("0*.parquet"))
    assert 2 <= len(kept) < 6
    assert psutil.wait_procs([psutil.Process(pid) for pid in orphans if psutil.pid_exists(pid)], timeout=30)[1] == []
    ended = subprocess.run([*command, "--json", str(tmp_path / "facts.json")], capture_output=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert json.loads((tmp_path / "facts.json").read_text())["run"]["now"] == 6 - len(kept)
    found = pq.read_table(out).replace_schema_metadata(None)
    assert untimed(found).equals(untimed(_in_one_go(read_campaign(spec).text(), 6)))
    assert found.column("verdict").to_pylist().count("none") == 1  # of the first block nothing has shifted
