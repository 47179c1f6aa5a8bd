"""When a vibration really went on, where it began before or ended after the time that is stated.

A clock that runs wrong, or a shaker that is switched on by hand, puts the beginning or the end of the shaking outside
its span. Left there it would pass for jumps of a hundred σ.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simulators.motion import Setup, Vibration

Array = NDArray[np.float64]

_FELT = 6.0  # σ of the samples at rest by which one is shaken
_MOST, _MOST_SIGMA = 0.99, 2.576  # of samples, and within how many σ they lie: half may all read the same step
_PAUSE = 8  # samples between two that are shaken
_SHARE = 0.5  # of samples that are shaken, where it shakes
_LATEST_S = 3.0  # that the shaking may be off; what goes on for longer is something else
_FEWEST = 50  # samples at rest that tell how large their noise is


def spans_as_shaken(setup: Setup, time_s: Array, residual: Array, missing: NDArray[np.bool_]) -> Setup:
    """Return the set-up with the spans of its vibrations widened to where the accelerometers felt them.

    Parameters
    ----------
    setup : as stated.
    time_s : of the samples' ends (n,).
    residual : measured less predicted specific force (n, 3) [m/s²], vibrations left out of the prediction.
    missing : which samples (n,) were never measured; what stands for them says nothing.
    """
    planned = np.zeros(len(time_s), dtype=np.bool_)
    for motion in setup.motions:
        planned |= _during(motion.start_s, motion.end_s, time_s)
    beside = ~(planned | missing)
    if beside.sum() < _FEWEST:
        return setup
    motions = tuple(
        _widened(motion, time_s, residual, beside) if isinstance(motion, Vibration) else motion
        for motion in setup.motions
    )
    return replace(setup, motions=motions)


def _during(start_s: float, end_s: float, time_s: Array) -> NDArray[np.bool_]:
    return np.asarray((time_s > start_s) & (time_s <= end_s))


def _widened(vibration: Vibration, time_s: Array, residual: Array, beside: NDArray[np.bool_]) -> Vibration:
    """Return a vibration that begins and ends where the samples about its span are no longer shaken."""
    axis = np.asarray(vibration.axis) / np.linalg.norm(vibration.axis)
    along = residual @ axis
    rows = np.flatnonzero(_during(vibration.start_s, vibration.end_s, time_s))
    if not rows.size:
        return vibration
    before = np.flatnonzero(beside & (time_s > time_s[rows[0]] - _LATEST_S) & (time_s < time_s[rows[0]]))[::-1]
    after = np.flatnonzero(beside & (time_s < time_s[rows[-1]] + _LATEST_S) & (time_s > time_s[rows[-1]]))
    middle, sigma = _at_rest(along[beside])
    interval_s = float(time_s[1] - time_s[0])
    start_s, end_s = vibration.start_s, vibration.end_s
    if (count := _shaken(np.abs(along[before] - middle) > _FELT * sigma)) > 0:
        start_s = float(time_s[before[count - 1]]) - 1.5 * interval_s  # the sample's begin, and half a sample more
    if (count := _shaken(np.abs(along[after] - middle) > _FELT * sigma)) > 0:
        end_s = float(time_s[after[count - 1]]) + 0.5 * interval_s
    return replace(vibration, start_s=start_s, end_s=end_s)


def _at_rest(values: Array) -> tuple[float, float]:
    middle = float(np.median(values))
    return middle, max(float(np.quantile(np.abs(values - middle), _MOST)) / _MOST_SIGMA, 1e-300)


def _shaken(felt: NDArray[np.bool_]) -> int:
    """Return how many samples next to a span are still shaken: up to a pause, half of them felt; none if it goes on."""
    last, count = -1, 0
    for number, place in enumerate(np.flatnonzero(felt), 1):
        if place - last > _PAUSE:
            break
        last = int(place)
        if number > _SHARE * (last + 1):
            count = last + 1
    return count if last + _PAUSE < len(felt) else 0
