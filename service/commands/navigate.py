"""``inertrim navigate``: strapdown navigation along a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.commands.options import (
    EndOption,
    JsonOption,
    RecordingArgument,
    StartOption,
    check_span,
    check_targets,
    read_document,
    write_json,
)


def navigate(
    recording: RecordingArgument,
    result: Annotated[
        Path | None, typer.Option("--result", metavar="FILE", help="result.json whose final terms are applied.")
    ] = None,
    start: StartOption = None,
    end: EndOption = None,
    json: JsonOption = None,
) -> None:
    """Navigate along a recording and show the error: the block turns about itself, so it never leaves the origin."""
    check_span(start, end)
    check_targets(json)
    from drivers.recording import read_recording
    from inertial.documents import Result
    from service.navigate import navigate_recording
    from service.tables import show_navigation

    facts = navigate_recording(
        read_recording(recording), result=read_document(Result, result), start_s=start, end_s=end
    )
    write_json(json, facts)
    if str(json) != "-":
        show_navigation(facts)
