"""``inertrim backup`` and ``inertrim restore``: a store with its runs in one file, and back."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.commands.store_options import ConfigOption, store_settings, who


def backup(
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="Backup to write, or a folder to name it in by the time.")
    ],
    config: ConfigOption = None,
) -> None:
    """Back up the store and every run, while the service runs or not."""
    from service.backup import backup as take

    path, manifest = take(store_settings(config), out)
    size = sum(one["bytes"] for one in manifest["files"].values())
    typer.echo(f"{path}: {len(manifest['files'])} files, {size / 1e6:.1f} MB")


def restore(
    backup: Annotated[Path, typer.Argument(metavar="BACKUP", help="What `inertrim backup` wrote.")],
    config: ConfigOption = None,
) -> None:
    """Put a backup where the settings say the store is; nothing may be there, and the service must not run."""
    from service.backup import restore as put_back

    settings = store_settings(config)
    manifest = put_back(settings, backup, who())
    typer.echo(f"{settings.path}: as it was at {manifest['created_utc']}, {len(manifest['files'])} files")
