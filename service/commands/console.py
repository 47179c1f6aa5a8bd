"""``inertrim console``: a launch console in a terminal, over HTTP."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from service.console.client import ConsoleClient

app = typer.Typer(
    help="Start, follow and abort runs over HTTP (docs/console-integration.md).",
    no_args_is_help=True,
    rich_markup_mode=None,
)
TOKEN_VARIABLE = "INERTRIM_CONSOLE_TOKEN"
UrlOption = Annotated[str, typer.Option("--url", metavar="URL", help="Where the service listens.")]
TokenOption = Annotated[
    Path | None,
    typer.Option("--token-file", metavar="FILE", help=f"File that holds the token; else {TOKEN_VARIABLE}."),
]
CertificateOption = Annotated[
    Path | None, typer.Option("--ca", metavar="FILE", help="PEM certificate that the service's own is trusted by.")
]
OperatorOption = Annotated[str, typer.Option("--operator", metavar="NAME", help="Stands in the audit log.")]
LOCAL = "http://127.0.0.1:8780"


@app.command()
def follow(url: UrlOption = LOCAL, token_file: TokenOption = None, ca: CertificateOption = None) -> None:
    """Show the run in hand until it ends; Ctrl-C leaves it running."""
    _follow(_client(url, token_file, ca))


@app.command()
def start(
    operator: OperatorOption,
    method: Annotated[str, typer.Option("--method", help="optimal or paper.")] = "optimal",
    azimuth_deg: Annotated[float | None, typer.Option("--azimuth", metavar="DEG", help="Of the launcher, now.")] = None,
    url: UrlOption = LOCAL,
    token_file: TokenOption = None,
    ca: CertificateOption = None,
) -> None:
    """Take the lease, start a run and follow it; exit code 0 when it ends fit, else 1."""
    client = _client(url, token_file, ca)
    with client.commanding(operator):
        run_id = client.start({"method": method, "azimuth_deg": azimuth_deg, "operator": operator})
        typer.echo(f"run {run_id}")
        _follow(client)


@app.command()
def abort(
    operator: OperatorOption,
    reason: Annotated[str, typer.Option("--reason", help="Stands in the audit log.")],
    take_over: Annotated[bool, typer.Option("--take-over", help="From the console that commands now.")] = False,
    url: UrlOption = LOCAL,
    token_file: TokenOption = None,
    ca: CertificateOption = None,
) -> None:
    """Abort the run in hand."""
    client = _client(url, token_file, ca)
    with client.commanding(operator, take_over=take_over, reason=reason):
        typer.echo(f"run {client.abort(operator, reason)} is aborted")


def _client(url: str, token_file: Path | None, ca: Path | None) -> ConsoleClient:
    from service.console.client import ConsoleClient

    token = os.environ.get(TOKEN_VARIABLE) if token_file is None else token_file.read_text().strip()
    return ConsoleClient(url, token, ca)


def _follow(client: ConsoleClient) -> None:
    from service.console.view import ConsoleView

    with ConsoleView() as view:
        status = client.follow(view.show)
    view.conclude(status)
    if not status["fit"]:
        raise typer.Exit(1)
