"""How late each turn of a schedule began and ended, found before all else where it is much.

By the reference's own errors alone, each within its σ, before any name: what a named effect does besides does not begin
and end with the turns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from simulators.discrepancy.candidates import Library, Schedule
from simulators.discrepancy.compare import Lateness, Scene
from simulators.discrepancy.evidence import Evidence, Fit

_MUCH_S = 1e-3  # below which a shift adds what it adds in proportion
_MOST_S = 8e-3


def as_late(scenes: Sequence[Scene]) -> list[Scene]:
    """Return the scenes with how late each turn's start and end were, where some were late by much.

    Once with all shifts taken for small, and once by chords to what was found.
    """
    scenes = list(scenes)
    if not any(scene.turns() for scene in scenes):
        return scenes
    late = _late(scenes)
    if late:
        scenes = _with(scenes, late)
        scenes = _with(scenes, _late(scenes))
    return scenes


def _late(scenes: list[Scene]) -> dict[int, Lateness]:
    """Return the lateness of the recordings in which some is much."""
    evidence = Evidence(Library(scenes, only=(), plain=True))
    fit = evidence.fit([])
    if evidence.restate(fit.rss) | evidence.stand(fit):
        fit = evidence.fit([])
    late = {index: _found(schedule, fit) for index, schedule in evidence.library.schedules.items()}
    return {index: shifts for index, shifts in late.items() if np.max(np.abs(shifts)) > _MUCH_S}


def _with(scenes: list[Scene], late: Mapping[int, Lateness]) -> list[Scene]:
    return [replace(one, lateness_s=late[i]) if i in late else one for i, one in enumerate(scenes)]


def _found(schedule: Schedule, fit: Fit) -> Lateness:
    amplitude = dict(zip(fit.ids, fit.amplitude.tolist(), strict=True))
    whole = amplitude.get(schedule.offset, 0.0) if schedule.offset is not None else 0.0
    return tuple(
        (
            float(np.clip(whole + sum(amplitude.get(i, 0.0) for i in start), -_MOST_S, _MOST_S)),
            float(np.clip(whole + sum(amplitude.get(i, 0.0) for i in end), -_MOST_S, _MOST_S)),
        )
        for start, end in zip(schedule.starts, schedule.ends, strict=True)
    )
