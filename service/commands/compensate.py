"""``inertrim compensate``: the terms from a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.commands.options import (
    AlignmentOption,
    EndOption,
    JsonOption,
    RecordingArgument,
    StartOption,
    check_span,
    check_targets,
    read_document,
    write_json,
    write_text,
)


def compensate(
    recording: RecordingArgument,
    method: Annotated[
        str, typer.Option("--method", metavar="M", help="optimal: all pooled; paper: three chained stages.")
    ] = "optimal",
    alignment: AlignmentOption = None,
    start: StartOption = None,
    end: EndOption = None,
    model: Annotated[
        Path | None, typer.Option("--model", metavar="FILE", help="Block model: its noise, and its calibration.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="Write result.json here.")] = None,
    report: Annotated[Path | None, typer.Option("--report", metavar="FILE", help="Write the HTML report here.")] = None,
    json: JsonOption = None,
) -> None:
    """Estimate what gravity and Earth rate say the calibration has lost, and prove it on fresh data.

    Exit code 0: fit; 1: not fit; 2: the input was refused.
    """
    check_span(start, end)
    check_targets(out, report, json)
    from drivers.recording import read_recording
    from inertial.documents import BlockModel
    from service.compensate import compensate as run
    from service.report import render
    from service.tables import show_result

    result = run(
        read_recording(recording),
        method=method,
        alignment=None if alignment is None else alignment.value,
        start_s=start,
        end_s=end,
        model=read_document(BlockModel, model),
    )
    if out is not None:
        write_text(out, result.canonical_json())
    if report is not None:
        write_text(report, render(result))
    write_json(json, result.model_dump(mode="json", by_alias=True))
    if str(json) != "-":
        show_result(result)
    raise typer.Exit(0 if result.fit else 1)
