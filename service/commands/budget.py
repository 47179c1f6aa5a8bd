"""``inertrim budget``: the navigation error that a result leaves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.commands.options import JsonOption, check_targets, read_document, write_json
from service.errors import RefusedInput


def budget(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="result.json of a run.")],
    profile: Annotated[
        Path | None,
        typer.Option(
            "--profile", metavar="FILE", help="A recording's TOML whose [[motion]] is what the block does; else rest."
        ),
    ] = None,
    at: Annotated[str, typer.Option("--at", metavar="S,S", help="Times since the start of navigation [s].")] = "60,300",
    json: JsonOption = None,
) -> None:
    """Predict the navigation error with the result's terms in, and name its largest contributors."""
    check_targets(json)
    from drivers.recording_meta import read_meta
    from inertial.documents import Result
    from service.budget import predicted
    from service.tables import show_budget

    motion = [] if profile is None else read_meta(profile.with_suffix(".toml")).motion
    facts = predicted(read_document(Result, result), _times(at), motion)
    write_json(json, facts)
    if str(json) != "-":
        show_budget(facts)


def _times(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise RefusedInput("--at", f"{text!r} is no list of times.", "Give seconds, as in 60,300.") from None
