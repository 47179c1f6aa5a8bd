"""``inertrim discrepancy`` and ``inertrim model show|diff|log`` from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from forked import inertrim
from rest_bench import believed_model, write_rest

from inertial.documents import BlockModel, EffectEntry, Noise, ParameterValue
from simulators.model_store import save_model


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A minute and a half at rest, its gyro_x 40 deg/h off, and the model that does not know it."""
    folder = tmp_path_factory.mktemp("bench")
    write_rest(folder, "rest", seed=11, gyro_x_radps=np.radians(40.0) / 3600.0)
    save_model(believed_model(), folder / "block.json")
    return folder


def test_what_is_missing_is_named_added_and_then_agrees(bench: Path, tmp_path: Path) -> None:
    found = tmp_path / "found"
    done = inertrim(
        "discrepancy", bench / "rest", "--model", bench / "block.json", "--out", found, "--json", tmp_path / "f.json"
    )
    assert done.returncode == 0, done.stderr
    assert "gyro_x" in done.stdout
    report = json.loads((found / "report.json").read_text())
    assert report == json.loads((tmp_path / "f.json").read_text())
    names = {(f["effect"], f["channel"]) for f in report["findings"]}
    names |= {(a["effect"], a["channel"]) for f in report["findings"] for a in f["alternatives"]}
    assert ("bias_shift", "gyro_x") in names
    assert report["next_recording"][0]["expected_nats"] > 0.0
    assert {"name", "text", "about", "expected_nats"} <= set(report["next_recording"][0])
    child = found / f"{report['model']['sha256']}.json"
    again = inertrim("discrepancy", bench / "rest", "--model", child, "--json", "-")
    assert again.returncode == 0, again.stderr
    document = json.loads(again.stdout)
    assert (document["verdict"], document["findings"]) == ("none", [])
    assert document["next_recording"], "where nothing was found, it says what could still hide"


def test_a_recording_without_latitude_is_refused_with_the_remedy(bench: Path, tmp_path: Path) -> None:
    for path in bench.glob("rest.*"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    toml = tmp_path / "rest.toml"
    toml.write_text("".join(line for line in toml.open() if "latitude_deg" not in line))
    done = inertrim("discrepancy", tmp_path / "rest", "--model", bench / "block.json")
    assert done.returncode == 2
    assert "latitude_deg" in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.count("\n") == 1


def test_show_diff_and_log_read_the_lineage(tmp_path: Path) -> None:
    parent = BlockModel(block="B1", gyro_kind="laser", noise=Noise(free=True))
    shift = ParameterValue(value=2e-4, sigma=1e-5, unit="m/s^2")
    entry = EffectEntry(
        effect="bias_shift", channel="accel_y", parameters={"shift": shift}, evidence={"evidence_nats": 31.0}
    )
    child = parent.model_copy(update={"parent": parent.sha256(), "effects": [entry]})
    one, two = tmp_path / f"{parent.sha256()}.json", tmp_path / f"{child.sha256()}.json"
    save_model(parent, one)
    save_model(child, two)

    shown = inertrim("model", "show", two)
    assert shown.returncode == 0
    assert parent.sha256()[:12] in shown.stdout
    assert "bias_shift on accel_y: shift 0.0002 ± 1e-05 m/s^2 (31 nats)" in shown.stdout

    differ = inertrim("model", "diff", one, two)
    assert differ.returncode == 1
    assert differ.stdout.startswith("+ bias_shift on accel_y")
    assert inertrim("model", "diff", one, one).returncode == 0

    log = inertrim("model", "log", two)
    assert (
        log.stdout.index(child.sha256()[:12])
        < log.stdout.index("+ bias_shift")
        < log.stdout.index(parent.sha256()[:12])
    )

    two.write_text(two.read_text().replace("0.0002", "0.0003"))
    damaged = inertrim("model", "show", two)
    assert damaged.returncode == 2
    assert "not what its name says" in damaged.stderr
