"""The store in a PostgreSQL database that many launchers share, each writing under its own name."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy import Connection, Engine, create_engine, text
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, DatabaseError
from sqlalchemy.pool import NullPool

from service.store.errors import StoreError

MIGRATION_LOCK = "inertrim migration"
CONNECT_S = 5
STATEMENT_MS = 10_000


class PostgresDatabase:
    """One PostgreSQL database as the place of a store.

    Parameters
    ----------
    url
        ``postgresql://user@host/database``; a password is better kept in ``~/.pgpass`` or ``PGPASSFILE``.

    Raises
    ------
    StoreError
        The URL is of no PostgreSQL database, or the extra ``[postgres]`` is not installed.
    """

    def __init__(self, url: str) -> None:
        try:
            parsed = make_url(url)
        except ArgumentError:
            raise StoreError("[store] database_url: not a URL. Give postgresql://user@host/database.") from None
        self.name = parsed.render_as_string(hide_password=True)
        if parsed.drivername not in ("postgresql", "postgres"):
            remedy = "Give postgresql://user@host/database, or set [store] path for a file."
            raise StoreError(f"{self.name}: only PostgreSQL is known by URL. {remedy}")
        self._url = parsed.set(drivername="postgresql+psycopg")

    def hold(self, launcher: str) -> _Held:
        """Hold the launcher's name until it is closed or the process ends: a second service would abort its runs.

        Raises
        ------
        StoreError
            The server does not answer, or another service has the name.
        """
        engine = self._make_engine(poolclass=NullPool)
        try:
            connection = engine.connect().execution_options(isolation_level="AUTOCOMMIT")
        except DatabaseError as error:
            raise self.unusable(error) from None
        if not connection.scalar(text("SELECT pg_try_advisory_lock(:key)"), {"key": _key(f"launcher {launcher}")}):
            connection.close()
            remedy = "Stop that one, or give each launcher a [store] launcher of its own."
            raise StoreError(f"{self.name}: another inertrim writes to it as {launcher!r}. {remedy}")
        return _Held(connection)

    def engine(self) -> Engine:
        """Return an engine on the database; a connection that the server has dropped is made anew."""
        return self._make_engine(pool_pre_ping=True)

    def _make_engine(self, **options: object) -> Engine:
        limits = f"-c statement_timeout={STATEMENT_MS}"
        arguments = {"connect_timeout": CONNECT_S, "client_encoding": "utf8", "options": limits}
        try:
            return create_engine(self._url, connect_args=arguments, **options)
        except ModuleNotFoundError:
            remedy = "Install inertrim[postgres]."
            raise StoreError(f"{self.name}: the PostgreSQL driver is missing. {remedy}") from None

    @contextmanager
    def migrating(self, engine: Engine) -> Iterator[Connection]:
        """Give a connection on which a whole migration takes place or none of it, by one process at a time."""
        with engine.begin() as connection:
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _key(MIGRATION_LOCK)})
            yield connection

    def unusable(self, error: DatabaseError) -> StoreError:
        """Return what to tell of a server that cannot be used."""
        said = " ".join(str(error.orig).split())
        return StoreError(f"{self.name}: cannot be used ({said}). Check the server, the database and its rights.")


class _Held:
    """A session whose end gives the launcher's name back."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def close(self) -> None:
        """Give the name back."""
        self._connection.close()


def _key(name: str) -> int:
    """Return the 64-bit number by which PostgreSQL knows an advisory lock."""
    return int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), signed=True)
