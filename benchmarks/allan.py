"""Overlapping Allan deviation against allantools in the same run: time, agreement, memory."""

from __future__ import annotations

import argparse
import json
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import allantools  # type: ignore[import-untyped]
import numpy as np

from inertial.allan import averaging_factors, overlapping_allan

INTERVAL_S = 0.01


def fastest(call: Callable[[], Any], repeats: int) -> float:
    """Return the least of the repeated durations [s]."""
    durations = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        durations.append(time.perf_counter() - start)
    return min(durations)


def peak_bytes(call: Callable[[], Any]) -> int:
    """Return the most memory a call holds at once beyond what it was given."""
    tracemalloc.start()
    call()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.allan", description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--samples", type=int, default=10_000_000)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    rng = np.random.default_rng(1)
    rate = 9.8 + 1e-2 * rng.standard_normal(arguments.samples)
    # 107 in even logarithmic steps leave 100 when rounded to whole factors on 10⁷ samples
    factors = averaging_factors(rate.size, 107)
    taus = factors * INTERVAL_S

    def ours() -> Any:
        return overlapping_allan(rate, INTERVAL_S, factors)

    def peer() -> Any:
        return allantools.oadev(rate, rate=1.0 / INTERVAL_S, data_type="freq", taus=taus)

    overlapping_allan(rate[:1000], INTERVAL_S)  # compiled before the clock starts
    ours_s, peer_s = fastest(ours, arguments.repeats), fastest(peer, arguments.repeats)
    _, deviation, _, _ = peer()
    difference = float(np.max(np.abs(ours().deviation / deviation - 1.0)))
    ours_bytes, peer_bytes = peak_bytes(ours), peak_bytes(peer)
    figures = {
        "samples": rate.size,
        "averaging_times": int(factors.size),
        "ours_s": ours_s,
        "allantools_s": peer_s,
        "ratio": peer_s / ours_s,
        "largest_relative_difference": difference,
        "ours_peak_bytes_per_sample": ours_bytes / rate.size,
        "allantools_peak_bytes_per_sample": peer_bytes / rate.size,
        "table": {
            "header": ["overlapping Allan", "s", "× faster", "bytes a sample beyond the record", "differs by"],
            "rows": [
                ["inertrim", f"{ours_s:.2f}", f"{peer_s / ours_s:.1f}", f"{ours_bytes / rate.size:.1f}", ""],
                ["allantools", f"{peer_s:.2f}", "1", f"{peer_bytes / rate.size:.1f}", f"{difference:.0e}"],
            ],
        },
    }
    for key, value in figures.items():
        if key != "table":
            print(f"{key}: {value:.4g}")
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
