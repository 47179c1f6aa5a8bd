"""Backup and restore of a store in a file: the database, the audit's witness, and every run's folder.

A backup is taken while the service runs: the database by SQLite's online backup, which sees one moment of it; the
files of the runs after that, so that nothing the database speaks of is missing. A capture that grows is taken as far as
it has come, as after a power cut.
"""

from __future__ import annotations

import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from service.archive import Archive, Member, write_archive
from service.config import StoreSettings
from service.errors import RefusedInput
from service.store import Store, revisions, utc_now
from service.store.sqlite import lock

SCHEMA = "inertrim/backup/1"
DATABASE, WITNESS, RUNS = "inertrim.db", "inertrim.db.audit", "runs"
DUMP = "Use pg_dump and pg_restore for the database (docs/fleet.md), and copy the runs' folders."


def backup(settings: StoreSettings, out: Path) -> tuple[Path, dict[str, Any]]:
    """Write a backup and return its path and manifest; into a folder, under a name that tells the time.

    Raises
    ------
    RefusedInput
        There is no store in a file, or it is damaged.
    """
    source = _file_of(settings)
    if not source.is_file():
        raise RefusedInput(str(source), "there is no store.", "Give the settings of the service with --config.")
    if out.is_dir():
        out = out / f"inertrim-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.backup"
    with tempfile.TemporaryDirectory(prefix="inertrim-", dir=out.parent) as folder:
        copy = Path(folder) / DATABASE
        revision = _copy_database(source, copy)
        about = {"created_utc": utc_now(), "software": version("inertrim"), "revision": revision}
        manifest = write_archive(out, SCHEMA, about, _members(copy, source, settings.runs))
    return out, manifest


def clear_older(folder: Path, keep: int) -> list[Path]:
    """Remove the backups named by their time in a folder, the newest so many excepted, and return what was removed."""
    older = sorted(folder.glob("inertrim-????????T??????Z.backup"))[:-keep]
    for path in older:
        path.unlink()
    return older


def restore(settings: StoreSettings, path: Path, who: str) -> dict[str, Any]:
    """Put a backup where the settings say that the store is, and return its manifest.

    The whole backup is checked before anything is written. The service must not run.

    Raises
    ------
    RefusedInput
        The backup is damaged, newer or of another kind, or there is a store already.
    StoreError
        The service runs.
    """
    target = _file_of(settings)
    if not target.parent.is_dir():
        raise RefusedInput(str(target), "the folder does not exist.", "Make it, or set another store path.")
    with closing(lock(target)), Archive(path, SCHEMA) as archive:
        for place in (target, settings.runs):
            if place.exists():
                raise RefusedInput(str(place), "is there already.", "Move it away, or set another [store] path.")
        if archive.manifest["revision"] not in revisions.known():
            reason = f"holds a store of revision {archive.manifest['revision']}, which this inertrim does not know."
            raise RefusedInput(str(path), reason, "Update inertrim.")
        with tempfile.TemporaryDirectory(prefix=".inertrim-restore-", dir=target.parent) as folder:
            made = Path(folder)
            for name in archive.names:
                archive.extract(name, made / name)
            _check_database(made / DATABASE, path)
            (made / RUNS).mkdir(exist_ok=True)
            (made / RUNS).replace(settings.runs)
            if (made / WITNESS).exists():
                (made / WITNESS).replace(target.with_name(f"{target.name}.audit"))
            (made / DATABASE).replace(target)  # last: without it there is no store yet
        store = Store(target, settings.launcher)
        store.audit(who, "restore", None, "accepted", f"{path.name} of {archive.manifest['created_utc']}")
        store.close()
        return archive.manifest


def _file_of(settings: StoreSettings) -> Path:
    if settings.database_url is not None:
        raise RefusedInput("[store] database_url", "a shared database is not backed up by its launchers.", DUMP)
    return settings.path


def _copy_database(source: Path, copy: Path) -> str:
    """Copy the database as it is at one moment and return its revision."""
    try:
        with closing(sqlite3.connect(source)) as live, closing(sqlite3.connect(copy)) as target:
            live.backup(target)
            target.execute("PRAGMA journal_mode=DELETE")  # one file, without a log beside it
            revision: str = target.execute("SELECT version_num FROM alembic_version").fetchone()[0]
            return revision
    except (sqlite3.DatabaseError, TypeError) as error:
        raise RefusedInput(str(source), f"is no usable store ({error}).", "Restore a backup.") from None


def _check_database(path: Path, archive: Path) -> None:
    try:
        with closing(sqlite3.connect(path)) as database:
            found = database.execute("PRAGMA integrity_check").fetchone()[0]
    except sqlite3.DatabaseError as error:
        found = str(error)
    if found != "ok":
        raise RefusedInput(str(archive), f"its database is damaged ({found}).", "Take another backup.")


def _members(copy: Path, source: Path, runs: Path) -> Iterator[Member]:
    """Yield what is carried."""
    yield Member(DATABASE, copy)
    witness = source.with_name(f"{source.name}.audit")
    if witness.is_file():
        yield Member(WITNESS, witness)
    for folder in sorted(runs.iterdir()) if runs.is_dir() else ():
        yield from run_members(folder, f"{RUNS}/{folder.name}")


def run_members(folder: Path, under: str) -> Iterator[Member]:
    """Yield the files of one run's folder, hidden ones (half written) left out.

    A part of a capture that a running service compresses meanwhile has a new name in the second look.
    """
    told: set[Path] = set()
    for _ in range(2):
        for path in sorted(folder.rglob("*")):
            hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
            if path.is_file() and not hidden and path not in told:
                told.add(path)
                yield Member(f"{under}/{path.relative_to(folder).as_posix()}", path)
