"""What the command line shows of results: rich tables for people; files carry the full facts."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table

from inertial.documents import Result
from service.report import SENSORS, STAGE_NAMES, face_sigma, face_terms


def terms_table(result: Result, planted: list[float] | None = None) -> Table:
    """Return the terms by stage in mg and deg/h, with 1σ and, where the truth is known, what is left."""
    table = Table(title="Terms added to the readings (accelerometers mg, gyros deg/h)", title_justify="left")
    table.add_column("sensor")
    stages = [stage for stage in STAGE_NAMES if stage in result.terms]
    heads = [STAGE_NAMES[stage] for stage in stages] + ["1σ"]
    if planted is not None:
        heads = ["planted", *heads, "left"]
    for head in heads:
        table.add_column(head, justify="right")
    columns = [face_terms(result, stage) for stage in stages]
    sigma = face_sigma(result)
    for index, sensor in enumerate(SENSORS):
        spread = sigma[index]
        cells = [f"{column[index]:+.4f}" for column in columns] + ["unbounded" if spread is None else f"{spread:.4f}"]
        if planted is not None:
            cells = [f"{planted[index]:+.4f}", *cells, f"{columns[-1][index] - planted[index]:+.4f}"]
        table.add_row(sensor, *cells)
    return table


def show_result(result: Result) -> None:
    """Print the terms, the verdict and its reasons."""
    console = Console()
    console.print(terms_table(result))
    colour = "green" if result.fit else "red"
    console.print(f"[bold {colour}]{result.verdict}[/] · method {result.method} · state {result.state}")
    for reason in result.reasons:
        console.print(f"  · {reason}", markup=False, highlight=False)
    for unseen in result.unobservable:
        console.print(f"  · not seen: {unseen.text}", markup=False, highlight=False)


def show_navigation(facts: dict[str, Any]) -> None:
    """Print the navigation error at some times along the recording."""
    table = Table(title="Navigation error", title_justify="left")
    for head in ("time, s", "x, m", "y, m", "z, m", "radial, m"):
        table.add_column(head, justify="right")
    count = len(facts["time_s"])
    for index in sorted({round(step * (count - 1) / 6) for step in range(7)}):
        position = facts["position_m"][index]
        cells = [*position, facts["radial_m"][index]]
        table.add_row(f"{facts['time_s'][index]:.2f}", *(f"{value:.3f}" for value in cells))
    Console().print(table)
