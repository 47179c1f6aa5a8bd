"""Ageing from outside: a table of terms and a store of results, over the command line and over HTTP."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from http_bench import serving, settings_for

from inertial.ageing_fleet import TERMS
from inertial.documents import Calibration, Noise, Result, Sigma, StageTerms
from service import cli
from service.ageing import DPH_RADPS, MG_MPS2
from service.ageing_history import SIGMA_COLUMNS, VALUE_COLUMNS, StoreHistories, history_of_table
from service.errors import RefusedInput
from service.store import RunRecord, Store

CALIBRATED = datetime(2024, 1, 1, tzinfo=UTC)
SIGMA = {name: 0.02 * MG_MPS2 if name.startswith("f") else 0.05 * DPH_RADPS for name in TERMS}


def terms_at(block: int, months: float, rng: np.random.Generator) -> dict[str, float]:
    """Block 0 drifts by 0.35 mg a year in f_z and was shaken by 0.4 mg after 20 months in f_y; the others are quiet."""
    values = {name: SIGMA[name] * rng.standard_normal() for name in TERMS}
    if block == 0:
        values["f_z"] += 0.35 * MG_MPS2 * months / 12.0
        values["f_y"] += 0.4 * MG_MPS2 * (months > 20.0)
    return values


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four blocks, 24 monthly checks each, as a CSV."""
    rng = np.random.default_rng(1)
    lines = ["block,months," + ",".join([*VALUE_COLUMNS.values(), *SIGMA_COLUMNS.values()])]
    for block in range(4):
        for months in range(1, 25):
            values = terms_at(block, months, rng)
            cells = [f"{values[name]:.9g}" for name in TERMS] + [f"{SIGMA[name]:.9g}" for name in TERMS]
            if (block, months) == (1, 5):  # a check that could not bound a level term
                cells[0] = cells[6] = ""
            lines.append(f"SN{block},{months}," + ",".join(cells))
    path = tmp_path_factory.mktemp("ageing") / "history.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


@dataclass(frozen=True)
class Outcome:
    """What one call of the command line did."""

    returncode: int
    stdout: str
    stderr: str


Command = Callable[..., Outcome]


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """The command line, in this process."""

    def call(*arguments: str | Path) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["inertrim", "ageing", *map(str, arguments)])
        with pytest.raises(SystemExit) as left:
            cli.main()
        written = capsys.readouterr()
        return Outcome(int(left.value.code or 0), written.out, written.err)

    return call


def test_a_table_tells_which_block_must_go_back_and_what_shook_it(
    command: Command, table: Path, tmp_path: Path
) -> None:
    done = command("--history", table, "--json", tmp_path / "facts.json", "--block", "SN0")
    assert done.returncode == 0, done.stderr
    facts = json.loads((tmp_path / "facts.json").read_text())
    drifting, quiet = facts["blocks"]["SN0"], facts["blocks"]["SN3"]
    assert next(iter(drifting["leaves_limit"]["first_term"])) == "f_z"
    # 1 mg at 0.35 mg a year is reached after 34.3 months.
    assert drifting["leaves_limit"]["low_months"] < 34.3 < (drifting["leaves_limit"]["high_months"] or 1e9)
    assert quiet["leaves_limit"]["beyond_horizon"] > drifting["leaves_limit"]["beyond_horizon"]
    (step,) = [step for step in drifting["steps"] if step["term"] == "f_y"]
    assert (step["after_months"], step["before_months"]) == (20.0, 21.0)
    assert abs(step["size"] - 0.4 * MG_MPS2) < 4.0 * step["sigma"]
    assert not quiet["steps"]
    assert "step of SN0 in f_y before its check at 21.0 months" in done.stdout
    assert len(facts["blocks"]["SN1"]["terms"]["f_x"]["history"]["months"]) == 23


def test_outside_its_limit_is_a_negative_verdict(command: Command, table: Path, tmp_path: Path) -> None:
    config = tmp_path / "inertrim.toml"
    config.write_text("[conditions]\naccel_term_mg = 0.5\n")
    done = command("--history", table, "--config", config, "--json", "-")
    assert done.returncode == 1, done.stderr
    assert "outside its limit now" in json.loads(done.stdout)["blocks"]["SN0"]["attention"][0]


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("months,", "month,", "column month"),
        ("sigma_g_z_radps", "sigma_g_z_dph", "column sigma_g_z_dph"),
        ("SN0,3,", "SN0,-3,", "row 3, months"),
        ("SN0,3,", "SN0,,", "row 3, months"),
    ],
)
def test_a_wrong_table_is_refused_by_place(table: Path, tmp_path: Path, old: str, new: str, place: str) -> None:
    path = tmp_path / "wrong.csv"
    path.write_text(table.read_text().replace(old, new, 1))
    with pytest.raises(RefusedInput) as refused:
        history_of_table(path)
    assert f"{path}: {place}" in str(refused.value)


def test_parquet_says_what_csv_says(table: Path, tmp_path: Path) -> None:
    from pyarrow import csv

    pq.write_table(csv.read_csv(table), tmp_path / "history.parquet")
    assert repr(history_of_table(tmp_path / "history.parquet")) == repr(history_of_table(table))
    assert isinstance(pq.read_table(tmp_path / "history.parquet"), pa.Table)


def test_no_store_is_refused_with_what_to_do(command: Command, tmp_path: Path) -> None:
    config = tmp_path / "inertrim.toml"
    config.write_text('[store]\npath = "none.db"\n')
    done = command("--config", config)
    assert done.returncode == 2
    assert "there is no store" in done.stderr
    assert not (tmp_path / "none.db").exists()


# ------------------------------------------------------------------ the store


def result_of(values: dict[str, float], *, fit: bool) -> Result:
    """A result with these terms, and nothing else of interest."""
    f, g = [values[name] for name in TERMS[:3]], [values[name] for name in TERMS[3:]]
    sigma = Sigma(f_mps2=[None, *(SIGMA[name] for name in TERMS[1:3])], g_radps=[SIGMA[name] for name in TERMS[3:]])
    return Result(
        software="inertrim test",
        method="optimal",
        state="READY" if fit else "FAULT",
        verdict="shift compensated" if fit else "not fit",
        fit=fit,
        reasons=[],
        windows=[],
        terms={"final": StageTerms(f_mps2=f, g_radps=g)},
        sigma=sigma,
        order=[],
        covariance=[],
        unobservable=[],
        noise=Noise(),
        reference={},
        site={},
        alignment={},
        verification=None,
        conditions={},
        block={},
        inputs={"calibration.json": "ab" * 32},
    )


def filled(folder: Path) -> Store:
    """A store with two blocks, ten checks each and one that was not fit, and their calibrations' copies."""
    store = Store(folder / "inertrim.db")
    rng = np.random.default_rng(2)
    calibration = Calibration(date=CALIBRATED.date().isoformat()).canonical_json()
    for block in (0, 1):
        for check in range(1, 12):
            run, _ = store.create_run({"check": check}, "optimal", None)
            store.note_block(run.id, {"identity": {"serial": f"SN{block}"}})
            started = (CALIBRATED + timedelta(days=30.4375 * check)).isoformat().replace("+00:00", "Z")
            set_started(store, run.id, started)
            result = result_of(terms_at(block, check, rng), fit=check != 11)
            store.save_result(run.id, result.canonical_json(), result.verdict)
            copy = folder / "inertrim-runs" / run.id
            copy.mkdir(parents=True)
            (copy / "calibration.json").write_text(calibration)
    return store


def set_started(store: Store, run_id: str, started: str) -> None:
    """Date a run: the store itself dates it now."""
    from sqlalchemy import update

    from service.store.tables import Run

    with store._sessions.begin() as session:
        session.execute(update(Run).where(Run.id == run_id).values(started_utc=started))


def test_only_what_is_new_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = filled(tmp_path)
    histories = StoreHistories(store, tmp_path / "inertrim-runs")
    before = histories.read()
    read: list[str] = []
    results = store.results

    def noted(run_ids: Sequence[str]) -> list[tuple[RunRecord, str]]:
        read.extend(run_ids)
        return results(run_ids)

    monkeypatch.setattr(store, "results", noted)
    assert histories.read() is before
    assert read == []
    run, _ = store.create_run({}, "optimal", None)
    store.note_block(run.id, {"identity": {"serial": "SN0"}})
    result = result_of(terms_at(0, 12.0, np.random.default_rng(3)), fit=True)
    store.save_result(run.id, result.canonical_json(), result.verdict)
    after = histories.read()
    store.close()
    assert read == [run.id]
    assert [len(block.checks) for block in after] == [11, 10]
    assert repr(after) == repr(StoreHistories(Store(tmp_path / "inertrim.db"), tmp_path / "inertrim-runs").read())


def test_the_store_and_the_api_tell_the_same(tmp_path: Path) -> None:
    store = filled(tmp_path)
    blocks = StoreHistories(store, tmp_path / "inertrim-runs").read()
    store.close()
    assert [(block.name, len(block.checks), block.since) for block in blocks] == [
        ("SN0", 10, "calibration"),
        ("SN1", 10, "calibration"),
    ]
    assert [round(check.months, 6) for check in blocks[0].checks] == list(range(1, 11))
    assert all(np.isnan(check.sigma["f_x"]) for check in blocks[0].checks)
    with serving(settings_for(tmp_path)) as (_, client):
        listed = client.get("/api/v1/ageing", timeout=120).json()
        assert set(listed["blocks"]) == {"SN0", "SN1"}
        assert "terms" not in listed["blocks"]["SN0"]
        assert "f_x" not in listed["population"]
        one = client.get("/api/v1/ageing", params={"block": "SN0"}, timeout=120).json()["blocks"]["SN0"]
        assert one["calibrated"] == "2024-01-01"
        assert one["last_date"] == "2024-10-31"
        assert len(one["terms"]["f_z"]["history"]["value"]) == 10
        assert one["terms"]["f_z"]["forecast"]["months"][0] == pytest.approx(10.0)
        missing = client.get("/api/v1/ageing", params={"block": "none"}, timeout=120)
        assert (missing.status_code, missing.headers["content-type"]) == (404, "application/problem+json")
