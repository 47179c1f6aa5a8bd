"""Backups taken while a run goes on, and bundles carried from store to store, by the command line."""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import sqlite3
import subprocess
import sys
import tarfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner

from service.archive import Member, write_archive
from service.cli import app, explain
from service.store import Carried, Store, TransitionRecord, revisions, utc_now

DOCUMENT = '{"schema": "inertrim/result/1", "terms": [1.5e-3, "µ"]}'


class Site:
    """A launcher's folder: settings, store, and the files of its runs."""

    def __init__(self, folder: Path, launcher: str = "north") -> None:
        folder.mkdir()
        self.folder, self.launcher = folder, launcher
        self.settings = folder / "inertrim.toml"
        self.settings.write_text(f'[store]\npath = "inertrim.db"\nlauncher = "{launcher}"\n')
        self.database, self.runs = folder / "inertrim.db", folder / "inertrim-runs"

    @contextmanager
    def store(self, *, alone: bool = False) -> Iterator[Store]:
        store = Store(self.database, self.launcher, alone=alone)
        try:
            yield store
        finally:
            store.close()

    def add_run(self, store: Store, state: str = "READY") -> str:
        """Add a run as a service leaves one."""
        run, _ = store.create_run({"method": "optimal"}, "optimal", "Ada")
        changes = [("OFFLINE", "POWER_UP"), ("POWER_UP", state)]
        records = [TransitionRecord(a, b, "why", "détail", 1.25, utc_now(), run.id) for a, b in changes]
        store.add_transitions(records)
        store.audit("Ada", "start", run.id, "accepted")
        folder = self.runs / run.id
        folder.mkdir(parents=True)
        (folder / "capture.raw").write_bytes(os.urandom(50_000))
        (folder / "recording.parquet").write_bytes(os.urandom(10_000))
        (folder / ".recording.toml.part").write_bytes(b"half")
        if state == "READY":
            store.save_result(run.id, DOCUMENT, "shift compensated")
            (folder / "result.json").write_text(DOCUMENT)
        return run.id

    def hashes(self, run_id: str) -> dict[str, str]:
        """Return the SHA-256 of every file of a run that is whole."""
        files = [path for path in (self.runs / run_id).iterdir() if not path.name.startswith(".")]
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def inertrim(*arguments: object) -> tuple[int, str]:
    """Run a command in this process and return its exit code and what it said."""
    done = CliRunner().invoke(app, [str(one) for one in arguments])
    if isinstance(done.exception, Exception):
        return explain(done.exception), str(done.exception)
    return done.exit_code, done.output


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "north")


def test_a_backup_taken_while_a_run_goes_on_brings_everything_back(site: Site, tmp_path: Path) -> None:
    stop = threading.Event()
    with site.store(alone=True) as store:
        done = site.add_run(store)
        under_way = site.add_run(store, "STAGE_1")

        def live() -> None:
            number = 0
            while not stop.is_set():
                number += 1
                change = TransitionRecord("STAGE_1", "STAGE_1", f"number {number}", "", 0.0, utc_now(), under_way)
                store.add_transitions([change])
                with (site.runs / under_way / "capture.raw").open("ab") as capture:
                    capture.write(b"more")

        living = threading.Thread(target=live)
        living.start()
        try:
            code, said = inertrim("backup", "--out", tmp_path / "a.backup", "--config", site.settings)
        finally:
            stop.set()
            living.join()
        assert code == 0, said
        before = site.hashes(done)
        confirmed = store.run(done)
        begun = (site.runs / under_way / "capture.raw").read_bytes()

    other = Site(tmp_path / "other")
    code, said = inertrim("restore", tmp_path / "a.backup", "--config", other.settings)
    assert code == 0, said
    with other.store(alone=True) as store:
        assert store.run(done) == confirmed
        assert store.result(done) == DOCUMENT
        assert other.hashes(done) == before
        kept = store.run(under_way)
        assert kept is not None
        reasons = [one["reason"] for one in kept.transitions[2:]]
        assert reasons == [f"number {number + 1}" for number in range(len(reasons))]
        assert begun.startswith((other.runs / under_way / "capture.raw").read_bytes())
        assert store.verify_audit({}).faults == ()
        assert [one["command"] for one in store.audit_log(1)] == ["restore"]
        assert store.abort_interrupted() == [done, under_way]  # a READY has to be found anew as well


def test_old_backups_are_cleared_away_once_a_new_one_is_whole(site: Site, tmp_path: Path) -> None:
    with site.store() as store:
        site.add_run(store)
    folder = tmp_path / "backups"
    folder.mkdir()
    older = [folder / f"inertrim-2026010{day}T031500Z.backup" for day in (1, 2, 3)]
    others = [folder / "before-upgrade.backup", folder / "inertrim-notes.txt"]
    for path in (*older, *others):
        path.write_text("")
    command = ("backup", "--config", site.settings, "--keep", 2, "--out")
    code, text = inertrim(*command, folder)
    assert code == 0
    (new,) = set(folder.iterdir()) - {*older, *others}
    assert sorted(folder.iterdir()) == sorted([older[2], new, *others])
    assert f"{older[0]}: removed" in text
    # A backup that comes to nothing costs none that there is.
    site.database.write_bytes(b"no database")
    assert inertrim(*command, folder)[0] == 2
    assert older[2].exists()
    code, text = inertrim(*command, tmp_path / "one.backup")
    assert (code, (tmp_path / "one.backup").exists()) == (2, False)
    assert "--keep" in text


def test_a_folder_gets_backups_named_by_time(site: Site, tmp_path: Path) -> None:
    with site.store() as store:
        site.add_run(store)
    (tmp_path / "backups").mkdir()
    assert inertrim("backup", "--out", tmp_path / "backups", "--config", site.settings)[0] == 0
    (made,) = (tmp_path / "backups").iterdir()
    assert made.suffix == ".backup"


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A backup, taken once."""
    folder = tmp_path_factory.mktemp("taken")
    site = Site(folder / "north")
    with site.store() as store:
        site.add_run(store)
    assert inertrim("backup", "--out", folder / "a.backup", "--config", site.settings)[0] == 0
    return folder / "a.backup"


def flip(position: float) -> Callable[[bytes], bytes]:
    def change(data: bytes) -> bytes:
        at = int(len(data) * position)
        return data[:at] + bytes([data[at] ^ 0xFF]) + data[at + 1 :]

    return change


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (flip(0.5), "SHA-256 differs"),
        (lambda data: data[: len(data) // 2], "damaged|cut short"),
        (lambda data: data[:1024], "damaged|cut short"),
        (lambda _: b"not a tar archive at all" * 1000, "no archive of inertrim's"),
    ],
)
def test_a_damaged_backup_is_refused_and_nothing_is_written(
    taken: Path, tmp_path: Path, damage: Callable[[bytes], bytes], reason: str
) -> None:
    (tmp_path / "a.backup").write_bytes(damage(taken.read_bytes()))
    other = Site(tmp_path / "other")
    code, said = inertrim("restore", tmp_path / "a.backup", "--config", other.settings)
    assert code == 2
    assert any(part in said for part in reason.split("|")), said
    assert "Take another copy" in said
    assert {path.name for path in other.folder.iterdir()} <= {"inertrim.toml", "inertrim.db.lock"}


def test_restore_overwrites_nothing_and_waits_for_the_service_to_end(site: Site, tmp_path: Path) -> None:
    with site.store() as store:
        site.add_run(store)
    inertrim("backup", "--out", tmp_path / "a.backup", "--config", site.settings)
    code, said = inertrim("restore", tmp_path / "a.backup", "--config", site.settings)
    assert (code, "is there already" in said) == (2, True)
    other = Site(tmp_path / "other")
    with other.store(alone=True):
        code, said = inertrim("restore", tmp_path / "a.backup", "--config", other.settings)
    assert (code, "another inertrim uses it" in said) == (2, True)


def test_a_backup_of_a_newer_store_is_refused(site: Site, tmp_path: Path) -> None:
    with site.store() as store:
        site.add_run(store)
    with sqlite3.connect(site.database) as connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    inertrim("backup", "--out", tmp_path / "a.backup", "--config", site.settings)
    code, said = inertrim("restore", tmp_path / "a.backup", "--config", Site(tmp_path / "other").settings)
    assert (code, "Update inertrim" in said) == (2, True)


def test_a_shared_database_and_a_missing_store_are_refused_with_the_remedy(tmp_path: Path) -> None:
    site = Site(tmp_path / "north")
    assert "there is no store" in inertrim("backup", "--out", tmp_path / "a", "--config", site.settings)[1]
    site.settings.write_text('[store]\ndatabase_url = "postgresql:///fleet"\n')
    code, said = inertrim("backup", "--out", tmp_path / "a", "--config", site.settings)
    assert (code, "pg_dump" in said) == (2, True)


def test_a_store_is_taken_back_by_command_and_comes_forward_by_itself(site: Site) -> None:
    with site.store() as store:
        run_id = site.add_run(store)
    newest = revisions.known()[-1]
    assert inertrim("store", "revision", "--config", site.settings)[1].startswith(f"{newest} ")
    code, said = inertrim("store", "downgrade", "0001", "--config", site.settings)
    assert (code, said.strip()) == (0, f"revision {newest} -> 0001")
    assert inertrim("store", "revision", "--config", site.settings)[1].startswith("0001 ")
    code, said = inertrim("store", "downgrade", "0001", "--config", site.settings)
    assert (code, "cannot go back" in said) == (2, True)
    with site.store() as store:
        assert store.result(run_id) == DOCUMENT


# ---------------------------------------------------------------- bundles


class Carrier:
    """A run exported from one site, and what is needed to import it at another."""

    def __init__(self, site: Site, folder: Path) -> None:
        self.site, self.bundle = site, folder / "run.bundle"
        assert inertrim("bundle", "keygen", "--out", folder / "north")[0] == 0
        self.key, self.public = folder / "north.key", folder / "north.pub"
        with site.store(alone=True) as store:
            self.run_id = site.add_run(store)
            code, said = inertrim(
                *("bundle", "export", self.run_id, "--out", self.bundle, "--key", self.key, "--config", site.settings)
            )
            assert code == 0, said

    def bring(self, target: Site, *trust: Path) -> tuple[int, str]:
        keys = [part for path in trust or (self.public,) for part in ("--trust", path)]
        return inertrim("bundle", "import", self.bundle, *keys, "--config", target.settings)


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Carrier:
    folder = tmp_path_factory.mktemp("exported")
    return Carrier(Site(folder / "north"), folder)


@pytest.fixture
def carrier(exported: Carrier, tmp_path: Path) -> Iterator[Carrier]:
    """What was exported once, with a bundle of its own for each test."""
    whole = exported.bundle
    exported.bundle = shutil.copyfile(whole, tmp_path / "run.bundle")
    yield exported
    exported.bundle = whole


@pytest.fixture(scope="module")
def empty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty store, made once."""
    path = tmp_path_factory.mktemp("empty") / "empty.db"
    Store(path).close()
    return path


def carried(site: Site, run_id: str) -> Carried:
    with site.store() as store:
        found = store.carry_out(run_id)
    assert found is not None
    return found


def test_what_is_imported_is_identical_to_what_was_exported(carrier: Carrier, tmp_path: Path) -> None:
    south = Site(tmp_path / "south", "south")
    with south.store(alone=True):  # the service there goes on meanwhile
        code, said = carrier.bring(south)
    assert code == 0, said
    assert carried(south, carrier.run_id).to_json() == carried(carrier.site, carrier.run_id).to_json()
    assert south.hashes(carrier.run_id) == carrier.site.hashes(carrier.run_id)
    with south.store() as store, carrier.site.store() as origin:
        assert store.run(carrier.run_id) == origin.run(carrier.run_id)
        assert store.result(carrier.run_id) == DOCUMENT
        assert [one["command"] for one in store.audit_log()] == ["import"]
    again = tmp_path / "again.bundle"  # and goes on as it came
    command = ("bundle", "export", carrier.run_id, "--out", again, "--key", carrier.key, "--config", south.settings)
    assert inertrim(*command)[0] == 0
    with tarfile.open(again) as one, tarfile.open(carrier.bundle) as other:
        assert {info.name for info in one} == {info.name for info in other}
        for name in ("run.json", "files/capture.raw", "files/recording.parquet", "files/result.json"):
            first, second = one.extractfile(name), other.extractfile(name)
            assert first is not None
            assert second is not None
            assert first.read() == second.read()


def test_a_run_from_elsewhere_is_nothing_that_this_launcher_did(carrier: Carrier, tmp_path: Path) -> None:
    """A READY run of another launcher of the same name stays READY when the service starts anew."""
    twin = Site(tmp_path / "twin", "north")
    with twin.store():
        pass
    assert carrier.bring(twin)[0] == 0
    with twin.store(alone=True) as store:
        assert store.last_transition() is None
        assert store.abort_interrupted() == []
        run = store.run(carrier.run_id)
    assert run is not None
    assert (run.state, run.ended_utc) == ("READY", None)


def test_a_run_is_imported_once(carrier: Carrier, tmp_path: Path) -> None:
    south = Site(tmp_path / "south")
    with south.store():
        pass
    assert carrier.bring(south)[0] == 0
    code, said = carrier.bring(south)
    assert (code, "in the store already" in said, "Nothing was changed" in said) == (2, True, True)


def rewritten(bundle: Path, change: Callable[[dict[str, bytes]], None]) -> None:
    """Change what a bundle holds as somebody with a tar program would."""
    with tarfile.open(bundle) as tar:
        held = {info.name: file.read() for info in tar if (file := tar.extractfile(info)) is not None}
    change(held)
    with tarfile.open(bundle, "w") as tar:
        for name, data in held.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))


def forge_result(held: dict[str, bytes]) -> None:
    """Change the result and make the manifest agree, as one who knows the format but has no key."""
    held["files/result.json"] = held["files/result.json"].replace(b"1.5e-3", b"9.9e-3")
    manifest = json.loads(held["manifest.json"])
    manifest["files"]["files/result.json"]["sha256"] = hashlib.sha256(held["files/result.json"]).hexdigest()
    held["manifest.json"] = json.dumps(manifest).encode()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda held: held.update({"files/capture.raw": b"\0" * 50_000}), "SHA-256 differs"),
        (lambda held: held.update({"run.json": held["run.json"].replace(b"Ada", b"Bob")}), "SHA-256 differs"),
        (forge_result, "the signature does not hold"),
        (lambda held: held.update({"files/more.txt": b"added"}), "was added"),
        (lambda held: held.pop("files/recording.parquet"), "is missing"),
        (lambda held: held.pop("signature.json"), "is not signed"),
        (lambda held: held.update({"signature.json": b"{}"}), "signature.json is damaged"),
        (lambda held: held.update({"../outside": b"escaped"}), "which no archive of inertrim's does"),
        (lambda held: held.update({"/outside": b"escaped"}), "which no archive of inertrim's does"),
    ],
)
def test_a_bundle_that_was_changed_is_refused(
    carrier: Carrier, empty: Path, tmp_path: Path, change: Callable[[dict[str, bytes]], None], reason: str
) -> None:
    rewritten(carrier.bundle, change)
    south = Site(tmp_path / "south")
    shutil.copyfile(empty, south.database)
    for code, said in (
        inertrim("bundle", "verify", carrier.bundle, "--trust", carrier.public),
        carrier.bring(south),
    ):
        assert code == 2
        assert reason in said
    with sqlite3.connect(south.database) as database:
        assert database.execute("SELECT count(*) FROM runs").fetchone() == (0,)
    assert not south.runs.exists()


def test_a_key_that_is_not_trusted_is_told_by_its_fingerprint(carrier: Carrier, tmp_path: Path) -> None:
    said = inertrim("bundle", "keygen", "--out", tmp_path / "stranger")[1]
    stranger = said.split("key ")[-1].strip()
    code, said = inertrim("bundle", "verify", carrier.bundle, "--trust", tmp_path / "stranger.pub")
    assert code == 2
    assert "is not trusted" in said
    assert stranger in said
    both = ("--trust", tmp_path / "stranger.pub", "--trust", carrier.public)
    assert inertrim("bundle", "verify", carrier.bundle, *both)[0] == 0
    assert "no Ed25519 public key" in inertrim("bundle", "verify", carrier.bundle, "--trust", carrier.key)[1]
    code, said = inertrim("bundle", "keygen", "--out", tmp_path / "stranger")
    assert (code, "is there already" in said) == (2, True)
    assert (tmp_path / "stranger.key").stat().st_mode & 0o077 == 0


def test_a_run_under_way_is_not_exported(carrier: Carrier, tmp_path: Path) -> None:
    with carrier.site.store() as store:
        run_id = carrier.site.add_run(store, "STAGE_2")
    command = ("bundle", "export", run_id, "--out", tmp_path / "b", "--key", carrier.key)
    code, said = inertrim(*command, "--config", carrier.site.settings)
    assert (code, "is under way (STAGE_2)" in said) == (2, True)
    assert not (tmp_path / "b").exists()


def test_a_backup_is_no_bundle(carrier: Carrier, tmp_path: Path) -> None:
    write_archive(tmp_path / "a", "inertrim/bundle/2", {}, [Member("files/a", carrier.key)])
    code, said = inertrim("restore", tmp_path / "a", "--config", Site(tmp_path / "other").settings)
    assert (code, "is of schema inertrim/bundle/2, not inertrim/backup/1" in said) == (2, True)


def test_the_commands_are_there_as_a_user_types_them(carrier: Carrier) -> None:
    command = [sys.executable, "-m", "service.cli", "bundle", "verify", carrier.bundle, "--trust", carrier.public]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert f"run {carrier.run_id} of north, whole and signed by a trusted key" in done.stdout
