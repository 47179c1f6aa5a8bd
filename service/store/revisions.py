"""Revisions of the store: brought up to date when it is opened, taken back on an operator's word."""

from __future__ import annotations

from pathlib import Path

import alembic.command
import alembic.config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection

MIGRATIONS = Path(__file__).parent / "migrations"


def upgrade(connection: Connection) -> None:
    """Bring a store up to date.

    Raises
    ------
    alembic.util.exc.CommandError
        It was written by a newer program.
    """
    alembic.command.upgrade(_config(connection), "head")


def downgrade(connection: Connection, revision: str) -> None:
    """Take a store back to an older revision, keeping what that one has room for."""
    alembic.command.downgrade(_config(connection), revision)


def revision_of(connection: Connection) -> str | None:
    """Return a store's revision, None for one that is empty."""
    revision: str | None = MigrationContext.configure(connection).get_current_revision()
    return revision


def known() -> list[str]:
    """Return the revisions this program knows, oldest first."""
    script = ScriptDirectory(str(MIGRATIONS))
    return [revision.revision for revision in reversed(list(script.walk_revisions()))]


def _config(connection: Connection) -> alembic.config.Config:
    config = alembic.config.Config()
    config.set_main_option("script_location", str(MIGRATIONS))
    config.attributes["connection"] = connection
    return config
