"""Arguments and options that several commands share."""

from __future__ import annotations

import json
import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.errors import RefusedInput

if TYPE_CHECKING:
    from drivers.protocols.base import Protocol

RecordingArgument = Annotated[
    Path, typer.Argument(metavar="RECORDING", help="NAME, NAME.parquet or NAME.csv, with NAME.toml beside it.")
]
JsonOption = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the same facts as JSON ('-': standard output).")
]
StartOption = Annotated[
    float | None, typer.Option("--start", metavar="S", help="Use the recording from this device time [s] on.")
]
EndOption = Annotated[float | None, typer.Option("--end", metavar="S", help="Use the recording up to this time [s].")]
SpeedOption = Annotated[
    float, typer.Option("--speed", metavar="X", min=0.01, max=1000.0, help="Simulated seconds per real second.")
]
EpochOption = Annotated[
    float | None,
    typer.Option(
        "--epoch", metavar="S", help="Clock value (CLOCK_MONOTONIC) at simulated time 0, shared by processes."
    ),
]


class AlignmentKind(StrEnum):
    """How the attitude that nobody gives is found."""

    REST = "rest"
    INERTIAL = "inertial"


AlignmentOption = Annotated[
    AlignmentKind | None,
    typer.Option(
        "--alignment",
        help="rest: by averages; inertial: while the launcher sways. Else as recorded; for `align`, as its data ask.",
    ),
]
OptionOption = Annotated[
    list[str] | None,
    typer.Option("--option", metavar="NAME=VALUE", help="Option of the protocol, e.g. accel_range_g=30; repeatable."),
]
BitRateOption = Annotated[int, typer.Option("--bit-rate", metavar="B", min=300, help="Of the line [bit/s].")]
ProtocolOption = Annotated[str, typer.Option("--protocol", metavar="P", help="Frame layout, by name.")]


def protocol_of(name: str, options: list[str] | None) -> Protocol:
    """Return a protocol set up with its options, given as ``name=value``."""
    from drivers.protocols import get_protocol

    pairs: dict[str, object] = {}
    for option in options or []:
        key, sign, value = option.partition("=")
        if not (key and sign and value):
            raise RefusedInput("--option", f"{option!r} is not NAME=VALUE.", "Write for example accel_range_g=30.")
        if key in pairs:
            raise RefusedInput("--option", f"{key} is given twice.", "Give it once.")
        pairs[key] = value
    return get_protocol(name, **pairs)


def check_targets(*paths: Path | None) -> None:
    """Refuse files that could not be written, before the work that makes them."""
    for path in paths:
        if path is None or str(path) == "-":
            continue
        if path.is_dir():
            raise RefusedInput(str(path), "is a folder.", "Name a file.")
        if not path.parent.is_dir():
            raise RefusedInput(str(path), f"the folder {path.parent} does not exist.", "Make it, or name another.")


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all; '-' is standard output."""
    if str(path) == "-":
        typer.echo(text, nl=False)
        return
    check_targets(path)
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def write_json(path: Path | None, facts: Any) -> None:
    """Write ``facts`` as JSON when a path was asked for."""
    if path is not None:
        write_text(path, json.dumps(facts, indent=2, allow_nan=False) + "\n")


def check_span(start_s: float | None, end_s: float | None) -> None:
    """Refuse a span that is not one."""
    for name, value in (("--start", start_s), ("--end", end_s)):
        if value is not None and not math.isfinite(value):
            raise RefusedInput(name, f"{value} is not a time.", "Give seconds of device time.")
    if start_s is not None and end_s is not None and end_s <= start_s:
        raise RefusedInput("--end", f"{end_s} s is not after --start {start_s} s.", "Give a later end.")


def read_document(kind: Any, path: Path | None) -> Any:
    """Read a document of one kind from a file, or return None where no file is named."""
    if path is None:
        return None
    from inertial.documents import parse_document

    return parse_document(kind, path.read_bytes(), str(path))
