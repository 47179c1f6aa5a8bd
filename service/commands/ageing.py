"""``inertrim ageing``: how blocks drift since their calibration, when they must go back, what shook them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from service.commands.options import JsonOption, check_targets, write_json
from service.errors import RefusedInput

NEEDED = 1


def ageing(
    history: Annotated[
        Path | None,
        typer.Option("--history", metavar="FILE", help="Terms by block and month, CSV or Parquet, instead of a store."),
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", metavar="FILE", help="Settings: whose store, and the limits of terms.")
    ] = None,
    block: Annotated[str | None, typer.Option("--block", metavar="NAME", help="Show this block's curves.")] = None,
    json: JsonOption = None,
) -> None:
    """Forecast when each block leaves its limit, with a 90 % interval, and tell steps from slow drift.

    Exit code 0: no block needs anybody now; 1: one does (outside its limit, or a step at its last check); 2: refused.
    """
    check_targets(json)
    from service.ageing import Limits, ageing_facts
    from service.ageing_history import StoreHistories, history_of_table
    from service.config import ConfigError, load_settings
    from service.store import Store, StoreError

    settings = load_settings(config)
    if history is not None:
        blocks = history_of_table(history)
    else:
        database = settings.store.database
        if isinstance(database, Path) and not database.is_file():
            remedy = "Name one with --config, or a table with --history."
            raise RefusedInput(str(database), "there is no store.", remedy)
        try:
            store = Store(database, settings.store.launcher)
        except StoreError as error:
            raise ConfigError(str(error)) from None
        blocks = StoreHistories(store, settings.store.runs).read()
        store.close()
    if not blocks:
        raise RefusedInput("ageing", "there is no result that is fit.", "Trim a block first, or give --history.")
    facts = ageing_facts(blocks, Limits.of(settings.conditions))
    if block is not None and block not in facts["blocks"]:
        known = ", ".join(list(facts["blocks"])[:20])
        raise RefusedInput("--block", f"{block!r} has no history.", f"There are: {known}.")
    write_json(json, facts)
    if str(json) != "-":
        _show(facts, block)
    raise typer.Exit(NEEDED if any(one["attention"] for one in facts["blocks"].values()) else 0)


def _show(facts: dict[str, Any], chosen: str | None) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    limits = facts["limits"]
    title = f"Leaves ±{limits['accel_term_mg']:g} mg or ±{limits['gyro_term_dph']:g} deg/h (90 % interval)"
    table = Table(title=title, title_justify="left")
    for head in ("block", "checks", "now, months", "from", "median", "to", "first term", "attention"):
        table.add_column(head)
    for name, one in facts["blocks"].items():
        leaves = one["leaves_limit"]
        ends = [_end(leaves, key, facts) for key in ("low", "median", "high")]
        first = next(iter(leaves["first_term"]), "–")
        cells = [
            name,
            str(one["checks"]),
            f"{one['last_months']:.1f}",
            *ends,
            first,
            "; ".join(one["attention"]),
        ]
        table.add_row(*cells)
    console.print(table)
    for name, one in facts["blocks"].items():
        for step in one["steps"]:
            text = f"step of {name} in {step['term']} before its check at {step['before_months']:.1f} months"
            console.print(f"  · {text}, {step['z']:.1f} σ", markup=False, highlight=False)
    if chosen is not None:
        _show_block(console, facts["blocks"][chosen])


def _end(leaves: dict[str, Any], key: str, facts: dict[str, Any]) -> str:
    """Return an end as a day where that is known, else in months since the calibration."""
    months, day = leaves[f"{key}_months"], leaves[f"{key}_date"]
    if months is None:
        return f"beyond {facts['horizon_months']:g} months"
    return day or f"{months:.1f}"


def _show_block(console: Any, one: dict[str, Any]) -> None:
    from rich.table import Table

    from service.ageing import DPH_RADPS, MG_MPS2

    table = Table(title="Last check and forecast (mg, deg/h)", title_justify="left")
    for head in ("term", "last", "in 6 months", "in 12 months", "in 24 months"):
        table.add_column(head, justify="right")
    for name, term in one["terms"].items():
        unit = MG_MPS2 if name.startswith("f") else DPH_RADPS
        forecast = term["forecast"]
        cells = [_pair(term["history"]["value"][-1], term["history"]["sigma"][-1], unit)]
        cells += [_pair(forecast["mean"][month], forecast["sigma"][month], unit) for month in (6, 12, 24)]
        table.add_row(name, *cells)
    console.print(table)


def _pair(value: float, sigma: float, unit: float) -> str:
    return f"{value / unit:+.3f} ± {sigma / unit:.3f}"
