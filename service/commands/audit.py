"""``inertrim audit``: whether the audit log is what was written."""

from __future__ import annotations

from typing import Annotated

import typer

from service.commands.options import JsonOption, write_json
from service.commands.token import ConfigOption, store_of

app = typer.Typer(help="The audit log (docs/security.md).", no_args_is_help=True, rich_markup_mode=None)
NotedOption = Annotated[
    list[str] | None,
    typer.Option("--noted", metavar="NUMBER:SHA256", help="An entry's hash as noted elsewhere; repeatable."),
]


@app.command()
def verify(noted: NotedOption = None, config: ConfigOption = None, json: JsonOption = None) -> None:
    """Check that no entry was edited, deleted or cut off; exit code 1 when one was."""
    from dataclasses import asdict

    witnesses = dict(_pair(one) for one in noted or [])
    with store_of(config) as store:
        found = store.verify_audit(witnesses)
    write_json(json, asdict(found))
    for fault in found.faults:
        typer.echo(f"✕ {fault}")
    if found.faults:
        raise typer.Exit(1)
    head = f"{found.head.entries}:{found.head.sha256}"
    typer.echo(f"✓ {found.head.entries} entries, {found.witnessed} of them vouched for outside the store; head {head}")


def _pair(text: str) -> tuple[int, str]:
    from service.errors import RefusedInput

    number, _, digest = text.partition(":")
    if not number.isdigit() or len(digest) != 64:
        raise RefusedInput(
            "--noted", f"{text!r} is not NUMBER:SHA256.", "Give it as `inertrim audit verify` prints it."
        )
    return int(number), digest
