"""Registers that stood still from one step that the search found to another that undoes it.

What the input did meanwhile is known too badly, in a turn about axes that are not the stated ones, to tell that a
reading stood still before the reference's errors were fitted.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from inertial.documents import CHANNELS
from simulators.discrepancy.adopt import Search
from simulators.discrepancy.candidates import Kind
from simulators.discrepancy.compare import Scene
from simulators.discrepancy.parameters import parameters_of
from simulators.discrepancy.runs import runs
from simulators.discrepancy.standing import Stuck, longest_by_custom, stuck_from

_UNDONE_SIGMAS = 3.0  # that two steps which undo each other may differ by
_COVERED = 0.8  # of the time between them, in which the reading is the same


def stood_between_steps(search: Search) -> list[tuple[int, Stuck]]:
    """Return the registers that stood still between two steps, each with its recording's place among those searched."""
    evidence, everything = search.evidence, [a.hypothesis for a in search.adopted]
    steps = [a.hypothesis for a in search.of_kind(Kind.NAMED) if a.hypothesis.effect == "bias_step"]
    values = [(h.channel, parameters_of(evidence, h, everything, search.fit)) for h in steps]
    found = []
    for channel in dict.fromkeys(h.channel for h in steps):
        own = sorted((v for name, v in values if name == channel), key=lambda v: v["time"].value)
        for up, down in itertools.pairwise(own):
            sigma = math.hypot(up["step"].sigma or 0.0, down["step"].sigma or 0.0)
            if abs(up["step"].value + down["step"].value) > _UNDONE_SIGMAS * sigma:
                continue
            for place, scene in enumerate(evidence.library.scenes):
                stuck = _stood(scene, channel, up["time"].value, down["time"].value)
                found += [] if stuck is None else [(place, stuck)]
    return found


def _stood(scene: Scene, channel: str, start_s: float, end_s: float) -> Stuck | None:
    """Return the run of equal readings that covers a span [s, device clock], if longer than they are by custom."""
    column, edges_s = CHANNELS.index(channel), scene.data.edges_s
    came = np.flatnonzero(~scene.data.missing[:, column])
    same = np.diff(scene.data.sent[came, column]) == 0.0
    first, last = runs(same)
    if not first.size:
        return None
    begun, over = edges_s[came[first] + 1], edges_s[came[last] + 1]
    covered = np.minimum(over, end_s) - np.maximum(begun, start_s)
    best = int(np.argmax(covered))
    lengths = last - first
    if covered[best] < _COVERED * (end_s - start_s) or lengths[best] < longest_by_custom(lengths, same.size):
        return None
    return stuck_from(scene, channel, int(came[first[best] + 1]), int(came[last[best]]))
