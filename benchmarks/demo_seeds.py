"""The demo's figures over many seeds, without the line: what the terms are worth at rest and after a turn.

Every seed is one block with its own shifts, reference errors and noise. It is trimmed from 280 s at rest, then
navigated for 300 s at rest and 300 s with a turn of 90°, with and without its terms, on recordings with other noise:
the demo's own code.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from service.compensate import compensate
from service.trials import distances, record, trials, worth
from simulators.scenarios import demo_model, demo_scenario

RUN_S = 280.0
OBSERVABLE = (2, 3, 4, 5)
"""Vertical accelerometer and gyros: the terms that must lie within 3σ of the planted ones."""


def one_seed(seed: int) -> dict[str, Any]:
    """Return one block's figures."""
    scenario, model = demo_scenario(seed), demo_model(seed)
    with tempfile.TemporaryDirectory() as folder:
        run = scenario.warmed_up().with_motion([], RUN_S)
        result = compensate(record(run, model, Path(folder) / "run"))
        facts = worth(trials(scenario, model, Path(folder)), result)
    return {"seed": seed, "verdict": result.verdict, "distances": distances(scenario, model, result), **facts}


def summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return medians over the runs and the largest distance of a term from the planted one."""
    far = np.array([run["distances"] for run in runs])
    median = {trial: statistics.median(run["improvement"][trial] for run in runs) for trial in ("rest", "turn")}
    radial = {
        trial: {
            terms: statistics.median(run["radial_error_m"][trial][terms] for run in runs)
            for terms in ("without", "with")
        }
        for trial in ("rest", "turn")
    }
    return {
        "runs": len(runs),
        "median_improvement": median,
        "median_radial_error_m": radial,
        "largest_distance_sigma": {
            "gyros and vertical accelerometer": float(far[:, OBSERVABLE].max()),
            "all": float(far.max()),
        },
        "fit": sum(run["verdict"] != "not fit" for run in runs),
    }


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.demo_seeds", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="how many, the demo's default among them (default: 20)")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    runs = [one_seed(seed) for seed in range(1, arguments.seeds + 1)]
    figures = summary(runs)
    rows = [
        [
            f"300 s {trial}",
            f"{figures['median_radial_error_m'][trial]['without']:.0f} m",
            f"{figures['median_radial_error_m'][trial]['with']:.1f} m",
            f"{figures['median_improvement'][trial]:.1f}",
        ]
        for trial in ("rest", "turn")
    ]
    header = [f"median of {len(runs)} blocks", "without terms", "with terms", "factor"]
    print(json.dumps(figures, indent=2))
    if arguments.json:
        document = {**figures, "seeds": runs, "table": {"header": header, "rows": rows}}
        arguments.json.write_text(json.dumps(document, indent=2) + "\n")


if __name__ == "__main__":
    main()
