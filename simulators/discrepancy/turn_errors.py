"""What errors of a schedule's turns would add to the readings: starts and ends that came late, angles.

A start or end that comes late by a part of a sample acts in proportion on the gyro about the turn's axis, but not on an
accelerometer, which reads the attitude: there a shift twice as large adds more than twice as much. So each is taken as
a chord to how late it is known to have been (:mod:`.lateness`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simulators.discrepancy.compare import Scene
from simulators.motion import Turn

Array = NDArray[np.float64]

MOST_TURNS = 16
"""Turns whose own errors are looked for; those of later ones are left to the named effects."""
TIME_S = 1e-4
"""Shifts smaller than that are in proportion."""
ANGLE = 1e-5
ACROSS_S = 5e-3
"""How near a turn's start or end is to a sample's edge that it may lie beyond it."""


@dataclass(frozen=True)
class TurnErrors:
    """What errors of one turn, ``place`` among the motions, would add (n, 6) [y].

    ``starts`` and ``ends``: coming late [per s], the first as known, others for one that has passed a sample's edge;
    ``angle`` [per rad].
    """

    place: int
    turn: Turn
    starts: tuple[Array, ...]
    ends: tuple[Array, ...]
    angle: Array


def turn_errors(scene: Scene) -> list[TurnErrors]:
    """Return what errors of the first turns would add."""
    found = []
    for number, (place, turn) in enumerate(scene.turns()[:MOST_TURNS]):
        late = scene.lateness_s[number] if scene.lateness_s else (TIME_S, TIME_S)
        start_s, end_s = (size if abs(size) > TIME_S else TIME_S for size in late)
        start = changed_by(scene, place, _moved(turn, start_s, 0.0)) / start_s
        end = changed_by(scene, place, _moved(turn, 0.0, end_s)) / end_s
        larger = replace(turn, rate_radps=turn.rate_radps * (1.0 + ANGLE))
        radians = ANGLE * abs(turn.rate_radps * (turn.end_s - turn.start_s))
        found.append(
            TurnErrors(
                place,
                turn,
                (start, *_across(scene, start, turn.start_s, start_s)),
                (end, *_across(scene, end, turn.end_s, end_s)),
                changed_by(scene, place, larger) / radians,
            )
        )
    return found


def all_late(scene: Scene, errors: Sequence[TurnErrors]) -> Array:
    """Return what it would add (n, 6) [y per s] that all of a schedule is late.

    Each start and end by the chord that is its own, so that with what each is late by itself it adds up to what the
    whole shift does.
    """
    if scene.lateness_s and is_whole(scene, errors):
        return np.asarray(sum(one.starts[0] + one.ends[0] for one in errors))
    size = float(np.mean(scene.lateness_s)) if scene.lateness_s else TIME_S
    size = size if abs(size) > TIME_S else TIME_S
    return (scene.predict(scene.setup, scene.data.edges_s - size) - scene.predicted) / size


def is_whole(scene: Scene, errors: Sequence[TurnErrors]) -> bool:
    """Whether the errors are those of all turns, of which none begins as another ends: both would move one instant."""
    ordered = sorted((one.turn for one in errors), key=lambda turn: turn.start_s)
    apart = all(two.start_s - one.end_s > ACROSS_S for one, two in itertools.pairwise(ordered))
    return apart and len(errors) == len(scene.turns())


def changed_by(scene: Scene, place: int, turn: Turn) -> Array:
    """Return what another turn at a place among the motions makes of the prediction, less it (n, 6)."""
    motions = list(scene.setup.motions)
    motions[place] = turn
    for other in (place - 1, place + 1):  # neighbours that touch give way
        beside = motions[other] if 0 <= other < len(motions) else None
        if isinstance(beside, Turn):
            if other < place and beside.end_s > turn.start_s:
                motions[other] = replace(beside, end_s=turn.start_s)
            if other > place and beside.start_s < turn.end_s:
                motions[other] = replace(beside, start_s=turn.end_s)
    return scene.predict(replace(scene.setup, motions=tuple(motions))) - scene.predicted


def _moved(turn: Turn, start_s: float, end_s: float) -> Turn:
    """Return a turn of the same angle that starts and ends so much later."""
    span_s = turn.end_s - turn.start_s
    rate = turn.rate_radps * span_s / (span_s - start_s + end_s)
    return replace(turn, start_s=turn.start_s + start_s, end_s=turn.end_s + end_s, rate_radps=rate)


def _across(scene: Scene, change: Array, at_s: float, shift_s: float) -> list[Array]:
    """Return what a shift of a turn's start or end adds once it has passed the edge of a sample as analysed near by.

    The rate jumps in the sample before or after then, where ``change`` (n, 6), which holds for smaller shifts of the
    sign of ``shift_s``, has it in its own. With both, a shift across the edge is described. Schedules are written in
    whole seconds, so that turns begin and end on edges: the jump is in the sample that they are shifted into.
    """
    group, edges_s = scene.group, scene.data.edges_s[:: scene.group]
    place = int(np.searchsorted(edges_s, at_s + math.copysign(0.5 * TIME_S, shift_s))) - 1
    if not 1 <= place < len(edges_s) - 3:
        return []
    found = []
    for to, edge_s in ((place - 1, edges_s[place]), (place + 1, edges_s[place + 1])):
        if abs(at_s - edge_s) < ACROSS_S:
            here, there, beside = (slice(k * group, (k + 1) * group) for k in (place, to, 2 * place - to))
            moved = change.copy()
            by_side = np.stack([change[there].mean(axis=0), change[beside].mean(axis=0)])
            inside = by_side[np.argmin(np.abs(by_side), axis=0), np.arange(change.shape[1])]
            jump = change[here] - inside
            moved[here] -= jump
            moved[there] += jump
            found.append(moved)
    return found
