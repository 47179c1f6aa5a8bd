"""How often planted noise parameters lie inside their 95 % interval, over many records and kinds of channel.

A parameter that a record does not show ("not seen") is not counted, as the figures of seen and of inside tell apart.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binom

from benchmarks._noise_records import record
from inertial.noise import identify_noise

TERMS = ("quantisation", "white", "flicker", "random_walk", "ramp")
RECORDS: dict[str, dict[str, float]] = {
    "all five": {"quantisation": 2e-4, "white": 1e-3, "flicker": 2e-3, "random_walk": 7e-4, "ramp": 2e-4},
    "white only": {"white": 1e-3},
    "fine quantisation": {"white": 1e-3, "quantisation": 1e-4, "mean": 0.05},
    "coarse quantisation": {"white": 1e-4, "quantisation": 4e-4, "mean": 0.05},
    "flicker": {"white": 1e-3, "flicker": 1e-3},
    "random walk": {"white": 1e-3, "random_walk": 5e-4},
    "weak random walk and ramp": {"white": 1e-3, "random_walk": 5e-5, "ramp": 2e-5},
    "ramp": {"white": 1e-3, "ramp": 3e-5},
}
INTERVAL_S = 0.01


def trial(name: str, samples: int, seed: int) -> list[tuple[bool, bool]]:
    """Return (seen, inside) of each term on one record."""
    rng = np.random.default_rng([list(RECORDS).index(name), seed])
    fit = identify_noise(record(rng, samples, INTERVAL_S, **RECORDS[name]), INTERVAL_S)
    outcome = []
    for term in TERMS:
        found = getattr(fit, term)
        low, high = found.interval95
        outcome.append((found.seen, low <= RECORDS[name].get(term, 0.0) <= high))
    return outcome


def coverage(name: str, samples: int, runs: int, pool: ProcessPoolExecutor) -> dict[str, Any]:
    """Return by planted term: share seen, share of those inside, and the 99.9 % binomial band of that share."""
    outcomes = np.array(list(pool.map(partial(trial, name, samples), range(runs), chunksize=8)))
    found = {}
    for index, term in enumerate(TERMS):
        seen = outcomes[:, index, 0]
        count = int(seen.sum())
        if term in RECORDS[name] and count > 0:
            low, high = (float(end) / count for end in binom.interval(0.999, count, 0.95))
            inside = float(outcomes[seen, index, 1].mean())
            found[term] = {
                "seen": count / runs,
                "inside": inside,
                "band": [low, high],
                "not_below_band": inside >= low,
            }
        elif term not in RECORDS[name]:
            found[term] = {"seen though absent": count / runs}
    return found


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.noise_coverage", description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--runs", type=int, default=200, help="records of each kind (default 200)")
    parser.add_argument("--samples", type=int, default=100_000, help="samples a record at 100 Hz (default 100000)")
    arguments = parser.parse_args()
    figures: dict[str, Any] = {"runs": arguments.runs, "samples": arguments.samples, "records": {}}
    rows = []
    with ProcessPoolExecutor(max_workers=2) as pool:
        for name in RECORDS:
            found = coverage(name, arguments.samples, arguments.runs, pool)
            figures["records"][name] = found
            for term, share in found.items():
                if "inside" in share:
                    band = f"{share['band'][0]:.3f} to {share['band'][1]:.3f}"
                    rows.append([name, term, f"{share['seen']:.3f}", f"{share['inside']:.3f}", band])
                    print("{:28s}{:14s}seen {}  inside {}  band {}".format(*rows[-1]), flush=True)
            absent = max((s["seen though absent"] for s in found.values() if "seen though absent" in s), default=0.0)
            print(f"{name:28s}most often seen though absent: {absent:.4f}", flush=True)
    figures["table"] = {"header": ["record", "term", "seen", "inside 95 %", "99.9 % band"], "rows": rows}
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
