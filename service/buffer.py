"""The samples of one run, in memory, growing."""

from __future__ import annotations

import numpy as np

from drivers.samples import SampleArray, empty_samples

FIRST_ROWS = 16_384


class SampleBuffer:
    """Append-only rows in one array that doubles when full; time and sequence always increase."""

    def __init__(self) -> None:
        self._rows = empty_samples()
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, samples: SampleArray) -> None:
        """Add rows; a change of the record layout (another number of temperatures) starts anew."""
        if samples.dtype != self._rows.dtype:
            self._rows, self._count = np.zeros(FIRST_ROWS, samples.dtype), 0
        needed = self._count + len(samples)
        if needed > len(self._rows):
            grown = np.zeros(max(needed, 2 * len(self._rows)), samples.dtype)
            grown[: self._count] = self._rows[: self._count]
            self._rows = grown
        self._rows[self._count : needed] = samples
        self._count = needed

    def clear(self) -> None:
        """Forget all rows; views given out before keep theirs."""
        self._rows, self._count = empty_samples(), 0

    def rows(self) -> SampleArray:
        """Return a view of all rows; it stays valid and unchanged while more are appended."""
        return self._rows[: self._count]

    def span(self, start_s: float, end_s: float | None = None) -> SampleArray:
        """Return a view of the rows with ``start_s`` <= time < ``end_s``."""
        times = self._rows["time"][: self._count]
        first = int(np.searchsorted(times, start_s))
        last = self._count if end_s is None else int(np.searchsorted(times, end_s))
        return self._rows[first:last]


def frames_lost(samples: SampleArray) -> int:
    """Return how many frames the sequence numbers say are missing between the first and the last row."""
    if len(samples) < 2:
        return 0
    spanned = (int(samples["sequence"][-1]) - int(samples["sequence"][0])) % 2**32 + 1
    return spanned - len(samples)
