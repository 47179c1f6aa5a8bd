"""``inertrim model``: block models to start from."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from service.commands.options import write_text

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
    """Write a block model to start from."""
    from inertial.documents import BlockModel
    from service.errors import RefusedInput

    if not ideal:
        raise RefusedInput("model new", "say what kind of model.", "--ideal makes the one there is.")
    model = BlockModel(block=out.stem, gyro_kind=gyro_kind.value)
    if noise_from is not None:
        from drivers.recording import read_recording
        from service.compensate import noise_at_rest

        model = model.model_copy(update={"noise": noise_at_rest(read_recording(noise_from))})
    write_text(out, model.canonical_json())
