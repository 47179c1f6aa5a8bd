"""Time tags that are far off, undone before anything subtle: all readings late, or stamped by a clock that runs wrong.

Every turn begins and ends late then, all by as much or in proportion to the time. What is left of that looks like
anything: steps, limits, registers that stand still. So the stamps are put right first, and the schedule as late as the
readings. What the schedule itself may be off by is told in the search, beside what each turn was late by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.stats import siegelslopes

from drivers.recording import Recording
from simulators.discrepancy.candidates import TIMING_SIGMA_S
from simulators.discrepancy.compare import Scene, true_rates

Array = NDArray[np.float64]

_LONGEST_S, _APART_S = 0.5, 0.02  # of latenesses that are looked for, and between two at first
_ABOUT_S = 0.6  # an end of a turn
_MUCH = 5.0  # σ of a schedule that is kept, by which an end of a turn must be late
_LEAST = 60.0  # by how much χ² must fall, of each triad, and rise beside the lateness of an end
_FEWEST_ENDS, _MOST_ENDS = 4, 60  # of turns that are looked at
_AGREE, _ASTRAY_S = 0.8, 5e-3  # share of them that are no further off the line
_TRIADS_S = 5e-3  # by which what accelerometers and gyros say may differ
_FINE_S = 2e-3  # parts of samples within which readings are foretold
_SHARPEST_S = 1e-4  # to which a lateness is known at best
_LEAST_NOISE = 1e-12  # of a reading [SI]: one that was simulated may have none
_CHARGED = 6.0  # nats of a delay, or of a clock's error
_ROUNDS = 2  # of what a sample's edges leave over
_TRIADS = slice(0, 3), slice(3, 6)
_LINES = (False, False), (True, False), (False, True), (True, True)  # delay, clock's error


@dataclass(frozen=True)
class TimeTags:
    """Readings are ``delay_s`` older than stamped, and the clock runs ``clock_error`` of itself fast.

    Each with its 1σ, and both 0 where there is none; χ² falls by ``explained`` about the ends of turns. ``told_by`` the
    triads that feel them: of turns about the vertical, gyros alone.
    """

    delay_s: float
    delay_sigma_s: float
    clock_error: float
    clock_sigma: float
    explained: float
    told_by: tuple[str, ...]

    def undone(self, recording: Recording) -> Recording:
        """Return a recording with true stamps, and a schedule as late as its readings."""
        late = [
            motion.model_copy(update={"start_s": motion.start_s + self.delay_s, "end_s": motion.end_s + self.delay_s})
            for motion in recording.meta.motion
        ]
        samples = recording.samples.copy()
        samples["time"] /= 1.0 + self.clock_error
        return replace(recording, samples=samples, meta=recording.meta.model_copy(update={"motion": late}))


def find_time_tags(
    scenes: Sequence[Scene], again: Callable[[TimeTags], list[Scene]]
) -> tuple[TimeTags, list[Scene]] | None:
    """Find a delay of all readings, a clock that runs wrong, or both, where an end of a turn is late by much.

    By the line in time on which the lateness of most ends lies (repeated medians, Siegel 1982), and what of it a
    schedule that is kept would hardly be off by.

    Parameters
    ----------
    scenes
        Of the recordings as they are stamped.
    again
        Compares the recordings once more, with time tags undone.

    Returns
    -------
    What is wrong, and the scenes without it; None: nothing, or no more than the schedule may be off by.
    """
    found = _found(scenes)
    if found is None:
        return None
    fitted = np.array([found.delay_sigma_s > 0.0, found.clock_sigma > 0.0])
    for _ in range(_ROUNDS):
        known = _LateEnds.of([one for scene in again(found) for one in _ends(scene)])
        if known is None:
            break
        delay_s, error = _line(known, fitted).late
        found = replace(found, delay_s=found.delay_s + delay_s, clock_error=found.clock_error + error)
    return found, again(found)


def _found(scenes: Sequence[Scene]) -> TimeTags | None:
    ends = [one for scene in scenes for one in _ends(scene)]
    known = _LateEnds.of(ends)
    if known is None:
        return None
    line = max((_line(known, np.array(fitted)) for fitted in _LINES), key=lambda line: line.nats)
    late_s = np.array([line.late[0] + line.late[1] * end.end_s for end in ends])
    if np.max(np.abs(late_s)) < _MUCH * TIMING_SIGMA_S:
        return None

    def left(more_s: float) -> Array:
        return np.asarray(np.sum([end.left(late + more_s) for end, late in zip(ends, late_s, strict=True)], axis=0))

    gained = np.sum([end.left(0.0) for end in ends], axis=0) - left(0.0)
    told = np.sum([end.told(late) for end, late in zip(ends, late_s, strict=True)], axis=0)
    said = [triad for triad in range(2) if told[triad] > 2.0 * _LEAST]
    each_s = [_least(partial(_of_triad, left, triad), 0.0) for triad in said]
    if not said or np.min(gained[said]) < _LEAST or np.ptp(each_s) > _TRIADS_S:
        return None
    (delay_s, error), (delay_sigma_s, sigma) = line.late.tolist(), line.sigma.tolist()
    told_by = tuple(("accel", "gyro")[triad] for triad in said)
    return TimeTags(delay_s, delay_sigma_s, error, sigma, float(gained.sum()), told_by)


def _of_triad(left: Callable[[float], Array], triad: int, more_s: float) -> float:
    return float(left(more_s)[triad])


@dataclass(frozen=True)
class _LateEnds:
    """Ends of turns at ``at_s`` that were late by ``late_s`` (n,), but those off the line, and their scatter."""

    at_s: Array
    late_s: Array
    sharp_s: float

    @classmethod
    def of(cls, ends: Sequence[_End]) -> _LateEnds | None:
        """Return that of most ends; none where too few tell, or too many lie off a line in time."""
        known = [(end.end_s, late_s) for end in ends if (late_s := end.lateness()) is not None]
        if len(known) < _FEWEST_ENDS:
            return None
        at_s, late_s = np.array(known).T
        slope, height = siegelslopes(late_s, at_s)
        off_s = late_s - height - slope * at_s
        kept = np.abs(off_s) < _ASTRAY_S
        if np.mean(kept) < _AGREE:
            return None
        sharp_s = float(np.clip(np.sqrt(np.mean(np.square(off_s[kept]))), _SHARPEST_S, TIMING_SIGMA_S))
        return cls(at_s[kept], late_s[kept], sharp_s)


@dataclass(frozen=True)
class _Line:
    """Lateness by time: ``late`` [s] and [1], with ``sigma`` (0: not fitted), and how likely it is [nats]."""

    late: Array
    sigma: Array
    nats: float


def _line(known: _LateEnds, fitted: NDArray[np.bool_]) -> _Line:
    """Return lateness as a delay, a clock's error or both, as ``fitted`` says; what is not is 0.

    Beside it the schedule as a whole may be late by what it may be, where no delay takes that in.
    """
    used = np.array([*fitted, not fitted[0]])
    ones = np.ones_like(known.at_s)
    design = np.column_stack([ones, known.at_s, ones])[:, used] / known.sharp_s
    precision = design.T @ design + np.diag(np.array([0.0, 0.0, TIMING_SIGMA_S**-2.0])[used])
    size, sigma = np.zeros(3), np.zeros(3)
    size[used] = np.linalg.solve(precision, design.T @ known.late_s / known.sharp_s)
    sigma[used] = np.sqrt(np.diag(np.linalg.inv(precision)))
    off = known.late_s / known.sharp_s - design @ size[used]
    nats = -0.5 * float(off @ off) - 0.5 * float(size[2] / TIMING_SIGMA_S) ** 2 - _CHARGED * int(fitted.sum())
    if fitted[0]:
        sigma[0] = np.hypot(sigma[0], TIMING_SIGMA_S)  # by which the schedule may be late instead
    return _Line(size[:2], np.where(fitted, sigma[:2], 0.0), nats)


@dataclass(frozen=True)
class _End:
    """Readings (m, 6) about an end of a turn at ``end_s``, over their noise, and the integral of what is predicted.

    ``edges_s`` (m + 1,) are those of the readings, ``came`` (m,) those that were not lost; ``integral`` (k, 6) stands
    at ``at_s`` (k,), and reaches farther.
    """

    end_s: float
    edges_s: Array
    readings: Array
    came: NDArray[np.bool_]
    at_s: Array
    integral: Array

    def left(self, late_s: float) -> Array:
        """Return χ² that is left, of accelerometers and gyros, where the readings are so late."""
        return self._squares(self.readings - self._predicted(late_s))

    def told(self, late_s: float) -> Array:
        """Return χ² by which the prediction changes, of accelerometers and gyros, if the readings are so late."""
        return self._squares(self._predicted(late_s) - self._predicted(0.0))

    def _predicted(self, late_s: float) -> Array:
        when = self.edges_s - late_s
        sums = np.column_stack([np.interp(when, self.at_s, column) for column in self.integral.T])
        return np.asarray(np.diff(sums, axis=0) / np.diff(self.edges_s)[:, None])

    def _squares(self, off: Array) -> Array:
        """Return the squares of what came (m, 6), but its mean, by triad: a bias, or gravity by a wrong clock."""
        if not self.came.any():
            return np.zeros(len(_TRIADS))
        off = off[self.came] - off[self.came].mean(axis=0)
        return np.array([np.square(off[:, triad]).sum() for triad in _TRIADS])

    def lateness(self) -> float | None:
        """Return by how much [s] this end is late; none where the readings do not tell to some milliseconds."""
        tried = np.arange(-_LONGEST_S, _LONGEST_S + 0.5 * _APART_S, _APART_S)
        near_s = tried[np.argmin([self.left(float(late_s)).sum() for late_s in tried])]
        late_s = _least(lambda at_s: float(self.left(at_s).sum()), float(near_s))
        least = self.left(late_s).sum()
        beside = min(self.left(late_s - _ASTRAY_S).sum(), self.left(late_s + _ASTRAY_S).sum())
        return late_s if beside - least > _LEAST else None


def _ends(scene: Scene) -> list[_End]:
    """Return what lies about the ends of a recording's turns, of some of them where there are many."""
    edges, came = scene.data.edges_s, ~np.any(scene.data.missing, axis=1)
    sums = np.concatenate([np.zeros((1, 6)), np.cumsum(scene.predicted * np.diff(edges)[:, None], axis=0)])
    sigma = np.maximum(scene.noise_sigma, _LEAST_NOISE)
    all_s = sorted({end_s for _, turn in scene.turns() for end_s in (turn.start_s, turn.end_s)})
    found = []
    for end_s in all_s[:: -(-len(all_s) // _MOST_ENDS) or 1]:
        first, last = np.searchsorted(edges, [end_s - _ABOUT_S, end_s + _ABOUT_S])
        low, high = np.searchsorted(edges, [end_s - _ABOUT_S - _LONGEST_S, end_s + _ABOUT_S + _LONGEST_S])
        if low > 0 and high < len(edges):
            rows, reach = slice(first, last), slice(low, high + 1)
            at_s, integral = _within_samples(scene, edges[reach], sums[reach])
            readings = scene.measured[rows] / sigma
            found.append(_End(end_s, edges[first : last + 1], readings, came[rows], at_s, integral / sigma))
    return found


def _within_samples(scene: Scene, edges_s: Array, sums: Array) -> tuple[Array, Array]:
    """Return more times (k,) and what is predicted up to each (k, 6), from that at samples' edges (m,), (m, 6).

    A turn may begin within a sample, where no straight line between its edges knows of it.
    """
    parts = int(np.ceil(float(np.diff(edges_s).max()) / _FINE_S))
    places = np.arange(len(edges_s))
    at_s = np.interp(np.linspace(0.0, len(edges_s) - 1.0, (len(edges_s) - 1) * parts + 1), places, edges_s)
    rates = np.hstack(true_rates(scene.setup, at_s, np.diff(at_s)))
    true = np.concatenate([np.zeros((1, 6)), np.cumsum(rates * np.diff(at_s)[:, None], axis=0)])
    rest = sums - true[::parts]
    return at_s, true + np.column_stack([np.interp(at_s, edges_s, column) for column in rest.T])


def _least(cost: Callable[[float], float], near_s: float) -> float:
    """Return where near a lateness that has been tried χ² is least."""
    bounds = (near_s - _APART_S, near_s + _APART_S)
    return float(minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-5}).x)
