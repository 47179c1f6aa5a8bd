"""How blocks age: history, drift of the fleet, forecasts and steps, as plain facts for CLI, API and dashboard."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from inertial.ageing import Sizes
from inertial.ageing_fleet import TERMS, FleetAgeing, TermAgeing, analyse_fleet
from inertial.ageing_forecast import HORIZON_MONTHS, PROBABILITY, Leaving, bands
from inertial.ageing_steps import FALSE_ALARMS_PER_BLOCK_YEAR
from inertial.earth import STANDARD_GRAVITY_MPS2
from service.ageing_history import UNITS, BlockHistory, term_histories
from service.config import ConditionsSettings

MG_MPS2 = 1e-3 * STANDARD_GRAVITY_MPS2
DPH_RADPS = math.radians(1.0) / 3600.0
OUTSIDE = 0.5
"""Chance of being outside its limit now above which a block is said to be."""


@dataclass(frozen=True)
class Limits:
    """What a term may grow to before the block goes back to the laboratory."""

    accel_term_mg: float
    gyro_term_dph: float

    @classmethod
    def of(cls, settings: ConditionsSettings) -> Limits:
        """Return those by which the service judges a run."""
        return cls(settings.accel_term_mg, settings.gyro_term_dph)

    def si(self) -> dict[str, float]:
        """Return them by term in SI."""
        accel, gyro = self.accel_term_mg * MG_MPS2, self.gyro_term_dph * DPH_RADPS
        return {name: accel if name.startswith("f") else gyro for name in TERMS}


def ageing_facts(
    blocks: list[BlockHistory], limits: Limits, false_alarms: float = FALSE_ALARMS_PER_BLOCK_YEAR
) -> dict[str, Any]:
    """Return how a fleet ages.

    Parameters
    ----------
    blocks
        Histories, as the store or a table gives them.
    limits
        Of the terms.
    false_alarms
        Steps that may be found in a year of a block that has none.

    Returns
    -------
    dict
        ``limits``, ``population`` by term (SI), ``blocks`` by name: ``checks``, ``leaves_limit``, ``steps``,
        ``attention`` (why it needs somebody now, or nothing), ``terms`` with history and forecast band.
    """
    histories = term_histories(blocks)
    found = analyse_fleet(histories, limits.si(), false_alarms)
    curves = {name: _curves(term) for name, term in found.terms.items()}
    return {
        "limits": {**asdict(limits), "by_term": {name: limits.si()[name] for name in histories}},
        "false_alarms_per_block_year": false_alarms,
        "probability": PROBABILITY,
        "horizon_months": HORIZON_MONTHS,
        "population": {name: _population(name, term) for name, term in found.terms.items()},
        "blocks": {block.name: _block(block, found, curves) for block in blocks if block.name in found.leaving},
    }


def _population(name: str, term: TermAgeing) -> dict[str, Any]:
    best, *draws = (_flat(sizes) for sizes in (term.fit.best, *term.fit.draws))
    spread = {key: float(np.std([draw[key] for draw in draws])) for key in best}
    return {"unit": UNITS[name], "blocks": len(term.blocks), **best, "sigma": spread}


def _flat(sizes: Sizes) -> dict[str, float]:
    facts = asdict(sizes)
    return {**facts.pop("law"), **facts}


def _block(block: BlockHistory, found: FleetAgeing, curves: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    months = block.checks[-1].months
    leaves = _leaves(found.leaving[block.name], block, months, found.first[block.name])
    steps = [
        step for name, term in found.terms.items() if block.name in term.blocks for step in _steps(name, term, block)
    ]
    attention = []
    if found.leaving[block.name].outside_now > OUTSIDE:
        attention.append(f"outside its limit now ({leaves['outside_now']:.0%} sure)")
    attention += [f"step in {step['term']} found at its last check" for step in steps if step["found_months"] == months]
    return {
        "checks": len(block.checks),
        "since": block.since,
        "calibrated": block.date(0.0),
        "last_months": months,
        "last_date": block.date(months),
        "attention": attention,
        "leaves_limit": leaves,
        "steps": steps,
        "terms": {name: by_block[block.name] for name, by_block in curves.items() if block.name in by_block},
    }


def _leaves(found: Leaving, block: BlockHistory, months: float, first: Mapping[str, float]) -> dict[str, Any]:
    """Return the forecast in months since calibration and, where that has a date, in days."""
    ends = {"median": found.median, "low": found.low, "high": found.high}
    since = {f"{name}_months": None if end is None else months + end for name, end in ends.items()}
    dates = {f"{name}_date": None if end is None else block.date(months + end) for name, end in ends.items()}
    shares = {"outside_now": found.outside_now, "beyond_horizon": found.beyond_horizon}
    return {**since, **dates, **shares, "first_term": dict(sorted(first.items(), key=lambda one: -one[1]))}


def _steps(name: str, term: TermAgeing, block: BlockHistory) -> list[dict[str, Any]]:
    number = term.blocks.index(block.name)
    months = term.histories.months[term.histories.rows(number)]
    return [
        {
            "term": name,
            "after_months": float(months[step.check - 1]),
            "before_months": float(months[step.check]),
            "found_months": float(months[step.found_at]),
            "after_date": block.date(float(months[step.check - 1])),
            "before_date": block.date(float(months[step.check])),
            "size": step.size,
            "sigma": step.sigma,
            "z": step.z,
            "threshold": step.threshold,
        }
        for step in term.steps[number]
    ]


def _curves(term: TermAgeing) -> dict[str, dict[str, Any]]:
    """Return history and forecast band of one term, by block."""
    columns = {"months": term.histories.months, "value": term.histories.value, "sigma": term.histories.sigma}
    months, mean, sigma = bands(term.histories, term.fit)
    return {
        block: {
            "history": {name: column[term.histories.rows(number)].tolist() for name, column in columns.items()},
            "forecast": {
                "months": months[number].tolist(),
                "mean": mean[number].tolist(),
                "sigma": sigma[number].tolist(),
            },
        }
        for number, block in enumerate(term.blocks)
    }
