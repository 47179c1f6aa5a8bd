"""The store: durable, one owner, refusing what it cannot use; the same in a file and in a real PostgreSQL."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from http_bench import serving
from postgres_bench import Postgres, postgres_server
from sqlalchemy import text

from service.config import StoreSettings, load_settings
from service.store import Store, StoreError, TokenRecord, TransitionRecord, revisions, utc_now
from service.store.maintenance import current_revision, take_back
from service.store.postgres import PostgresDatabase
from service.store.sqlite import SqliteFile

REQUEST = {"method": "paper"}
Database = Path | str


@pytest.fixture(scope="module")
def postgres() -> Iterator[Postgres]:
    with postgres_server() as server:
        yield server


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Database:
    """An empty place for a store, of each kind."""
    if request.param == "sqlite":
        return tmp_path / "a.db"
    server: Postgres = request.getfixturevalue("postgres")
    return server.database_url()


def execute(database: Database, statement: str) -> None:
    place = PostgresDatabase(database) if isinstance(database, str) else SqliteFile(database)
    with place.engine().begin() as connection:
        connection.execute(text(statement))


def change(target: str, run_id: str | None, source: str = "OFFLINE") -> TransitionRecord:
    return TransitionRecord(source, target, "reason", "detail", 1.5, utc_now(), run_id)


def test_what_is_written_is_there_after_opening_again(database: Database) -> None:
    store = Store(database)
    run, new = store.create_run(REQUEST, "paper", "Ada", "key")
    assert new
    store.add_transitions([change("POWER_UP", run.id), change("READY", run.id, "VERIFYING")])
    store.save_result(run.id, '{"a": 1}', "shift compensated")
    store.audit("Ada", "start", run.id, "accepted")
    store.close()
    store = Store(database)
    again = store.run(run.id)
    assert again is not None
    assert (again.state, again.verdict, again.ended_utc) == ("READY", "shift compensated", None)
    assert [one["target"] for one in again.transitions] == ["POWER_UP", "READY"]
    assert store.result(run.id) == '{"a": 1}'
    assert store.audit_log()[0]["who"] == "Ada"
    assert store.create_run(REQUEST, "paper", "Ada", "key") == (store.runs(1)[0], False)


def test_a_run_that_is_over_keeps_its_end(database: Database) -> None:
    store = Store(database)
    run, _ = store.create_run(REQUEST, "paper", None)
    store.add_transitions([change("FAULT", run.id), change("OFFLINE", run.id, "FAULT")])
    ended = store.run(run.id)
    assert ended is not None
    assert ended.state == "FAULT"
    assert ended.ended_utc is not None
    assert store.abort_interrupted() == []


def test_only_open_runs_are_aborted_at_a_new_start(database: Database) -> None:
    store = Store(database)
    runs = [store.create_run(REQUEST, "paper", None)[0].id for _ in range(3)]
    store.add_transitions([change("ABORTED", runs[0])])
    store.end_run(runs[1])
    assert store.abort_interrupted() == [runs[2]]
    last = store.last_transition()
    assert last is not None
    assert (last["run_id"], last["target"], last["reason"]) == (runs[2], "ABORTED", "service_stopped")


def test_a_store_killed_in_the_middle_of_writing_has_all_that_was_confirmed(database: Database) -> None:
    code = (
        "import os, signal, sys\nfrom pathlib import Path\nfrom service.store import Store\n"
        "place = sys.argv[1] if '://' in sys.argv[1] else Path(sys.argv[1])\n"
        "store = Store(place, alone=True)\n"
        "for number in range(40):\n    print(store.create_run({'n': number}, 'paper', None)[0].id, flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    killed = subprocess.run([sys.executable, "-c", code, str(database)], capture_output=True, text=True, check=False)
    confirmed = killed.stdout.split()
    assert len(confirmed) == 40, killed.stderr
    store = owner_after_death(database)
    assert sorted(run.id for run in store.runs(100)) == sorted(confirmed)


def owner_after_death(database: Database) -> Store:
    """Open a store whose owner was killed; a server takes a moment to see that its client is gone."""
    for _ in range(100):
        try:
            return Store(database, alone=True)
        except StoreError:
            time.sleep(0.05)
    return Store(database, alone=True)


def test_a_second_owner_is_refused(database: Database) -> None:
    first = Store(database, alone=True)
    with pytest.raises(StoreError, match="another inertrim"):
        Store(database, alone=True)
    first.close()
    Store(database, alone=True).close()


def test_what_is_no_store_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "text.db").write_text("not a database, but long enough to have a header of one\n" * 100)
    with pytest.raises(StoreError, match=r"text\.db: not a usable store"):
        Store(tmp_path / "text.db")
    with pytest.raises(StoreError, match="folder does not exist"):
        Store(tmp_path / "nowhere" / "a.db")


def test_a_newer_store_is_refused(database: Database) -> None:
    Store(database).close()
    execute(database, "UPDATE alembic_version SET version_num = '9999'")
    with pytest.raises(StoreError, match="newer inertrim"):
        Store(database)


def test_tables_and_migrations_agree(database: Database) -> None:
    from alembic.autogenerate import compare_metadata
    from alembic.migration import MigrationContext

    from service.store.tables import Base

    Store(database).close()
    place = PostgresDatabase(database) if isinstance(database, str) else SqliteFile(database)
    with place.engine().connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []


def test_launchers_that_share_a_store_leave_each_other_alone(database: Database) -> None:
    north, south = Store(database, "north"), Store(database, "south")
    run, _ = north.create_run(REQUEST, "paper", None, "key")
    other, new = south.create_run(REQUEST, "paper", None, "key")  # a key is one console's with one launcher
    assert new
    assert other.id != run.id
    north.add_transitions([change("FAULT", run.id)])
    south.add_transitions([change("SETTLING", other.id)])
    left = north.last_transition()
    assert left is not None
    assert (left["run_id"], left["target"]) == (run.id, "FAULT")
    assert north.abort_interrupted() == []
    assert south.abort_interrupted() == [other.id]
    assert [record.launcher for record in north.runs(10)] == ["south", "north"]


def test_a_launchers_name_in_a_shared_database_has_one_owner(postgres: Postgres) -> None:
    url = postgres.database_url()
    north = Store(url, "north", alone=True)
    Store(url, "south", alone=True).close()
    with pytest.raises(StoreError, match="another inertrim writes to it as 'north'"):
        Store(url, "north", alone=True)
    north.close()
    Store(url, "north", alone=True).close()


WRITER = """
import sys
from service.store import Store, TransitionRecord, utc_now
store = Store(sys.argv[1], sys.argv[2], alone=True)
for number in range(int(sys.argv[3])):
    run, _ = store.create_run({"n": number}, "optimal", sys.argv[2], f"key {number}")
    states = ("POWER_UP", "SETTLING", "ALIGNING", "READY")
    for before, after in zip(states, states[1:]):
        store.add_transitions([TransitionRecord(before, after, "reason", "", float(number), utc_now(), run.id)])
    store.save_result(run.id, f'{{"n": {number}}}', "fit")
    store.audit(sys.argv[2], "start", run.id, "accepted")
    store.end_run(run.id)
"""


def test_many_launchers_write_to_one_database_at_once_and_nothing_is_lost(postgres: Postgres) -> None:
    url, launchers, each = postgres.database_url(), [f"launcher {number}" for number in range(4)], 25
    writers = [
        subprocess.Popen([sys.executable, "-c", WRITER, url, name, str(each)], stderr=subprocess.PIPE, text=True)
        for name in launchers  # all of them find the database empty and would make its tables
    ]
    for writer in writers:
        assert writer.wait(120) == 0, writer.communicate()[1]
    store = Store(url)
    runs = store.runs(1000)
    assert sorted((run.launcher, run.request["n"]) for run in runs) == [(a, b) for a in launchers for b in range(each)]
    for run in runs:
        whole = store.run(run.id)
        assert whole is not None
        assert [one["target"] for one in whole.transitions] == ["SETTLING", "ALIGNING", "READY"]
        assert store.result(run.id) == f'{{"n": {run.request["n"]}}}'
    assert len(store.audit_log(10_000)) == len(runs)


@pytest.mark.parametrize(
    ("url", "named"),
    [
        ("postgresql://nobody@/none?host=/nonexistent", "Check the server"),
        ("mysql://host/store", "only PostgreSQL is known"),
        ("launchers", "not a URL"),
    ],
)
def test_a_database_that_cannot_be_used_is_refused_by_name(url: str, named: str) -> None:
    with pytest.raises(StoreError, match=named):
        Store(url, alone=True)
    with pytest.raises(StoreError, match=named):
        Store(url)


def test_a_password_is_never_told() -> None:
    with pytest.raises(StoreError) as refused:
        Store("postgresql://ada:secret@/none?host=/nonexistent")
    assert "ada" in str(refused.value)
    assert "secret" not in str(refused.value)


def fill(store: Store) -> list[str]:
    """Put something into every table."""
    runs = [store.create_run({"n": number}, "optimal", "Ada", f"key {number}")[0].id for number in range(3)]
    for run_id in runs:
        store.add_transitions([change("POWER_UP", run_id), change("FAULT", run_id, "SETTLING")])
        store.save_result(run_id, f'{{"of": "{run_id}"}}', "not fit")
        store.audit("Ada", "start", run_id, "accepted", "détail")
    store.add_token(TokenRecord("id", "console", "viewer", "hash", utc_now()))
    return runs


@pytest.mark.parametrize("revision", revisions.known()[:-1])
def test_a_filled_store_goes_back_to_an_older_revision_and_forth(database: Database, revision: str) -> None:
    store = Store(database)
    before = [store.run(run_id) for run_id in fill(store)]
    store.close()
    where = {"path": database} if isinstance(database, Path) else {"database_url": database}
    settings = StoreSettings.model_validate(where)
    assert take_back(settings, revision) == revisions.known()[-1]
    assert current_revision(settings) == revision
    store = Store(database)  # the newer program again
    assert current_revision(settings) == revisions.known()[-1]
    assert [store.run(run.id) for run in before if run is not None] == before
    assert [store.result(run.id) for run in before if run is not None] == [
        f'{{"of": "{run.id}"}}' for run in before if run is not None
    ]
    assert store.verify_audit({}).faults == ()
    assert [entry["detail"] for entry in store.audit_log()] == ["détail"] * 3
    assert store.create_run({"n": 1}, "optimal", "Ada", "key 1")[1] is False
    store.close()


def test_going_back_is_refused_where_it_cannot_be(tmp_path: Path) -> None:
    settings = StoreSettings(path=tmp_path / "a.db")
    with pytest.raises(StoreError, match="cannot go back"):
        take_back(settings, "0001")  # there is none yet
    store = Store(settings.path, alone=True)
    with pytest.raises(StoreError, match="another inertrim uses it"):
        take_back(settings, "0001")
    store.close()
    for revision in ("9999", revisions.known()[-1]):
        with pytest.raises(StoreError, match="cannot go back"):
            take_back(settings, revision)


def test_a_service_runs_on_a_shared_database(postgres: Postgres, tmp_path: Path) -> None:
    store = {"path": tmp_path / "inertrim.db", "database_url": postgres.database_url(), "launcher": "north"}
    line, site = {"url": str(tmp_path / "no-line")}, {"latitude_deg": 35.7}
    with serving(load_settings(None, store=store, link=line, site=site)) as (controller, client):
        run_id = client.post("/api/v1/runs", json={"method": "paper"}).json()["run_id"]
        assert client.post(f"/api/v1/runs/{run_id}/abort", json={"operator": "Ada"}).status_code == 202
        assert client.get("/readyz").status_code == 200
        deadline_s = time.monotonic() + 20.0
        while client.get(f"/api/v1/runs/{run_id}").json()["ended"] is None:  # the recorder writes behind
            assert time.monotonic() < deadline_s
            time.sleep(0.02)
        assert controller.store.verify_audit({}).faults == ()
    south = Store(store["database_url"], "south")
    run = south.run(run_id)
    south.close()
    assert run is not None
    assert (run.launcher, run.state) == ("north", "ABORTED")
    assert (tmp_path / "inertrim-runs" / run_id).is_dir()
    assert not (tmp_path / "inertrim.db").exists()
