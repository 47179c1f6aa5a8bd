"""``inertrim replay``: a capture through the decoder that a live line uses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.commands.options import JsonOption, ProtocolOption, write_json


def replay(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Capture, as `inertrim capture` wrote it.")],
    protocol: ProtocolOption = "native",
    out: Annotated[
        Path | None, typer.Option("--out", metavar="NAME", help="Write the samples as a recording, NAME.parquet.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Decode a capture, say what was in it and what was lost, and write its samples as a recording.

    Where the block restarted, the recording holds the longest stretch between two restarts. Exit code 1: no sample.
    """
    from rich.console import Console
    from rich.table import Table

    from service.replay import read_replay, write_replay

    found = read_replay(file, protocol)
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
