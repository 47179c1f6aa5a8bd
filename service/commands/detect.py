"""``inertrim detect``: what is on a line."""

from __future__ import annotations

from typing import Annotated

import typer

from service.commands.options import JsonOption, write_json


def detect(
    port: Annotated[str, typer.Argument(metavar="PORT", help="/dev/ttyUSB0, socket://host:port …")],
    protocol: Annotated[
        list[str] | None, typer.Option("--protocol", metavar="P", help="Try this one only; may be repeated.")
    ] = None,
    bit_rate: Annotated[
        list[int] | None, typer.Option("--bit-rate", metavar="B", help="Try this one only; may be repeated.")
    ] = None,
    listen: Annotated[
        float, typer.Option("--listen", metavar="S", min=0.05, max=60.0, help="How long to listen at each bit rate.")
    ] = 1.5,
    json: JsonOption = None,
) -> None:
    """Try bit rates and protocols on a line, and say what is there and how sure that is.

    Nothing is sent. Exit code 1: nothing known was heard.
    """
    from dataclasses import asdict

    from drivers.detect import detect as listen_to
    from drivers.link import LinkError

    try:
        found = listen_to(port, protocols=protocol, bit_rates=bit_rate, listen_s=listen)
    except OSError as error:
        raise LinkError(str(error)) from None
    write_json(json, [asdict(one) for one in found])
    if str(json) != "-":
        for one in found:
            typer.echo(f"{one.protocol} at {one.bit_rate} bit/s, {one.confidence:.1%} sure: {one.evidence}")
        if not found:
            typer.echo(f"{port}: nothing known was heard")
    raise typer.Exit(0 if found else 1)
