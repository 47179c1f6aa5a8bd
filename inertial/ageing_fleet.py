"""All six terms of a fleet together: population, steps and when each block leaves its limit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from inertial.ageing import Array, PopulationFit, Sizes, TermHistories, best_sizes, fit_population, with_steps
from inertial.ageing_forecast import Leaving, leaving, leaving_months
from inertial.ageing_steps import Step, find_steps

KINDS = (("f_x", "f_y", "f_z"), ("g_x", "g_y", "g_z"))
"""Terms whose drift has one mechanism."""
TERMS = (*KINDS[0], *KINDS[1])
ROUNDS = 3
"""Fits and searches after one another, at most: a step that is known no longer passes for scatter."""


@dataclass(frozen=True)
class TermAgeing:
    """One term: ``blocks`` that have it, in the order of ``histories`` (steps marked), the fit, each block's steps."""

    blocks: tuple[str, ...]
    histories: TermHistories
    fit: PopulationFit
    steps: tuple[tuple[Step, ...], ...]


@dataclass(frozen=True)
class FleetAgeing:
    """Every term by name, and by block how it leaves its limit: as a whole, and the chance of each term to be first."""

    terms: Mapping[str, TermAgeing]
    leaving: Mapping[str, Leaving]
    first: Mapping[str, Mapping[str, float]]


def analyse_fleet(
    histories: Mapping[str, tuple[Sequence[str], TermHistories]],
    limits: Mapping[str, float],
    false_alarms_per_block_year: float,
) -> FleetAgeing:
    """Analyse a fleet.

    Parameters
    ----------
    histories
        By term (of ``TERMS``): the blocks' names and their histories, in one order.
    limits
        By term, SI: a block beyond ±limit in any of them has left its limit.
    false_alarms_per_block_year
        Steps that may be found, all terms together, in a year of a block that has none.
    """
    allowance = false_alarms_per_block_year / len(TERMS)
    terms: dict[str, TermAgeing] = {}
    for kind in KINDS:
        names = [name for name in kind if name in histories]
        if names:
            found = _of_a_kind([histories[name][1] for name in names], allowance)
            terms |= {name: TermAgeing(tuple(histories[name][0]), *one) for name, one in zip(names, found, strict=True)}
    samples = {
        name: dict(
            zip(term.blocks, leaving_months(term.histories, term.fit, limits[name], TERMS.index(name)), strict=True)
        )
        for name, term in terms.items()
    }
    blocks = sorted({block for term in terms.values() for block in term.blocks})
    by_block = {block: {name: found[block] for name, found in samples.items() if block in found} for block in blocks}
    return FleetAgeing(
        terms,
        {block: leaving(np.min(list(found.values()), axis=0)) for block, found in by_block.items()},
        {block: _first(found) for block, found in by_block.items()},
    )


def steps_of_a_kind(
    histories: Sequence[TermHistories], allowance: float
) -> tuple[list[TermHistories], list[Sizes], list[list[list[Step]]]]:
    """Fit and search the axes of a kind in turn until the steps stay as they are.

    Parameters
    ----------
    histories
        Of each axis.
    allowance
        False alarms a year that one term of one block may raise.

    Returns
    -------
    For each axis its histories with the steps marked, its sizes, and every block's steps.
    """
    marked = list(histories)
    best: list[Sizes] = []
    for _ in range(ROUNDS):
        best = best_sizes(marked, best or None)
        steps = [find_steps(term, sizes, allowance) for term, sizes in zip(histories, best, strict=True)]
        before = [term.stepped for term in marked]
        marked = [with_steps(term, _rows(term, found)) for term, found in zip(histories, steps, strict=True)]
        if all(np.array_equal(old, term.stepped) for old, term in zip(before, marked, strict=True)):
            break
    return marked, best, steps


def _of_a_kind(
    histories: Sequence[TermHistories], allowance: float
) -> list[tuple[TermHistories, PopulationFit, tuple[tuple[Step, ...], ...]]]:
    marked, best, steps = steps_of_a_kind(histories, allowance)
    return [
        (term, fit, tuple(tuple(block) for block in found))
        for term, fit, found in zip(marked, fit_population(marked, best), steps, strict=True)
    ]


def _rows(histories: TermHistories, steps: Sequence[Sequence[Step]]) -> list[int]:
    return [int(histories.offsets[block]) + step.check for block, found in enumerate(steps) for step in found]


def _first(samples: Mapping[str, Array]) -> dict[str, float]:
    """Return for each term the share of paths in which it is the first to leave."""
    stacked = np.array(list(samples.values()))
    first = np.where(np.isinf(stacked.min(axis=0)), -1, stacked.argmin(axis=0))
    return {name: float(np.mean(first == number)) for number, name in enumerate(samples)}
