"""``inertrim model``: block models to start from, and their lineage."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.commands.options import write_text
from service.errors import RefusedInput

if TYPE_CHECKING:
    from inertial.documents import BlockModel, EffectEntry

app = typer.Typer(help="Block models.", no_args_is_help=True, rich_markup_mode=None)


class GyroKind(StrEnum):
    """How the gyros work; says which effects are physical."""

    DTG = "dtg"
    LASER = "laser"
    FIBRE = "fibre"
    MEMS = "mems"


@app.callback()
def group() -> None:
    """Make block models and read their lineage."""


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


@app.command()
def show(model: Annotated[Path, typer.Argument(metavar="MODEL", help="A block model.")]) -> None:
    """Print what a model believes: its noise and its effects, with the evidence each came in with."""
    from simulators.model_store import load_model

    believed = load_model(model)
    typer.echo(f"model {believed.sha256()[:12]} of block {believed.block or '(unnamed)'}, {believed.gyro_kind} gyros")
    typer.echo(f"parent {believed.parent[:12] if believed.parent else 'none'}")
    typer.echo(f"noise {'free: to be found in recordings' if believed.noise.free else 'stated'}")
    for entry in believed.effects:
        typer.echo(f"  {_effect_line(entry)}")
    if not believed.effects:
        typer.echo("  no effects")


@app.command()
def diff(
    one: Annotated[Path, typer.Argument(metavar="MODEL", help="A block model.")],
    two: Annotated[Path, typer.Argument(metavar="OTHER", help="Another.")],
) -> None:
    """Print which effects one model has and another has not. Exit code 1: they differ."""
    from simulators.model_store import load_model

    before, after = load_model(one), load_model(two)
    lines = [f"- {_effect_line(entry)}" for entry in before.effects if entry not in after.effects]
    lines += [f"+ {_effect_line(entry)}" for entry in after.effects if entry not in before.effects]
    for name in ("block", "gyro_kind", "calibration", "noise"):
        if getattr(before, name) != getattr(after, name):
            lines.append(f"! {name} differs")
    for line in lines:
        typer.echo(line)
    raise typer.Exit(1 if lines else 0)


@app.command()
def log(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="A block model; its ancestors lie beside it.")],
) -> None:
    """Print a model and its ancestors, youngest first, with what each added."""
    from simulators.model_store import load_model

    folder, following = model.parent, load_model(model)
    known = {other.sha256(): other for other in _models_in(folder)}
    while True:
        parent = known.get(following.parent or "")
        added = [entry for entry in following.effects if parent is None or entry not in parent.effects]
        typer.echo(f"{following.sha256()[:12]}  {following.block or '(unnamed)'}")
        for entry in added:
            typer.echo(f"    + {_effect_line(entry)}")
        if following.parent is not None and parent is None:
            typer.echo(f"{following.parent[:12]}  (not in {folder})")
        if parent is None:
            return
        following = parent


def _models_in(folder: Path) -> list[BlockModel]:
    """Return every model of a folder; other files are passed over."""
    from inertial.documents import DocumentError
    from simulators.model_store import load_model

    models = []
    for path in sorted(folder.glob("*.json")):
        try:
            models.append(load_model(path))
        except DocumentError:
            continue
    return models


def _effect_line(entry: EffectEntry) -> str:
    sizes = ", ".join(
        f"{name} {value.value:.4g}" + (f" ± {value.sigma:.2g}" if value.sigma else "") + f" {value.unit}"
        for name, value in entry.parameters.items()
    )
    nats = entry.evidence.get("evidence_nats")
    return f"{entry.effect} on {entry.channel}: {sizes}" + (f" ({nats:.0f} nats)" if nats else "")
