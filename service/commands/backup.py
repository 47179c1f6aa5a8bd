"""``inertrim backup`` and ``inertrim restore``: a store with its runs in one file, and back."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.commands.store_options import ConfigOption, store_settings, who
from service.errors import RefusedInput


def backup(
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="Backup to write, or a folder to name it in by the time.")
    ],
    keep: Annotated[
        int | None, typer.Option("--keep", metavar="N", min=1, help="In a folder: remove all older ones but N in all.")
    ] = None,
    config: ConfigOption = None,
) -> None:
    """Back up the store and every run, while the service runs or not."""
    from service.backup import backup as take
    from service.backup import clear_older

    if keep is not None and not out.is_dir():
        raise RefusedInput("--keep", f"means nothing where {out} is no folder.", "Give a folder with --out.")
    path, manifest = take(store_settings(config), out)
    size = sum(one["bytes"] for one in manifest["files"].values())
    typer.echo(f"{path}: {len(manifest['files'])} files, {size / 1e6:.1f} MB")
    if keep is not None:  # now that the new one is whole
        for older in clear_older(out, keep):
            typer.echo(f"{older}: removed")


def restore(
    backup: Annotated[Path, typer.Argument(metavar="BACKUP", help="What `inertrim backup` wrote.")],
    config: ConfigOption = None,
) -> None:
    """Put a backup where the settings say the store is; nothing may be there, and the service must not run."""
    from service.backup import restore as put_back

    settings = store_settings(config)
    manifest = put_back(settings, backup, who())
    typer.echo(f"{settings.path}: as it was at {manifest['created_utc']}, {len(manifest['files'])} files")
