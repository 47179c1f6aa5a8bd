"""Options of the commands that work on a store, and who is at the keyboard."""

from __future__ import annotations

import getpass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from service.config import StoreSettings

ConfigOption = Annotated[
    Path | None, typer.Option("--config", metavar="FILE", help="Settings (TOML) of the service whose store is meant.")
]


def store_settings(config: Path | None) -> StoreSettings:
    """Return the ``[store]`` of a service's settings."""
    from service.config import load_settings

    return load_settings(config).store


def who() -> str:
    """Return the account that gave the command, for the audit."""
    try:
        return f"{getpass.getuser()} at the command line"
    except (KeyError, OSError):  # an account without a name, as in a container
        return "the command line"
