"""Which positions and turns of a two-axis table show all coefficients of (1), (2), and how well.

Candidates are rests at every combination of inner and outer angles on a grid, and full revolutions about either axis in
either sense there. A greedy choice takes again and again the one that tells most for its time: most bits on all
coefficients together ("D", the determinant of the information) or most off the sum of their variances in units of the
σ aimed at ("A"); Atkinson, Donev & Tobias, *Optimum Experimental Designs*, chapters 10 to 12. The choice is then put
in an order with little slewing, and the σ of every coefficient predicted from the whole of it, slews and table errors
included.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from inertial.attitude import rotation_matrix
from inertial.calibration import (
    DTG_MOUNTING,
    CalibrationPrior,
    Mounting,
    TableRun,
    coefficient_names,
    equations_of,
    filtered,
    prior_sigma_of,
    unseen_combinations,
)
from inertial.documents import Combination, Noise
from inertial.increments import Increments
from inertial.turntable import Span, TableSetup, TableTurn, truth_of

Array = NDArray[np.float64]
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Table:
    """What the table can do: its axes at zero, its grid of angles, rates [rad/s] and 1σ of an angle turned [rad].

    ``inner_axis`` in body axes, ``outer_axis`` in tangent axes; ``rate_radps`` for the revolutions that calibrate,
    ``slew_radps`` between positions; ``settle_s`` is lost beside every turn.
    """

    inner_axis: Vector = (0.0, 0.0, 1.0)
    outer_axis: Vector = (1.0, 0.0, 0.0)
    step_rad: float = math.radians(45.0)
    rate_radps: float = math.radians(30.0)
    slew_radps: float = math.radians(30.0)
    angle_sigma_rad: float = math.radians(2.0 / 3600.0)
    settle_s: float = 1.0


@dataclass(frozen=True)
class Step:
    """One thing to do: stand at a position of the table [rad], or go once round from there."""

    inner_rad: float
    outer_rad: float
    kind: Literal["rest", "inner revolution", "outer revolution"]
    sense: int = 1


@dataclass(frozen=True)
class TablePlan:
    """Steps in the order to be done, the table's turns with their times, and the σ that will come out.

    ``sigma`` (n,) by ``order``; ``conditioning`` (n,): what is left of the prior's σ, one where the plan shows nothing.
    """

    steps: tuple[Step, ...]
    setup: TableSetup
    duration_s: float
    order: tuple[str, ...]
    sigma: Array
    conditioning: Array
    unobservable: tuple[Combination, ...]


def plan_table_run(
    setup: TableSetup,
    noise: Noise,
    mounting: Mounting = DTG_MOUNTING,
    *,
    table: Table | None = None,
    steps: int = 40,
    rest_s: float = 30.0,
    criterion: Literal["D", "A"] = "D",
    target: CalibrationPrior | None = None,
    prior: CalibrationPrior | None = None,
) -> TablePlan:
    """Propose positions and rates.

    Parameters
    ----------
    setup
        Site, attitude at zero of both axes and reference σ; its turns are replaced.
    noise
        Of the block.
    steps, rest_s
        How many things to do, and how long each rest lasts [s].
    target
        σ aimed at by kind of coefficient, the unit of criterion "A".

    Raises
    ------
    ValueError
        Fewer than two steps, or a rest that settling leaves nothing of.
    """
    table = table or Table()
    if steps < 2 or rest_s <= 3.0 * table.settle_s:
        raise ValueError(f"{steps} steps with rests of {rest_s:g} s plan nothing; give 2 or more and longer rests")
    names = coefficient_names(mounting)
    prior_sigma = prior_sigma_of(names, prior or CalibrationPrior())
    weight = prior_sigma_of(names, target or CalibrationPrior()) / prior_sigma
    candidates = list(_candidates(table))
    rows = [_whitened_rows(step, setup, table, noise, names, prior_sigma, rest_s) for step in candidates]
    cost = np.array([_duration_s(step, table, rest_s) for step in candidates])
    chosen = [candidates[k] for k in _greedy(rows, cost, weight, steps, criterion)]
    chosen.sort(key=lambda step: (step.outer_rad, step.inner_rad, step.kind, step.sense))
    turns, end_s = _turns(chosen, table, rest_s)
    planned = replace(setup, turns=turns)
    sigma, unobservable = predict(planned, end_s, noise, mounting, prior=prior, settle_s=table.settle_s)
    return TablePlan(tuple(chosen), planned, end_s, names, sigma, sigma / prior_sigma, unobservable)


def predict(
    setup: TableSetup,
    end_s: float,
    noise: Noise,
    mounting: Mounting = DTG_MOUNTING,
    *,
    prior: CalibrationPrior | None = None,
    settle_s: float = 1.0,
) -> tuple[Array, tuple[Combination, ...]]:
    """Return 1σ (n,) of each coefficient that a run would give, and what it would not show."""
    names = coefficient_names(mounting)
    prior_sigma = prior_sigma_of(names, prior or CalibrationPrior())
    spans = _ideal_spans(setup, end_s, settle_s)
    run = TableRun(Increments(0.0, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)), setup)
    _, table_sigma = setup.nuisances()
    equations = equations_of([spans], [run], [np.zeros(len(table_sigma))], names, noise)
    _, covariance = filtered(equations, np.concatenate([prior_sigma, table_sigma]))
    own = covariance[: len(names), : len(names)]
    return np.sqrt(np.diag(own)), unseen_combinations(names, own, prior_sigma)


def _candidates(table: Table) -> Iterator[Step]:
    count = max(1, round(math.tau / table.step_rad))
    angles = [math.remainder(k * math.tau / count, math.tau) for k in range(count)]
    for outer in angles:
        for inner in angles:
            yield Step(inner, outer, "rest")
            for sense in (1, -1):
                yield Step(inner, outer, "inner revolution", sense)
                yield Step(inner, outer, "outer revolution", sense)


def _duration_s(step: Step, table: Table, rest_s: float) -> float:
    if step.kind == "rest":
        return rest_s
    return math.tau / table.rate_radps + 2.0 * table.settle_s


def _revolution(step: Step, start_s: float, table: Table) -> TableTurn:
    inner = step.kind == "inner revolution"
    return TableTurn(
        start_s,
        start_s + math.tau / table.rate_radps,
        step.sense * table.rate_radps,
        table.inner_axis if inner else table.outer_axis,
        "body" if inner else "tangent",
        table.angle_sigma_rad,
    )


def _whitened_rows(
    step: Step, setup: TableSetup, table: Table, noise: Noise, names: Sequence[str], prior_sigma: Array, rest_s: float
) -> Array:
    """Return the rows (m, n) of one candidate by itself, in units of noise and prior, table errors as noise."""
    C_tb = (
        rotation_matrix(step.outer_rad * np.asarray(table.outer_axis))
        @ setup.C_tb
        @ rotation_matrix(step.inner_rad * np.asarray(table.inner_axis))
    )
    rests = step.kind == "rest"
    alone = replace(setup, C_tb=C_tb, turns=() if rests else (_revolution(step, table.settle_s, table),))
    end_s = _duration_s(step, table, rest_s)
    spans = [s for s in _ideal_spans(alone, end_s, table.settle_s, shortest_s=0.1) if (s.turn is None) == rests]
    run = TableRun(Increments(0.0, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)), alone)
    _, table_sigma = alone.nuisances()
    table_sigma = np.where(np.arange(len(table_sigma)) < 2, np.hypot(table_sigma, table.angle_sigma_rad), table_sigma)
    equations = equations_of([spans], [run], [np.zeros(len(table_sigma))], names, noise)
    nuisance = equations.H[:, len(names) :] * table_sigma
    covariance = np.diag(equations.sigma**2) + nuisance @ nuisance.T
    return np.asarray(np.linalg.solve(np.linalg.cholesky(covariance), equations.H[:, : len(names)] * prior_sigma))


def _greedy(rows: list[Array], cost: Array, weight: Array, steps: int, criterion: Literal["D", "A"]) -> list[int]:
    """Return the candidates that tell most a second, one after another; one may be taken more than once."""
    covariance = np.eye(rows[0].shape[1])
    chosen = []
    for _ in range(steps):
        gains = np.empty(len(rows))
        for k, H in enumerate(rows):
            seen = H @ covariance
            innovation = np.eye(len(H)) + seen @ H.T
            if criterion == "D":
                gains[k] = np.linalg.slogdet(innovation)[1]
            else:
                gains[k] = np.sum(np.linalg.solve(np.linalg.cholesky(innovation), seen / weight) ** 2)
        best = int(np.argmax(gains / cost))
        chosen.append(best)
        seen = rows[best] @ covariance
        covariance -= seen.T @ np.linalg.solve(np.eye(len(rows[best])) + seen @ rows[best].T, seen)
        covariance = 0.5 * (covariance + covariance.T)
    return chosen


def _turns(steps: Sequence[Step], table: Table, rest_s: float) -> tuple[tuple[TableTurn, ...], float]:
    """Return the slews and revolutions with their times, a rest after each."""
    turns: list[TableTurn] = []
    now, inner, outer = rest_s, 0.0, 0.0

    def turn(angle: float, rate: float, axis: Vector, frame: Literal["body", "tangent"]) -> None:
        nonlocal now
        end = now + abs(angle) / rate
        turns.append(TableTurn(now, end, math.copysign(rate, angle), axis, frame, table.angle_sigma_rad))
        now = end + 2.0 * table.settle_s

    for step in steps:
        if abs(angle := math.remainder(step.outer_rad - outer, math.tau)) > 1e-9:
            turn(angle, table.slew_radps, table.outer_axis, "tangent")
        if abs(angle := math.remainder(step.inner_rad - inner, math.tau)) > 1e-9:
            turn(angle, table.slew_radps, table.inner_axis, "body")
        inner, outer = step.inner_rad, step.outer_rad
        if step.kind == "rest":
            now += rest_s
        else:
            again = _revolution(step, now, table)
            turns.append(again)
            now = again.end_s + 2.0 * table.settle_s
    return tuple(turns), now + rest_s


def _ideal_spans(setup: TableSetup, end_s: float, settle_s: float, shortest_s: float = 3.0) -> list[Span]:
    """Return the spans of a run by an ideal block: its mean readings are the truth."""
    spans = []
    edges = [0.0, *(t for turn in setup.turns for t in (turn.start_s, turn.end_s)), end_s]
    zero = np.zeros(3)
    for j, (start, end) in enumerate(zip(edges[0::2], edges[1::2], strict=True)):
        begin, stop = start + settle_s * (j > 0), end - settle_s * (j < len(setup.turns))
        if stop - begin >= shortest_s:
            spans.append(Span(begin, stop - begin, None, j, zero, zero, zero, zero))
        if j < len(setup.turns):
            turn = setup.turns[j]
            length = turn.end_s - turn.start_s
            # Coarse in time is enough: only the Earth's share depends on it.
            progress = np.concatenate([[0.0], (np.arange(72) + 0.5) / 72.0 * turn.angle_rad, [turn.angle_rad]])
            interval = np.concatenate([[settle_s], np.full(72, length / 72.0), [settle_s]])
            spans.append(
                Span(turn.start_s - settle_s, length + 2.0 * settle_s, j, j, zero, zero, zero, zero, progress, interval)
            )
    truths = truth_of(spans, setup, np.zeros(3 + len(setup.turns)))
    return [
        replace(
            span,
            accel_positive=np.maximum(truth.A, 0.0),
            accel_negative=np.minimum(truth.A, 0.0),
            gyro_positive=np.maximum(truth.G, 0.0),
            gyro_negative=np.minimum(truth.G, 0.0),
        )
        for span, truth in zip(spans, truths, strict=True)
    ]
