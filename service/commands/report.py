"""``inertrim report``: the page of a run, from its result alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.commands.options import check_targets, read_document, write_text


def report(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="result.json of a run.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="HTML file to write ('-': standard output).")],
    pdf: Annotated[
        Path | None, typer.Option("--pdf", metavar="FILE", help="Print it as well, through an installed Chromium.")
    ] = None,
) -> None:
    """Make the HTML report of a run again; the same result gives the same bytes."""
    from inertial.documents import Result
    from service.print_page import print_page
    from service.report import render

    check_targets(out, pdf)
    html = render(read_document(Result, result))
    write_text(out, html)
    if pdf is not None:
        print_page(html, pdf)
