"""The store in one SQLite file: WAL and ``synchronous=FULL``, so that a commit survives SIGKILL and power loss."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.exc import DatabaseError

from service.store.errors import StoreError

BUSY_S = 10.0
"""Real seconds that a write waits for another process's."""
CACHE_KB = 256
"""Of the file's pages that a connection keeps. SQLite's own 2 MB for each of the pool's connections fill as the store
grows, for weeks; and the kernel keeps the file's pages already, once for all of them."""


class SqliteFile:
    """One SQLite file as the place of a store.

    Raises
    ------
    StoreError
        Its folder does not exist.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, str(path)
        if not path.parent.is_dir():
            raise StoreError(f"{path}: the folder does not exist. Make it, or set another store path.")

    def hold(self, launcher: str) -> IO[bytes]:
        """Hold ``PATH.lock`` until it is closed or the process ends: two services would abort each other's runs.

        Raises
        ------
        StoreError
            The file cannot be written, or another service holds it.
        """
        del launcher  # whatever it is called, one service a file
        return lock(self.path)

    def engine(self) -> Engine:
        """Return an engine on the file."""
        engine = create_engine(f"sqlite:///{self.path}", connect_args={"timeout": BUSY_S})
        event.listen(engine, "connect", _prepare_connection)
        return engine

    @contextmanager
    def migrating(self, engine: Engine) -> Iterator[Connection]:
        """Give a connection on which a whole migration takes place or none of it, by one process at a time."""
        with engine.connect() as connection:
            # A table that others refer to is made anew by some migrations; in a transaction this cannot be switched.
            connection.exec_driver_sql("PRAGMA foreign_keys=OFF")
            connection.exec_driver_sql("BEGIN IMMEDIATE")
            yield connection
            broken = connection.exec_driver_sql("PRAGMA foreign_key_check").fetchone()
            if broken is not None:
                raise StoreError(f"{self.path}: table {broken[0]} refers to rows that are not there. Restore a backup.")
            connection.commit()
            connection.exec_driver_sql("PRAGMA foreign_keys=ON")

    def unusable(self, error: DatabaseError) -> StoreError:
        """Return what to tell of a file that is no store."""
        return StoreError(f"{self.path}: not a usable store ({error.orig}). Restore it, or set another path.")


def lock(path: Path) -> IO[bytes]:
    """Hold ``PATH.lock`` of a store file until it is closed or the process ends.

    Raises
    ------
    StoreError
        The file cannot be written, or another process holds it.
    """
    try:
        file = path.with_name(path.name + ".lock").open("ab")
    except OSError as error:
        raise StoreError(f"{path}: cannot be used ({error.strerror}). Set a store path that can be written.") from None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        raise StoreError(f"{path}: another inertrim uses it. Stop that one, or set another store path.") from None
    return file


def _prepare_connection(connection: Any, _record: Any) -> None:
    cursor = connection.cursor()
    cursor.execute("PRAGMA journal_mode=WAL")
    cursor.execute("PRAGMA synchronous=FULL")
    cursor.execute("PRAGMA foreign_keys=ON")
    cursor.execute(f"PRAGMA cache_size=-{CACHE_KB}")
    cursor.close()
