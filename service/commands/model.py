"""``inertrim model``: block models to start from."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from service.commands.options import write_text
from service.errors import RefusedInput

app = typer.Typer(help="Block models.", no_args_is_help=True, rich_markup_mode=None)


class GyroKind(StrEnum):
    """How the gyros work; says which effects are physical."""

    DTG = "dtg"
    LASER = "laser"
    FIBRE = "fibre"
    MEMS = "mems"


@app.callback()
def group() -> None:
    """Make block models."""


@app.command()
def new(
    ideal: Annotated[bool, typer.Option("--ideal", help="Ideal sensors: readings are the truth.")] = False,
    gyro_kind: Annotated[GyroKind, typer.Option("--gyro-kind", metavar="K", help="dtg, laser, fibre, mems.")] = (
        GyroKind.DTG
    ),
    noise_from: Annotated[
        Path | None,
        typer.Option("--noise-from", metavar="RECORDING", help="Take the noise of this recording at rest."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Model to write ('-': standard output).")] = Path(
        "block.json"
    ),
) -> None:
    """Write a block model to start from; where no noise is given, its size is left free, to be found in recordings."""
    from drivers.recording import read_recording
    from service.compensate import noise_at_rest
    from simulators.model_store import ideal_model

    if not ideal:
        raise RefusedInput("model new", "say what kind of model.", "--ideal makes the one there is.")
    noise = None if noise_from is None else noise_at_rest(read_recording(noise_from))
    write_text(out, ideal_model(gyro_kind.value, noise).canonical_json())
