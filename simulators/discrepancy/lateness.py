"""How late each turn of a schedule began and ended, found before all else where it is much.

By the reference's own errors alone, each within its σ, in a library without names: what a named effect does besides
does not begin and end with the turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simulators.discrepancy.candidates import Library, Schedule
from simulators.discrepancy.compare import Scene
from simulators.discrepancy.evidence import Evidence, Fit

_MUCH_S = 1e-3  # below which a shift adds what it adds in proportion
_MOST_S = 8e-3
_ROUNDS = 2  # of shifts as found by chords to shifts as found


def as_late(scenes: Sequence[Scene]) -> list[Scene]:
    """Return the scenes with how late each turn's start and end were, where some were late by much."""
    scenes = list(scenes)
    for _ in range(_ROUNDS):
        library = Library(scenes, only=(), plain=True)
        if not library.schedules:
            break
        evidence = Evidence(library)
        fit = evidence.fit([])
        if evidence.restate(fit.rss) | evidence.stand(fit.noise):
            fit = evidence.fit([])
        late = {index: _found(schedule, fit) for index, schedule in library.schedules.items()}
        much = [index for index, shifts in late.items() if np.max(np.abs(shifts)) > _MUCH_S]
        if not much:
            break
        for index in much:
            scenes[index] = replace(scenes[index], lateness_s=late[index])
    return scenes


def _found(schedule: Schedule, fit: Fit) -> tuple[tuple[float, float], ...]:
    amplitude = dict(zip(fit.ids, fit.amplitude.tolist(), strict=True))
    whole = amplitude.get(schedule.offset, 0.0) if schedule.offset is not None else 0.0
    return tuple(
        (
            float(np.clip(whole + sum(amplitude.get(i, 0.0) for i in start), -_MOST_S, _MOST_S)),
            float(np.clip(whole + sum(amplitude.get(i, 0.0) for i in end), -_MOST_S, _MOST_S)),
        )
        for start, end in zip(schedule.starts, schedule.ends, strict=True)
    )
