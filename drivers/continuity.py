"""Whether samples follow one another: gaps, repeats and restarts, told by counter, device time and host time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.samples import SampleArray


@dataclass(frozen=True, slots=True)
class Gap:
    """Frames missing before row ``index``: how many, and the device time [s] between the rows on either side."""

    index: int
    frames: int
    duration_s: float


@dataclass(slots=True)
class Marks:
    """What was found in one run of samples: ``keep`` are the rows left, ``gaps`` and ``restarts`` index those."""

    keep: NDArray[np.intp]
    gaps: list[Gap] = field(default_factory=list)
    restarts: list[int] = field(default_factory=list)
    duplicates: int = 0


class Continuity:
    """Follows one stream of samples.

    Parameters
    ----------
    delay_tolerance_s : by how much the host may be late [s] before, across a re-opened line, a gap whose device
        time is too short for the host time that passed is taken for a restart.
    """

    def __init__(self, delay_tolerance_s: float = 0.5) -> None:
        self._tolerance_s = delay_tolerance_s
        self._last: tuple[int, float, float] | None = None

    def follow(self, samples: SampleArray, host_time_s: NDArray[np.float64], reopened: Iterable[int] = ()) -> Marks:
        """Judge the next samples; ``reopened`` are the rows that came first after the line was opened again."""
        marks = Marks(np.arange(len(samples)))
        if not len(samples):
            return marks
        reopened = frozenset(reopened)
        if self._last is None or reopened or not self._plain(samples):
            self._judge(samples, host_time_s, reopened, marks)
        else:
            self._last = (int(samples["sequence"][-1]), float(samples["time"][-1]), float(host_time_s[-1]))
        return marks

    def _plain(self, samples: SampleArray) -> bool:
        """Whether every sample is the next one after its forerunner."""
        assert self._last is not None
        sequence, time_s, _ = self._last
        steps = np.diff(samples["sequence"], prepend=np.uint32(sequence))
        return bool(np.all(steps == 1) and np.all(np.diff(samples["time"], prepend=time_s) > 0))

    def _judge(
        self, samples: SampleArray, host_time_s: NDArray[np.float64], reopened: frozenset[int], marks: Marks
    ) -> None:
        """Go row by row."""
        keep: list[int] = []
        rows = zip(samples["sequence"].tolist(), samples["time"].tolist(), host_time_s.tolist(), strict=True)
        for row, (sequence, time_s, host_s) in enumerate(rows):
            if self._last is not None:
                last_sequence, last_time_s, last_host_s = self._last
                step = (sequence - last_sequence + 2**31) % 2**32 - 2**31
                elapsed_s = time_s - last_time_s
                if step == 0 and elapsed_s == 0:
                    marks.duplicates += 1
                    continue
                unseen_s = host_s - last_host_s - elapsed_s if row in reopened else 0.0
                if step <= 0 or elapsed_s <= 0 or (step > 1 and unseen_s > self._tolerance_s):
                    marks.restarts.append(len(keep))
                elif step > 1:
                    marks.gaps.append(Gap(len(keep), step - 1, elapsed_s))
            keep.append(row)
            self._last = (sequence, time_s, host_s)
        marks.keep = np.array(keep, np.intp)
