"""Ageing forecasts and steps on simulated fleets: coverage of the 90 % interval, steps found, false alarms.

Each fleet has 200 blocks of six terms by one planted law (``simulators.fleet``): laws the fitted family holds, laws it
comes near to, slopes with heavy tails, a walk that is pulled back. Forecasts are made from monthly checks and held
against when each block really leaves its limit.

Blocks of one fleet share its population, so what is wrong about that is wrong for all of them: their outcomes hang
together. The band is therefore the plain binomial one of all blocks of a law (99.9 %), which holds only if the
population is well enough known to add nothing, and beside it stands the design effect (variance between fleets over the
binomial variance; 1: blocks are as good as independent), which tells whether it is, and how many fleets lie within the
band of their own intervals.

The part ``known`` makes the same forecasts with the planted law and sizes in place of what is found of them: what the
method itself covers, where nothing is left to be learnt of the population.

    python -m benchmarks.ageing --fleets 5 --json FILE [--laws linear,logarithmic] [--blocks 200] [--parts coverage]
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, poisson

from benchmarks.__main__ import replace_table
from inertial.ageing import DRAWS, PopulationFit, Sizes, TermHistories, best_sizes
from inertial.ageing_fleet import KINDS, TERMS, analyse_fleet, steps_of_a_kind
from inertial.ageing_forecast import HORIZON_MONTHS, PROBABILITY, Leaving, leaving, leaving_months
from inertial.ageing_law import DriftLaw
from inertial.ageing_steps import FALSE_ALARMS_PER_BLOCK_YEAR, Step, predicted_sigma
from simulators.fleet import LAWS, FleetTerm, Shock, TermLaw, simulate_term

BLOCKS = 200
HISTORY_MONTHS = 24
LIMIT = 20.0
"""In units of one check's σ; 1σ of the drift after a year is 10 (x axes: 3)."""
SPREAD = {"x": 3.0, "y": 10.0, "z": 10.0}
CASES: dict[str, dict[str, Any]] = {
    "linear": {"law": "linear"},
    "logarithmic": {"law": "logarithmic"},
    "square_root": {"law": "square_root"},
    "saturating": {"law": "saturating"},
    "growing": {"law": "growing"},
    "common drift": {"law": "logarithmic", "mean": 8.0},
    "heavy tails": {"law": "logarithmic", "tails": 5.0},
    "walk pulled back": {"law": "logarithmic", "walk": 0.4, "relaxation_months": 12.0},
    "stretched": {"law": "stretched"},
}
"""The fitted family holds them all but pure powers (square root, growing), what is stretched, heavy tails and the walk
pulled back. The stretched exponential lies between the laws that the prior of the bend knows by name."""
TRIVIAL = 0.9
"""A forecast that is surer than this of being outside now, or not before the horizon, says no interval."""

STEP_MONTHS, STEP_FROM, STEP_SIGMA, LATER_CHECKS = 60, 36, 3.0, 3
"""Histories with steps: months of checks, the first a step may precede, its size, and within how many checks later than
the first that shows it it must be found."""
STEP_LAW: dict[str, Any] = {"walk": 0.05}
"""Steps are planted where the drift's scatter is mostly from check to check: a walk does not average out."""


def fleet(case: str, seed: int, blocks: int, months: int, horizon: float) -> dict[str, FleetTerm]:
    """Return a fleet's terms by name, the σ of whose checks differ."""
    rng = np.random.default_rng([seed, list(CASES).index(case)])
    laws = {name: TermLaw(spread=SPREAD[name[-1]], **CASES[case]) for name in TERMS}
    return {name: simulate_term(law, blocks, np.arange(1.0, months + 1.0), horizon, rng) for name, law in laws.items()}


def shaken(case: str, seed: int, blocks: int, shocks: dict[str, tuple[Shock, ...]]) -> dict[str, FleetTerm]:
    """Return the same fleet with and without shocks, the σ of whose checks are all the same."""
    rng = np.random.default_rng([seed, list(CASES).index(case), 1])
    laws = {name: TermLaw(**{**CASES[case], **STEP_LAW, "spread": SPREAD[name[-1]]}) for name in TERMS}
    checks = np.arange(1.0, STEP_MONTHS + 1.0)
    return {
        name: simulate_term(law, blocks, checks, STEP_MONTHS, rng, shocks.get(name, ()), "stated")
        for name, law in laws.items()
    }


@dataclass(frozen=True)
class PlantedLaw(DriftLaw):
    """A drift law as it was planted, whether the fitted family holds it or not."""

    name: str = ""

    def growth(self, months: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the drift by months, 1 after a year."""
        return np.asarray(LAWS[self.name](months))


def known(case: str, blocks: int, seed: int) -> dict[str, Any]:
    """Forecast one fleet by the law and sizes that it was made of; return as :func:`coverage`."""
    began = time.process_time()
    terms = fleet(case, seed, blocks, HISTORY_MONTHS, HISTORY_MONTHS + HORIZON_MONTHS)
    paths = []
    for number, (name, term) in enumerate(terms.items()):
        planted = TermLaw(spread=SPREAD[name[-1]], **CASES[case])
        sizes = Sizes(
            PlantedLaw(0.0, 0.0, 0.0, 0.0, name=planted.law),
            *(planted.mean, planted.spread, planted.offset, planted.walk, planted.scatter),
            planted.relaxation_months or math.inf,
        )
        paths.append(leaving_months(term.histories, PopulationFit(sizes, (sizes,) * DRAWS), LIMIT, number))
    first = np.min(paths, axis=0)
    return _judged_intervals([leaving(first[block]) for block in range(blocks)], terms, 0, blocks, began)


def coverage(case: str, blocks: int, seed: int) -> dict[str, Any]:
    """Forecast one fleet; return how many intervals there are, and how many hold the truth."""
    began = time.process_time()
    terms = fleet(case, seed, blocks, HISTORY_MONTHS, HISTORY_MONTHS + HORIZON_MONTHS)
    names = [f"block {number}" for number in range(blocks)]
    histories = {name: (names, term.histories) for name, term in terms.items()}
    found = analyse_fleet(histories, dict.fromkeys(TERMS, LIMIT), FALSE_ALARMS_PER_BLOCK_YEAR)
    alarms = sum(len(block) for term in found.terms.values() for block in term.steps)
    return _judged_intervals([found.leaving[name] for name in names], terms, alarms, blocks, began)


def _judged_intervals(
    forecasts: list[Leaving], terms: dict[str, FleetTerm], alarms: int, blocks: int, began: float
) -> dict[str, Any]:
    truth = np.min([term.leaves_months(LIMIT) for term in terms.values()], axis=0)
    inside, widths = [], []
    for one, when in zip(forecasts, truth, strict=True):
        if max(one.outside_now, one.beyond_horizon) > TRIVIAL:
            continue
        low, high = (math.inf if end is None else end for end in (one.low, one.high))
        inside.append(low <= when <= high)
        widths.append(high - low)
    return {
        "intervals": len(inside),
        "inside": int(sum(inside)),
        "median_width_months": float(np.median(widths)),
        "false_alarms": alarms,
        "block_years": blocks * HISTORY_MONTHS / 12.0,
        "cpu_s": time.process_time() - began,
    }


def steps(case: str, blocks: int, seed: int) -> dict[str, Any]:
    """Plant one step of 3σ in every other block and look how soon it is found, and what else is."""
    began = time.process_time()
    rng = np.random.default_rng([seed, 99])
    plain = shaken(case, seed, blocks, {})
    quiet = _by_kind(plain, best_sizes)
    planted: dict[str, list[Shock]] = {}
    for block in range(0, blocks, 2):
        name = TERMS[int(rng.integers(len(TERMS)))]
        check = int(rng.integers(STEP_FROM, STEP_MONTHS - 12))
        sigma = predicted_sigma(plain[name].histories, quiet[name], block, check)
        planted.setdefault(name, []).append(Shock(block, check, math.copysign(STEP_SIGMA * sigma, rng.normal())))
    shocks = {name: tuple(found) for name, found in planted.items()}
    search = partial(_steps_of_a_kind, allowance=FALSE_ALARMS_PER_BLOCK_YEAR / len(TERMS))
    found = _by_kind(shaken(case, seed, blocks, shocks), search)
    return {**_judged(shocks, found), "block_years": blocks * STEP_MONTHS / 12.0, "cpu_s": time.process_time() - began}


def _by_kind(terms: dict[str, FleetTerm], analyse: Callable[[list[TermHistories]], list[Any]]) -> dict[str, Any]:
    """Return what an analysis of the axes of each kind says of each term."""
    return {
        name: one
        for kind in KINDS
        for name, one in zip(kind, analyse([terms[name].histories for name in kind]), strict=True)
    }


def _steps_of_a_kind(histories: list[TermHistories], allowance: float) -> list[Any]:
    return steps_of_a_kind(histories, allowance)[2]


def _judged(shocks: dict[str, tuple[Shock, ...]], found: dict[str, list[list[Step]]]) -> dict[str, Any]:
    """Return how many steps were found by when, and alarms where there is none."""
    planted = {(name, shock.block): shock for name, those in shocks.items() for shock in those}
    delays, false = [], 0
    every = ((name, block, step) for name in TERMS for block, those in enumerate(found[name]) for step in those)
    for name, block, step in every:
        shock = planted.get((name, block))
        if shock is None or step.found_at < shock.check:
            false += 1
            continue
        planted.pop((name, block))
        delays.append(step.found_at - shock.check)
    return {
        "planted": sum(len(those) for those in shocks.values()),
        "by_third_check": sum(delay < LATER_CHECKS for delay in delays),
        "in_time": sum(delay <= LATER_CHECKS for delay in delays),
        "ever": len(delays),
        "false_alarms": false,
    }


def judged_coverage(fleets: list[dict[str, Any]]) -> dict[str, Any]:
    """Return a law's figures with their bands."""
    count = sum(one["intervals"] for one in fleets)
    inside = sum(one["inside"] for one in fleets)
    low, high = binom.interval(0.999, count, PROBABILITY)
    shares = np.array([one["inside"] / one["intervals"] for one in fleets])
    own_bands = np.array([binom.interval(0.999, one["intervals"], PROBABILITY) for one in fleets])
    hits = np.array([one["inside"] for one in fleets])
    plain = PROBABILITY * (1.0 - PROBABILITY) * np.mean([1.0 / one["intervals"] for one in fleets])
    return {
        "intervals": count,
        "coverage": inside / count,
        "band": [low / count, high / count],
        "within_band": bool(low <= inside <= high),
        "by_fleet": shares.tolist(),
        "fleets_within_band": int(np.sum((own_bands[:, 0] <= hits) & (hits <= own_bands[:, 1]))),
        "design_effect": float(np.mean((shares - PROBABILITY) ** 2) / plain),
        "median_width_months": float(np.median([one["median_width_months"] for one in fleets])),
        **_alarms(fleets),
    }


def judged_steps(fleets: list[dict[str, Any]]) -> dict[str, Any]:
    """Return how soon steps are found, over all fleets of a law."""
    sums = {key: sum(one[key] for one in fleets) for key in ("planted", "by_third_check", "in_time", "ever")}
    shares = {f"share_{key}": sums[key] / sums["planted"] for key in ("by_third_check", "in_time", "ever")}
    return {**sums, **shares, **_alarms(fleets)}


def _alarms(fleets: list[dict[str, Any]]) -> dict[str, Any]:
    years, alarms = (sum(one[key] for one in fleets) for key in ("block_years", "false_alarms"))
    return {
        "block_years": years,
        "false_alarms": alarms,
        "false_alarms_per_block_year": alarms / years,
        "alarms_allowed_99_9": int(poisson.ppf(0.999, FALSE_ALARMS_PER_BLOCK_YEAR * years)),
        "cpu_s": sum(one["cpu_s"] for one in fleets),
    }


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ageing", description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--page", type=Path, help="rewrite the table between <!-- bench:ageing --> in this page")
    parser.add_argument("--fleets", type=int, default=5, help="of each law (default 5)")
    parser.add_argument("--blocks", type=int, default=BLOCKS, help="of each fleet (default 200)")
    parser.add_argument("--laws", default=",".join(CASES), help="some of them, by name")
    parser.add_argument("--parts", default="coverage,steps", help="coverage, steps, known or some")
    parser.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    seeds = range(arguments.seed, arguments.seed + arguments.fleets)
    kinds: dict[str, tuple[Callable[..., Any], Callable[..., Any]]] = {
        "coverage": (coverage, judged_coverage),
        "steps": (steps, judged_steps),
        "known": (known, judged_coverage),
    }
    figures: dict[str, Any] = {"fleets": arguments.fleets, "blocks": arguments.blocks}
    with ProcessPoolExecutor(arguments.workers) as pool:
        for part in arguments.parts.split(","):
            run, judge = kinds[part]
            for case in arguments.laws.split(","):
                found = judge(list(pool.map(partial(run, case, arguments.blocks), seeds)))
                figures.setdefault(part, {})[case] = found
                print(part, case, json.dumps(found), flush=True)
                if arguments.json:
                    arguments.json.write_text(json.dumps(figures | {"table": table(figures)}, indent=2) + "\n")
    if arguments.page:
        arguments.page.write_text(replace_table(arguments.page.read_text(), "ageing", table(figures)))


def table(figures: dict[str, Any]) -> dict[str, Any]:
    """Return the rows for documents."""
    header = ["law", "intervals", "90 % covers", "99.9 % band", "fleets within theirs", "design effect"]
    header += ["steps by third check", "by three later", "ever", "false alarms a block-year"]
    rows = []
    for case in CASES:
        cover, step = (figures.get(part, {}).get(case) for part in ("coverage", "steps"))
        cells = ["–"] * 8
        if cover:
            cells[:2] = [str(cover["intervals"]), f"{cover['coverage']:.3f}"]
            cells[2] = "{:.3f} to {:.3f}".format(*cover["band"])
            cells[3] = f"{cover['fleets_within_band']} of {len(cover['by_fleet'])}"
            cells[4] = f"{cover['design_effect']:.1f}"
        if step:
            cells[5:] = [f"{step[f'share_{key}']:.3f}" for key in ("by_third_check", "in_time", "ever")]
        alarms = [one for one in (cover, step) if one]
        if alarms:
            rate = sum(one["false_alarms"] for one in alarms) / sum(one["block_years"] for one in alarms)
            rows.append([case, *cells, f"{rate:.4f}"])
    return {"header": header, "rows": rows}


if __name__ == "__main__":
    main()
