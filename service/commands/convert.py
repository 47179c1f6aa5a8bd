"""``inertrim convert``: what a line once said, as a recording or a log that other tools open."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from service.commands.options import (
    BitRateOption,
    OptionOption,
    ProtocolOption,
    check_targets,
    protocol_of,
)
from service.errors import RefusedInput

SUFFIXES = (".parquet", ".csv", ".mcap")


def convert(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Capture of ours, bare bytes of a line, or hexadecimal text.")
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="NAME.parquet or NAME.csv (with NAME.toml), or NAME.mcap.")
    ],
    protocol: ProtocolOption = "native",
    option: OptionOption = None,
    bit_rate: BitRateOption = 921_600,
) -> None:
    """Convert what a line said to Parquet, CSV or MCAP; the same file always gives the same bytes.

    Where the block restarted, the longest stretch between two restarts is written.
    """
    from service.replay import read_replay, write_replay

    check_targets(out)
    if out.suffix not in SUFFIXES:
        raise RefusedInput(str(out), "its name does not say what to write.", f"End it in {', '.join(SUFFIXES)}.")
    found = read_replay(file, protocol_of(protocol, option), bit_rate=bit_rate)
    facts = found.facts()
    path = write_replay(found, out)
    typer.echo(f"{path}: {_sum_up(facts, found.longest.count if found.longest else 0)}")


def _sum_up(facts: dict[str, Any], written: int) -> str:
    """Say in a line what was written and what was not."""
    text = f"{written} samples, {facts['messages']} messages"
    for name, words in (
        ("frames_lost", "frames missing"),
        ("bytes_discarded", "bytes discarded"),
        ("crc_failures", "checksums wrong"),
    ):
        text += f", {facts[name]} {words}" if facts[name] else ""
    text += "".join(f", {name}" for name in facts["conditions"])
    if facts["stretches"] != 1:
        text += f"; the longest of {facts['stretches']} stretches between restarts"
    return text
