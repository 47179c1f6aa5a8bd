"""``inertrim experiments``: the paper's three tests made again, on a simulated block."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.commands.options import JsonOption, check_targets, write_json


def experiments(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for figures, tables and recordings.")],
    json: JsonOption = None,
) -> None:
    """Make the paper's tests, tables and figures again, by its method and by the optimal one."""
    check_targets(json)
    from service.experiments import run_experiments

    facts = run_experiments(out)
    write_json(json, facts)
    if str(json) != "-":
        typer.echo((out / "tables.md").read_text(), nl=False)
