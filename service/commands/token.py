"""``inertrim token``: make, list, rotate and revoke the tokens that requests carry."""

from __future__ import annotations

import getpass
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.security.roles import Role

if TYPE_CHECKING:
    from service.store import Store, TokenRecord

app = typer.Typer(help="Tokens that requests carry (docs/security.md).", no_args_is_help=True, rich_markup_mode=None)
ConfigOption = Annotated[Path | None, typer.Option("--config", metavar="FILE", help="Settings (TOML) of the service.")]
IdArgument = Annotated[str, typer.Argument(metavar="ID", help="As `inertrim token list` shows it.")]
DaysOption = Annotated[
    float | None, typer.Option("--days", metavar="N", min=0.01, max=3650, help="Valid for so long; else until revoked.")
]


@app.command()
def create(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Whose token it is; stands in the audit log.")],
    role: Annotated[Role, typer.Option("--role", help="viewer: reads; operator: commands; maintainer: adopts models.")],
    days: DaysOption = None,
    config: ConfigOption = None,
) -> None:
    """Make a token and print it, this once: the store keeps only its hash."""
    from service.security.tokens import make_token

    with store_of(config) as store:
        text, record = make_token(name, role, days)
        store.add_token(record)
        store.audit(who_types(), "token create", None, "accepted", f"{record.id} {name} {role}")
    typer.echo(text)


@app.command("list")
def list_tokens(config: ConfigOption = None) -> None:
    """List the tokens: id, role, name, and until when each is valid."""
    with store_of(config) as store:
        for record in store.tokens():
            typer.echo(f"{record.id}  {record.role:<10}  {_until(record):<34}  {record.name}")


@app.command()
def rotate(token_id: IdArgument, days: DaysOption = None, config: ConfigOption = None) -> None:
    """Make a token of the same name and role and revoke the old one, in one step."""
    from service.security.tokens import make_token

    with store_of(config) as store:
        old = _known(store, token_id)
        text, record = make_token(old.name, Role(old.role), days)
        store.add_token(record)
        store.revoke_token(token_id)
        store.audit(who_types(), "token rotate", None, "accepted", f"{token_id} becomes {record.id}")
    typer.echo(text)


@app.command()
def revoke(token_id: IdArgument, config: ConfigOption = None) -> None:
    """End a token; a running service knows within two seconds."""
    with store_of(config) as store:
        _known(store, token_id)
        store.revoke_token(token_id)
        store.audit(who_types(), "token revoke", None, "accepted", token_id)


@contextmanager
def store_of(config: Path | None) -> Iterator[Store]:
    """Give the store that the settings name."""
    from service.config import ConfigError, load_settings
    from service.store import Store, StoreError

    settings = load_settings(config).store
    try:
        store = Store(settings.database, settings.launcher)
    except StoreError as error:
        raise ConfigError(str(error)) from None
    try:
        yield store
    finally:
        store.close()


def who_types() -> str:
    """Return the name that a command line's entry in the audit log bears."""
    return f"{getpass.getuser()} at the command line"


def _known(store: Store, token_id: str) -> TokenRecord:
    from service.errors import RefusedInput
    from service.security.tokens import active

    for record in store.tokens():
        if record.id == token_id and active(record):
            return record
    raise RefusedInput(token_id, "is no valid token's id.", "`inertrim token list` shows them.")


def _until(record: TokenRecord) -> str:
    if record.revoked_utc is not None:
        return f"revoked {record.revoked_utc}"
    return f"until {record.expires_utc}" if record.expires_utc is not None else "until revoked"
