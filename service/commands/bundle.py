"""``inertrim bundle``: one run as one signed file, carried from site to site."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.commands.store_options import ConfigOption, store_settings, who

app = typer.Typer(help="Runs carried as signed files.", no_args_is_help=True, rich_markup_mode=None)

BundleArgument = Annotated[Path, typer.Argument(metavar="BUNDLE", help="What `inertrim bundle export` wrote.")]
TrustOption = Annotated[
    list[Path], typer.Option("--trust", metavar="FILE", help="Public key that is trusted; may be given again.")
]


@app.callback()
def group() -> None:
    """Export, check and import runs as signed files."""


@app.command()
def keygen(
    out: Annotated[Path, typer.Option("--out", metavar="NAME", help="Writes NAME.key (secret) and NAME.pub.")],
) -> None:
    """Make a pair of keys: the .key signs and stays, the .pub is given to those who import."""
    from service.signing import make_keys

    private, public, fingerprint = make_keys(out)
    typer.echo(f"{private} (secret), {public}: key {fingerprint}")


@app.command()
def export(
    run: Annotated[str, typer.Argument(metavar="RUN", help="Id of the run.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Bundle to write.")],
    key: Annotated[Path, typer.Option("--key", metavar="FILE", help="Private key that signs it.")],
    config: ConfigOption = None,
) -> None:
    """Write a run with everything that belongs to it into one signed file."""
    from service.bundle import export_run

    manifest = export_run(store_settings(config), run, out, key)
    typer.echo(f"{out}: run {run}, {manifest['state']}, {len(manifest['files'])} files")


@app.command()
def verify(bundle: BundleArgument, trust: TrustOption) -> None:
    """Check a bundle: whole, unchanged, and signed by somebody who is trusted."""
    from service.bundle import verify_bundle

    manifest = verify_bundle(bundle, trust)
    typer.echo(f"{bundle}: run {manifest['run']} of {manifest['launcher']}, whole and signed by a trusted key")


@app.command("import")
def import_(bundle: BundleArgument, trust: TrustOption, config: ConfigOption = None) -> None:
    """Add a bundle's run to the store, identical to what was exported."""
    from service.bundle import import_bundle

    manifest = import_bundle(store_settings(config), bundle, trust, who())
    typer.echo(f"run {manifest['run']} of {manifest['launcher']}: imported")
