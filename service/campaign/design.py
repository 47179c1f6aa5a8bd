"""Which levels a trial has: a function of the study and the trial's number alone."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from service.campaign.factors import FACTORS, Level
from service.campaign.spec import Campaign, Range

HYPERCUBE = 1000
"""Trials that make one Latin hypercube; a longer study is several of them, each from a seed of its own, so that no
worker needs to hold a billion points to know one."""
DESIGN_KEY = 2**32 - 1
"""First of the spawn key of a hypercube's seed: no trial has this number."""


def trial_seed(seed: int, trial: int) -> np.random.SeedSequence:
    """Return the seed of one trial; it depends on nothing but the study's and the trial's number."""
    return np.random.SeedSequence(seed, spawn_key=(trial,))


def levels_of(spec: Campaign, trial: int) -> dict[str, Level]:
    """Return the level of every factor in one trial."""
    levels: dict[str, Level] = {name: factor.default for name, factor in FACTORS.items()}
    listed = spec.levels
    if spec.campaign.study == "grid":
        return levels | _grid_point(listed, trial)
    names = [*spec.ranges, *listed]
    if names:
        cube, row = divmod(trial, HYPERCUBE)
        count = min(HYPERCUBE, spec.trials - cube * HYPERCUBE)
        unit = _hypercube(spec.campaign.seed, cube, len(names), count)[row]
        for name, share in zip(names, unit, strict=True):
            levels[name] = _spread(spec.ranges[name], share) if name in spec.ranges else _listed(listed[name], share)
    return levels


def _grid_point(listed: dict[str, list[Level]], trial: int) -> dict[str, Level]:
    """Return a point of the grid, the factor named last changing fastest."""
    found = {}
    for name, choices in reversed(listed.items()):
        trial, index = divmod(trial, len(choices))
        found[name] = choices[index]
    return found


@lru_cache(maxsize=2)
def _hypercube(seed: int, cube: int, dimensions: int, count: int) -> NDArray[np.float64]:
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(DESIGN_KEY, cube)))
    return np.asarray(qmc.LatinHypercube(dimensions, rng=generator).random(count))


def _spread(span: Range, share: float) -> float:
    if span.scale == "log":
        return float(math.exp(math.log(span.low) + share * math.log(span.high / span.low)))
    return float(span.low + share * (span.high - span.low))


def _listed(choices: list[Level], share: float) -> Level:
    return choices[min(int(share * len(choices)), len(choices) - 1)]
