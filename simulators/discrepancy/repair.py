"""First of all: samples that were lost are marked, so that nothing after takes a filled row for a measurement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.samples import SampleArray, intervals_s
from simulators.discrepancy.runs import runs

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_UNREAD = 0.05
"""Share of samples without a temperature, or a supply voltage, across which straight lines are drawn."""


@dataclass(frozen=True)
class Repaired:
    """A recording without gaps.

    ``edges_s`` (n + 1,) device time of the intervals' ends; ``rate`` (n, 6) readings [m/s², rad/s]; ``missing`` (n, 6)
    marks what is not a measurement; ``sent`` (n, 6) the increments [m/s, rad] as they came; ``temperature_c``,
    ``supply_v`` (n,), NaN where the block has none or too many samples are without.
    """

    edges_s: Array
    rate: Array
    missing: Mask
    temperature_c: Array
    supply_v: Array
    sent: Array
    lost: int


def repair(samples: SampleArray) -> Repaired:
    """Put a row, marked missing, where a frame was lost."""
    interval = intervals_s(samples)
    steps = np.diff(samples["sequence"]).astype(np.int32)
    place = np.concatenate([[0], np.cumsum(steps)])
    count = int(place[-1]) + 1
    whole = np.arange(count)
    time_s = np.interp(whole, place, samples["time"])
    edges = np.concatenate([[time_s[0] - interval[0]], time_s])
    increments = np.hstack([samples["dv"], samples["dtheta"]])
    rates = increments / interval[:, None]
    came = np.zeros(count, dtype=np.bool_)
    came[place] = True
    rate = np.empty((count, 6))
    missing = np.repeat(~came[:, None], 6, axis=1)
    sent = np.zeros((count, 6))
    sent[place] = increments
    for column in range(6):
        rate[:, column] = np.interp(whole, place, rates[:, column])
    temperature = samples["temperature"][:, 0] if samples["temperature"].shape[1] else np.full(len(samples), np.nan)
    return Repaired(
        edges,
        rate,
        missing,
        _bridged(whole, place, temperature.astype(np.float64)),
        _bridged(whole, place, samples["supply"].astype(np.float64)),
        sent,
        count - len(samples),
    )


def _bridged(whole: NDArray[np.int64], place: NDArray[np.int64], values: Array) -> Array:
    """Return slow values at ``whole`` from those at ``place``; the few that were not read lie between the others."""
    read = np.isfinite(values)
    if np.mean(read) < 1.0 - MOST_UNREAD:
        return np.interp(whole, place, values)
    return np.interp(whole, place[read], values[read])


@dataclass(frozen=True)
class Gaps:
    """Where values are missing, and how they are filled: on straight lines between the means beside each gap.

    A mean is that of as many values as are missing: of fewer, their noise would be there many times over.

    ``missing`` (m,) are their places, ``gap`` (m,) the gap of each, ``along`` (m,) how far along it each lies, from 0
    to 1; ``spans`` (gaps, 4) the places where the values before begin and end, and those behind.
    """

    missing: NDArray[np.int64]
    gap: NDArray[np.int64]
    along: Array
    spans: NDArray[np.int64]
    came: Mask

    @classmethod
    def of(cls, missing: Mask) -> Gaps:
        """Look at a mask (n,)."""
        first, end = runs(missing)
        reach = end - first
        spans = np.column_stack(
            [np.maximum(first - reach, 0), first, end, np.minimum(end + reach, len(missing))]
        ).astype(np.int64)
        places = np.flatnonzero(missing)
        gap = np.repeat(np.arange(len(first)), end - first)
        along = (places - first[gap] + 1) / (end - first + 1)[gap]
        return cls(places, gap, along, spans, ~missing)

    def lengths(self) -> NDArray[np.int64]:
        """Return how many values are missing in each gap (gaps,)."""
        return np.asarray(self.spans[:, 2] - self.spans[:, 1])

    def seen(self, frequency: Array) -> Array:
        """Return the share of all that there was at frequencies [1/sample] that the values which came tell.

        What stands for missing ones repeats those beside and is no evidence. But of what changes little within a gap
        and these nothing is hidden: there the noise is that of fewer values.
        """
        length, number = np.unique(self.lengths(), return_counts=True)
        hidden = 1.0 - np.sinc(2.0 * np.outer(frequency, length)) ** 2
        return np.asarray(1.0 - hidden @ (length * number) / len(self.came))

    def fill(self, values: Array) -> Array:
        """Return values (n,) with the missing ones filled: a linear operation."""
        if not self.missing.size:
            return values
        total = np.concatenate([[0.0], np.cumsum(np.where(self.came, values, 0.0))])
        count = np.concatenate([[0], np.cumsum(self.came)])
        means, known = [], []
        for begin, end in (self.spans[:, :2].T, self.spans[:, 2:].T):
            number = count[end] - count[begin]
            means.append((total[end] - total[begin]) / np.maximum(number, 1))
            known.append(number > 0)
        left = np.where(known[0], means[0], means[1])
        right = np.where(known[1], means[1], means[0])
        filled = values.copy()
        filled[self.missing] = left[self.gap] + self.along * (right - left)[self.gap]
        return filled
