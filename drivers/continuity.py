"""Whether samples follow one another: gaps, repeats and restarts, told by counter, device time and host time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.differences import differences
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
        last_sequence, last_time_s, _ = self._last
        sequence, time_s = samples["sequence"], samples["time"]
        if sequence[0] != np.uint32((last_sequence + 1) % 2**32) or time_s[0] <= last_time_s:
            return False
        return bool(np.all(sequence[1:] - sequence[:-1] == 1) and np.all(time_s[1:] > time_s[:-1]))

    def _judge(
        self, samples: SampleArray, host_time_s: NDArray[np.float64], reopened: frozenset[int], marks: Marks
    ) -> None:
        """Look at the rows that are not simply the next one after their forerunner."""
        first = self._last is None
        last_sequence, last_time_s, last_host_s = self._last or (0, 0.0, 0.0)
        # Modulo 2³², so that a wrap is a step of one.
        steps = differences(samples["sequence"], last_sequence).astype(np.int32)
        elapsed = differences(samples["time"], last_time_s)
        odd = (steps != 1) | (elapsed <= 0)
        odd[list(reopened)] = True
        odd[0] &= not first
        dropped: dict[int, None] = {}
        for row in np.flatnonzero(odd).tolist():
            step, elapsed_s = int(steps[row]), float(elapsed[row])
            if step == 0 and elapsed_s == 0:
                dropped[row] = None
                continue
            before = row - 1
            while before in dropped:
                before -= 1
            host_s = last_host_s if before < 0 else float(host_time_s[before])
            unseen_s = float(host_time_s[row]) - host_s - elapsed_s if row in reopened else 0.0
            if step <= 0 or elapsed_s <= 0 or (step > 1 and unseen_s > self._tolerance_s):
                marks.restarts.append(row - len(dropped))
            elif step > 1:
                marks.gaps.append(Gap(row - len(dropped), step - 1, elapsed_s))
        marks.duplicates = len(dropped)
        marks.keep = np.delete(np.arange(len(samples)), list(dropped))
        if len(marks.keep):
            last = marks.keep[-1]
            self._last = (int(samples["sequence"][last]), float(samples["time"][last]), float(host_time_s[last]))
