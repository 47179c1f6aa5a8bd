"""Live stillness: the detector of :mod:`inertial.standstill`, fed with batches as they come."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from drivers.samples import SampleArray
from inertial.documents import Noise
from inertial.standstill import StillnessDetector, learn_noise
from service.buffer import SampleBuffer
from service.made_up_rest import made_up_rest

LEARN_S = 15.0
"""How much of a run's beginning (settling) shows the block's noise, where no model tells it."""

Array = NDArray[np.float64]


class MotionWatch:
    """Tells batch by batch whether the block is still.

    Parameters
    ----------
    noise
        Of the block; None learns it from the first samples, which count as still meanwhile: they come while the block
        settles, and settling takes longer.
    """

    def __init__(self, noise: Noise | None = None) -> None:
        self._known = noise
        self.reset()

    def reset(self) -> None:
        """Forget the samples: those that follow do not continue them."""
        self._detector = StillnessDetector(self._known) if self._known is not None else None
        self._seen = SampleBuffer()
        self._last: SampleArray | None = None

    def feed(self, samples: SampleArray) -> bool:
        """Take a batch; return whether nothing in it shows motion."""
        interval_s = self._intervals_s(samples)
        self._last = samples[-1:].copy()
        if self._detector is None:
            self._learn(samples)
            return True
        found = self._detector.feed(samples["time"], samples["dv"], samples["dtheta"], interval_s)
        return not found

    def _intervals_s(self, samples: SampleArray) -> Array:
        """Interval of each sample; the first of all takes its successor's."""
        rows = samples if self._last is None else np.concatenate([self._last.astype(samples.dtype), samples])
        if len(rows) < 2:
            return np.full(len(samples), np.nan)
        steps = np.diff(rows["sequence"]).astype(np.int32)
        interval_s = np.diff(rows["time"]) / np.maximum(steps, 1)
        return interval_s if self._last is not None else np.concatenate([interval_s[:1], interval_s])

    def _learn(self, samples: SampleArray) -> None:
        self._seen.append(samples)
        rows = self._seen.rows()
        steps = np.diff(rows["sequence"]).astype(np.int32)
        interval_s = np.diff(rows["time"]) / np.maximum(steps, 1)
        if interval_s.sum() < LEARN_S:  # not the time that passed: frames may be missing
            return
        noise = learn_noise(rows["dv"][1:], rows["dtheta"][1:], interval_s)
        self._detector, self._seen = StillnessDetector(noise), SampleBuffer()


@cache
def prepare() -> None:
    """Make compiled code ready, once a process; takes seconds where it never was compiled."""
    watch, rest = MotionWatch(), made_up_rest(3 * LEARN_S)
    half = len(rest) // 2
    watch.feed(rest[:half])  # learns the noise
    watch.feed(rest[half:])  # watches
