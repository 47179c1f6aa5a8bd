"""The store: durable, one owner, refusing what it cannot use."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from service.store import Store, StoreError, TransitionRecord, utc_now

REQUEST = {"method": "paper"}


def change(target: str, run_id: str | None, source: str = "OFFLINE") -> TransitionRecord:
    return TransitionRecord(source, target, "reason", "detail", 1.5, utc_now(), run_id)


def test_what_is_written_is_there_after_opening_again(tmp_path: Path) -> None:
    store = Store(tmp_path / "a.db")
    run, new = store.create_run(REQUEST, "paper", "Ada", "key")
    assert new
    store.add_transitions([change("POWER_UP", run.id), change("READY", run.id, "VERIFYING")])
    store.save_result(run.id, '{"a": 1}', "shift compensated")
    store.audit("Ada", "start", run.id, "accepted")
    store.close()
    store = Store(tmp_path / "a.db")
    again = store.run(run.id)
    assert again is not None
    assert (again.state, again.verdict, again.ended_utc) == ("READY", "shift compensated", None)
    assert [one["target"] for one in again.transitions] == ["POWER_UP", "READY"]
    assert store.result(run.id) == '{"a": 1}'
    assert store.audit_log()[0]["who"] == "Ada"
    assert store.create_run(REQUEST, "paper", "Ada", "key") == (store.runs(1)[0], False)


def test_a_run_that_is_over_keeps_its_end(tmp_path: Path) -> None:
    store = Store(tmp_path / "a.db")
    run, _ = store.create_run(REQUEST, "paper", None)
    store.add_transitions([change("FAULT", run.id), change("OFFLINE", run.id, "FAULT")])
    ended = store.run(run.id)
    assert ended is not None
    assert ended.state == "FAULT"
    assert ended.ended_utc is not None
    assert store.abort_interrupted() == []


def test_only_open_runs_are_aborted_at_a_new_start(tmp_path: Path) -> None:
    store = Store(tmp_path / "a.db")
    runs = [store.create_run(REQUEST, "paper", None)[0].id for _ in range(3)]
    store.add_transitions([change("ABORTED", runs[0])])
    store.end_run(runs[1])
    assert store.abort_interrupted() == [runs[2]]
    last = store.last_transition()
    assert last is not None
    assert (last["run_id"], last["target"], last["reason"]) == (runs[2], "ABORTED", "service_stopped")


def test_a_store_killed_in_the_middle_of_writing_has_all_that_was_confirmed(tmp_path: Path) -> None:
    code = (
        "import os, signal, sys\nfrom pathlib import Path\nfrom service.store import Store\n"
        "store = Store(Path(sys.argv[1]), alone=True)\n"
        "for number in range(40):\n    print(store.create_run({'n': number}, 'paper', None)[0].id, flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    path = tmp_path / "a.db"
    killed = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=False)
    confirmed = killed.stdout.split()
    assert len(confirmed) == 40
    store = Store(path, alone=True)  # the lock died with its owner
    assert sorted(run.id for run in store.runs(100)) == sorted(confirmed)


def test_a_second_owner_is_refused(tmp_path: Path) -> None:
    first = Store(tmp_path / "a.db", alone=True)
    with pytest.raises(StoreError, match="another inertrim uses it"):
        Store(tmp_path / "a.db", alone=True)
    first.close()
    Store(tmp_path / "a.db", alone=True).close()


def test_what_is_no_store_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "text.db").write_text("not a database, but long enough to have a header of one\n" * 100)
    with pytest.raises(StoreError, match=r"text\.db: not a usable store"):
        Store(tmp_path / "text.db")
    with pytest.raises(StoreError, match="folder does not exist"):
        Store(tmp_path / "nowhere" / "a.db")


def test_a_newer_store_is_refused(tmp_path: Path) -> None:
    Store(tmp_path / "a.db").close()
    with sqlite3.connect(tmp_path / "a.db") as connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    with pytest.raises(StoreError, match="newer inertrim"):
        Store(tmp_path / "a.db")


def test_tables_and_migrations_agree(tmp_path: Path) -> None:
    from alembic.autogenerate import compare_metadata
    from alembic.migration import MigrationContext
    from sqlalchemy import create_engine

    from service.store.tables import Base

    Store(tmp_path / "a.db").close()
    with create_engine(f"sqlite:///{tmp_path / 'a.db'}").connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []
