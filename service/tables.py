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
    if result.budget is not None:
        for time_s, radial in zip(result.budget["time_s"], result.budget["radial_m"]["95"], strict=True):
            console.print(f"  · predicted: within {_words(radial)} m after {time_s:g} s at rest, 95 %", markup=False)


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


def show_facts(title: str, facts: dict[str, Any]) -> None:
    """Print plain facts as two columns."""
    table = Table(title=title, title_justify="left", show_header=False)
    for name, value in facts.items():
        table.add_row(name.replace("_", " "), _words(value))
    Console().print(table)


def show_budget(facts: dict[str, Any]) -> None:
    """Print the predicted error by time and its contributors."""
    table = Table(title=f"Predicted navigation error ({facts['profile']}), 1σ along tangent axes", title_justify="left")
    for head in ("time, s", "position, m", "velocity, m/s", "attitude, deg", "radial 50 %, m", "95 %, m", "CEP, m"):
        table.add_column(head, justify="right")
    for index, time_s in enumerate(facts["time_s"]):
        triads = [_words(facts[key][index]) for key in ("position_sigma_m", "velocity_sigma_mps", "attitude_sigma_deg")]
        sizes = [facts["radial_m"]["50"][index], facts["radial_m"]["95"][index], facts["cep_m"][index]]
        table.add_row(f"{time_s:g}", *triads, *(_words(size) for size in sizes))
    console = Console()
    console.print(table)
    for time_s, causes in zip(facts["time_s"], facts["contributors"], strict=True):
        shares = ", ".join(f"{cause['cause']} {100 * cause['share']:.0f} %" for cause in causes)
        console.print(f"  · at {time_s:g} s: {shares or 'nothing'}", markup=False, highlight=False)


def show_noise(facts: dict[str, Any]) -> None:
    """Print the identified terms of the six channels."""
    table = Table(title="Noise at rest, value ± 1σ ('not seen': the record cannot show it)", title_justify="left")
    names = list(next(iter(facts["channels"].values()))["terms"])
    for head in ("channel", *(name.replace("_", " ") for name in names)):
        table.add_column(head)
    for channel, found in facts["channels"].items():
        table.add_row(channel, *(_noise_cell(found["terms"][name]) for name in names))
    Console().print(table)


def _noise_cell(term: dict[str, Any]) -> str:
    if not term["seen"]:
        return "not seen"
    return f"{term['value_in_unit']:.3g} ± {term['sigma_in_unit'] or 0.0:.2g} {term['unit']}"


def show_plan(facts: dict[str, Any]) -> None:
    """Print a table run's steps and what it will tell of each coefficient."""
    console = Console()
    steps = Table(title=f"Table run of {facts['duration_s'] / 60:.0f} min", title_justify="left")
    for head in ("inner, deg", "outer, deg", "what", "sense"):
        steps.add_column(head, justify="right")
    for step in facts["steps"]:
        steps.add_row(f"{step['inner_deg']:.0f}", f"{step['outer_deg']:.0f}", step["kind"], f"{step['sense']:+d}")
    told = Table(title="What it will tell (conditioning: share of the prior σ that is left)", title_justify="left")
    for head in ("coefficient", "1σ", "conditioning"):
        told.add_column(head, justify="right" if head != "coefficient" else "left")
    for one in facts["coefficients"]:
        told.add_row(one["name"], f"{one['sigma']:.2g}", f"{one['conditioning']:.2g}")
    console.print(steps)
    console.print(told)
    for unseen in facts["unobservable"]:
        console.print(f"  · not seen: {unseen['text']}", markup=False, highlight=False)


def _words(value: Any) -> str:
    """Return plain data as words: what nothing bounds is unbounded."""
    if value is None:
        return "unbounded"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, dict):
        return ", ".join(f"{name} {_words(one)}" for name, one in value.items())
    if isinstance(value, list):
        return " ".join(_words(one) for one in value)
    return str(value)
