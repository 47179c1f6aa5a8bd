"""What is done to a store while no service uses it."""

from __future__ import annotations

from contextlib import closing

from sqlalchemy import create_engine
from sqlalchemy.exc import DatabaseError

from service.config import StoreSettings
from service.store import revisions
from service.store.errors import StoreError
from service.store.postgres import PostgresDatabase
from service.store.sqlite import SqliteFile


def current_revision(settings: StoreSettings) -> str | None:
    """Return the revision that a store has, without changing it; None where there is no store yet.

    Raises
    ------
    StoreError
        It is none, or does not answer.
    """
    place = _place(settings)
    if isinstance(place, SqliteFile) and not place.path.exists():
        return None
    engine = create_engine(f"sqlite:///{place.path}") if isinstance(place, SqliteFile) else place.engine()
    try:
        with engine.connect() as connection:
            return revisions.revision_of(connection)
    except DatabaseError as error:
        raise place.unusable(error) from None
    finally:
        engine.dispose()


def take_back(settings: StoreSettings, revision: str) -> str | None:
    """Take a store back to an older revision and return the one it had.

    Raises
    ------
    StoreError
        A service uses it, or the revision is not an older one that is known.
    """
    place = _place(settings)
    with closing(place.hold(settings.launcher)):
        before, known = current_revision(settings), revisions.known()
        if before not in known or revision not in known[: known.index(before)]:
            older = ", ".join(known[: known.index(before)] if before in known else []) or "none"
            raise StoreError(f"{place.name}: revision {before} cannot go back to {revision}. Older ones: {older}.")
        engine = place.engine()
        try:
            with place.migrating(engine) as connection:
                revisions.downgrade(connection, revision)
        except DatabaseError as error:
            raise place.unusable(error) from None
        finally:
            engine.dispose()
        return before


def _place(settings: StoreSettings) -> SqliteFile | PostgresDatabase:
    database = settings.database
    return PostgresDatabase(database) if isinstance(database, str) else SqliteFile(database)
