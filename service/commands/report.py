"""``inertrim report``: the page of a run, from its result alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.commands.options import read_document, write_text


def report(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="result.json of a run.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="HTML file to write ('-': standard output).")],
) -> None:
    """Make the HTML report of a run again; the same result gives the same bytes."""
    from inertial.documents import Result
    from service.report import render

    write_text(out, render(read_document(Result, result)))
