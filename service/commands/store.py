"""``inertrim store``: the revision of a store, and the way back to an older one."""

from __future__ import annotations

from typing import Annotated

import typer

from service.commands.store_options import ConfigOption, store_settings

app = typer.Typer(help="Revision of the store.", no_args_is_help=True, rich_markup_mode=None)


@app.callback()
def group() -> None:
    """Show the store's revision, or take it back for an older program."""


@app.command()
def revision(config: ConfigOption = None) -> None:
    """Show which revision the store has, and which ones this program knows."""
    from service.store import revisions
    from service.store.maintenance import current_revision

    typer.echo(f"{current_revision(store_settings(config))} (known: {', '.join(revisions.known())})")


@app.command()
def downgrade(
    to: Annotated[str, typer.Argument(metavar="REVISION", help="Revision that the older program knows.")],
    config: ConfigOption = None,
) -> None:
    """Take the store back to an older revision, before the older program is installed; the service must not run."""
    from service.store.maintenance import take_back

    before = take_back(store_settings(config), to)
    typer.echo(f"revision {before} -> {to}")
