"""``inertrim replay``: a capture through the decoder that a live line uses, or onto a line for ``serve`` to read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.commands.options import (
    BitRateOption,
    JsonOption,
    OptionOption,
    ProtocolOption,
    SpeedOption,
    check_targets,
    protocol_of,
    write_json,
)
from service.errors import RefusedInput


def replay(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Capture of ours, bare bytes of a line, or hexadecimal text.")
    ],
    protocol: ProtocolOption = "native",
    option: OptionOption = None,
    bit_rate: BitRateOption = 921_600,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="Write the samples: NAME.parquet (or NAME), NAME.csv, NAME.mcap."),
    ] = None,
    pty: Annotated[
        Path | None, typer.Option("--pty", metavar="PATH", help="Play it on a pty linked to PATH, as it once came.")
    ] = None,
    speed: SpeedOption = 1.0,
    json: JsonOption = None,
) -> None:
    """Decode what a line said and tell what was in it and what was lost; or play it for `inertrim serve --link PATH`.

    Where the block restarted, the recording holds the longest stretch between two restarts. Exit code 1: no sample.
    """
    if pty is not None and (out is not None or json is not None):
        raise RefusedInput("replay", "--pty plays, --out and --json decode.", "Do one after the other.")
    check_targets(out, pty, json)
    spoken = protocol_of(protocol, option)
    if pty is not None:
        from service.playback import play

        count = play(file, spoken, pty, speed=speed, bit_rate=bit_rate)
        typer.echo(f"{file}: {count} bytes played")
        return
    from rich.console import Console
    from rich.table import Table

    from service.replay import read_replay, write_replay

    found = read_replay(file, spoken, bit_rate=bit_rate, keep=out is not None)
    if out is not None:
        write_replay(found, out)
    facts = found.facts()
    write_json(json, facts)
    if str(json) != "-":
        table = Table("", "", show_header=False)
        for name, value in facts.items():
            table.add_row(name, str(value))
        Console().print(table)
    raise typer.Exit(0 if facts["samples"] else 1)
