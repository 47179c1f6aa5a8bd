"""Since when a recording's time counts: what dies away or runs off does so from switch-on.

A log may be stamped by another clock than the block's own, in unix time for instance. Seconds since switch-on they
cannot be where they begin below zero, or so late that every transient has died out. Then the first sample is the best
guess of it: a simulated block counts from there, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.recording import Recording
from drivers.samples import intervals_s
from simulators.discrepancy.candidates import TRANSIENT_S

LATEST_S = 10.0 * TRANSIENT_S[-1]
"""When less than a ten-thousandth is left of the longest transient."""
_TICK_S = 1e-6  # of most clocks; a stamp in unix time is rounded to a quarter of it


def since_switch_on(recordings: Sequence[Recording]) -> list[Recording]:
    """Return recordings whose time counts from switch-on: as stamped, or from the first sample of each."""
    return list(recordings) if tell_switch_on(recordings) else [from_first_sample(one) for one in recordings]


def tell_switch_on(recordings: Sequence[Recording]) -> bool:
    """Whether time stamps may be seconds since switch-on: negative in no recording, and early in one at least."""
    return 0.0 <= min(float(recording.samples["time"][0]) for recording in recordings) < LATEST_S


def from_first_sample(recording: Recording) -> Recording:
    """Return a recording, with its motions, whose time is zero where its first sample begins."""
    samples, stamps_s = recording.samples.copy(), recording.samples["time"]
    samples["time"] = _unrounded(stamps_s - stamps_s[0], float(np.spacing(np.abs(stamps_s).max())))
    interval_s = float(intervals_s(samples)[0])
    samples["time"] += interval_s
    start_s = float(stamps_s[0]) - interval_s
    motions = [
        one.model_copy(update={"start_s": one.start_s - start_s, "end_s": one.end_s - start_s})
        for one in recording.meta.motion
    ]
    return replace(recording, samples=samples, meta=recording.meta.model_copy(update={"motion": motions}))


def _unrounded(since_s: NDArray[np.float64], rounding_s: float) -> NDArray[np.float64]:
    """Return whole ticks where stamps are that but for the rounding of large numbers, which would look like noise."""
    ticks_s = np.rint(since_s / _TICK_S) * _TICK_S
    return ticks_s if np.max(np.abs(ticks_s - since_s)) <= rounding_s else since_s
