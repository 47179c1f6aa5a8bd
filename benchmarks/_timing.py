"""Honest timings inside one run: contenders take turns, each keeps its median and best CPU time."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any


def take_turns(contenders: Mapping[str, Callable[[], Any]], rounds: int = 7) -> dict[str, dict[str, float]]:
    """Return ``{name: {"median_s", "best_s"}}`` of CPU time; every contender runs once unmeasured first."""
    for run in contenders.values():
        run()
    times: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, run in contenders.items():
            start = time.process_time()
            run()
            times[name].append(time.process_time() - start)
    return {name: {"median_s": statistics.median(found), "best_s": min(found)} for name, found in times.items()}


def millions(count: int, seconds: float) -> str:
    """Return a rate in words."""
    return f"{count / seconds / 1e6:.2f} M/s"
