"""``inertrim discrepancy``: what the model does not say of a block, by name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.commands.options import JsonOption, check_targets, write_json
from service.errors import RefusedInput

if TYPE_CHECKING:
    from simulators.discrepancy.report import Report

FOUND_ALL = 0
UNNAMED = 1


def discrepancy(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING...", help="NAME, NAME.parquet or NAME.csv, each with its TOML.")
    ],
    model: Annotated[Path, typer.Option("--model", metavar="FILE", help="What the simulator believes of the block.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Write report.html, report.json and the new model here."),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Find where recordings and a block's model disagree, name the effect, add it, show the gap shrink.

    Exit code 0: nothing is left without a name; 1: something is (verdict unknown); 2: the input was refused.
    """
    check_targets(json)
    if out is not None and out.exists() and not out.is_dir():
        raise RefusedInput(
            str(out), "is not a folder.", "Name a folder for the report; it is made where it is missing."
        )
    from simulators.discrepancy.compare import read_to_compare
    from simulators.discrepancy.report import discrepancy as run
    from simulators.model_store import load_model

    believed = load_model(model)
    read = [read_to_compare(path) for path in recordings]
    with _Bar() as tell:
        report = run(read, believed, out, tell)
    write_json(json, report.document)
    if str(json) != "-":
        _show(report, out)
    raise typer.Exit(UNNAMED if report.verdict == "unknown" else FOUND_ALL)


class _Bar:
    """A progress bar on standard error while it works."""

    def __enter__(self) -> _Bar:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        columns = (
            BarColumn(),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("{task.description}"),
        )
        console = Console(stderr=True)
        self._progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._task = self._progress.add_task("reading", total=1.0)
        self._progress.start()
        return self

    def __call__(self, share: float, text: str) -> None:
        self._progress.update(self._task, completed=share, description=text)

    def __exit__(self, *error: object) -> None:
        self._progress.stop()


def _show(report: Report, out: Path | None) -> None:
    from rich.console import Console
    from rich.table import Table

    from simulators.discrepancy.words import alternatives

    console = Console()
    console.print(f"[bold]{report.verdict}[/bold]. {report.document['text']}", highlight=False)
    if report.findings:
        table = Table("effect", "channel", "size", "evidence, nats", "or")
        for finding in report.findings:
            sizes = ", ".join(
                f"{name} {p['value']:.4g}" + (f" ± {p['sigma']:.2g}" if p["sigma"] else "") + f" {p['unit']}"
                for name, p in finding["parameters"].items()
            )
            others = ", ".join(alternatives(finding))
            table.add_row(finding["effect"], finding["channel"], sizes, f"{finding['evidence_nats']:.1f}", others)
        console.print(table)
    if out is not None:
        console.print(f"Report: {out / 'report.html'}", highlight=False)
