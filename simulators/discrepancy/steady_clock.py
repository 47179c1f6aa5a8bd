"""Stamps that scatter about a steady clock: put on by a host as frames arrive, not by the block as it samples.

What a block integrates over equal intervals would be divided by unequal ones, and gravity be noise. Which of the two is
equal the accelerometers tell: what they sum up of gravity grows with the interval that it was summed over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.recording import Recording
from drivers.samples import SampleArray, intervals_s

Array = NDArray[np.float64]

_SCATTER = 1e-4  # of an interval, below which stamps are as good as steady
_SMOOTHER = 0.5  # times as rough as by the stamps, that gravity is by equal intervals
_BENDS_S = 1e-3  # by which a clock may bend: as much as a schedule may be off
_BLOCKS = 20


def at_steady_rate(recordings: Sequence[Recording]) -> list[Recording]:
    """Return recordings whose stamps lie on a line, where only their stamps scatter."""
    return [_steadied(one) if stamp_scatter_s(one.samples) else one for one in recordings]


def stamp_scatter_s(samples: SampleArray) -> float:
    """Return the rms by which stamps scatter about a steady clock; 0 where they do not, or the sampling itself does."""
    interval, off = intervals_s(samples), samples["time"] - _on_a_line(samples)
    if float(np.median(np.abs(interval / np.median(interval) - 1.0))) < _SCATTER:
        return 0.0
    size = np.linalg.norm(samples["dv"], axis=1)
    forces = size / interval, size / interval.mean()
    by_stamps, by_clock = (float(np.median(np.abs(np.diff(force)))) for force in forces)
    bends = float(np.ptp([block.mean() for block in np.array_split(off, _BLOCKS)]))
    return float(off.std()) if by_clock < _SMOOTHER * by_stamps and bends < _BENDS_S else 0.0


def _on_a_line(samples: SampleArray) -> Array:
    """Return the stamps (n,) that a steady clock would have put on."""
    steps = np.diff(samples["sequence"]).astype(np.int32)
    place = np.concatenate([[0], np.cumsum(steps)]).astype(np.float64)
    return np.asarray(np.polynomial.Polynomial.fit(place, samples["time"], 1)(place))


def _steadied(recording: Recording) -> Recording:
    samples = recording.samples.copy()
    samples["time"] = _on_a_line(samples)
    return replace(recording, samples=samples)
