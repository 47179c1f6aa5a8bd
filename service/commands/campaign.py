"""``inertrim campaign``: many trials on many workers."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Annotated

import typer

from service.commands.options import JsonOption, check_targets, write_json, write_text


def campaign(
    spec: Annotated[Path, typer.Argument(metavar="SPEC", help="The study: a TOML file (docs/campaigns.md).")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Parquet file, a row a trial; FILE.md beside it.")],
    trials: Annotated[int | None, typer.Option("--trials", min=1, help="In place of the study's own number.")] = None,
    workers: Annotated[
        int | None, typer.Option("--workers", min=1, help="Processes on this machine. Default: one for each core.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="ADDRESS", help="A dask scheduler, instead of local workers.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Run a Monte Carlo study, or analyse a whole fleet's recordings again; gone on with after a kill.

    Exit code 0: done; 1: a trial cannot be worked out, and what was finished is kept; 2: the input was refused;
    130: stopped by Ctrl-C, which keeps what was finished as well.
    """
    check_targets(json, out)
    from service.campaign import read_campaign, run_campaign
    from service.campaign.report import page, summary

    study = read_campaign(spec, trials)
    try:
        with _Bar() as tell:
            done = run_campaign(study, out, workers=workers, scheduler=scheduler, progress=tell)
    except KeyboardInterrupt:
        typer.echo(f"Stopped: what was finished of {study.trials} trials is kept. Call again to go on.", err=True)
        raise
    facts = summary(study, out)
    text = page(facts, spec.stem)
    write_text(out.with_name(out.name + ".md"), text)
    write_json(json, facts | {"run": asdict(done)})
    if str(json) != "-":
        typer.echo(text, nl=False)


class _Bar:
    """A live progress bar on standard error."""

    def __enter__(self) -> _Bar:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (BarColumn(), MofNCompleteColumn(), TextColumn("trials"), TimeRemainingColumn())
        self._progress = Progress(*columns, console=Console(stderr=True), transient=True)
        self._task = self._progress.add_task("trials", total=None)
        self._progress.start()
        return self

    def __call__(self, done: int, total: int) -> None:
        self._progress.update(self._task, completed=done, total=total)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()
