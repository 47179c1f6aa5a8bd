"""First of all: samples that were lost and registers that stood still, found by their own marks and taken out."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.samples import SampleArray, intervals_s
from inertial.documents import CHANNELS

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_CHANCE = 1e-6  # of a run of equal readings arising by itself somewhere in the record
_SHORTEST_RUN = 6


@dataclass(frozen=True)
class Stuck:
    """One sensor's register stood still from ``start_s`` for ``duration_s`` [s, device clock]."""

    channel: str
    start_s: float
    duration_s: float
    samples: int


@dataclass(frozen=True)
class Repaired:
    """A recording without gaps.

    ``edges_s`` (n + 1,) device time of the intervals' ends; ``rate`` (n, 6) readings [m/s², rad/s]; ``missing`` (n, 6)
    marks what is not a measurement; ``temperature_c``, ``supply_v`` (n,), NaN where the block has none.
    """

    edges_s: Array
    rate: Array
    missing: Mask
    temperature_c: Array
    supply_v: Array
    lost: int
    stuck: tuple[Stuck, ...]

    @property
    def lost_fraction(self) -> float:
        """Share of frames that never came."""
        return self.lost / (len(self.edges_s) - 1)


def repair(samples: SampleArray) -> Repaired:
    """Put a row, marked missing, where a frame was lost, and mark the rows of a register that stood still."""
    interval = intervals_s(samples)
    steps = np.diff(samples["sequence"]).astype(np.int32)
    place = np.concatenate([[0], np.cumsum(steps)])
    count = int(place[-1]) + 1
    whole = np.arange(count)
    time_s = np.interp(whole, place, samples["time"])
    edges = np.concatenate([[time_s[0] - interval[0]], time_s])
    sent = np.hstack([samples["dv"], samples["dtheta"]]) / interval[:, None]
    came = np.zeros(count, dtype=np.bool_)
    came[place] = True
    rate = np.empty((count, 6))
    missing = np.repeat(~came[:, None], 6, axis=1)
    stuck: list[Stuck] = []
    for column, channel in enumerate(CHANNELS):
        increment = (samples["dv"] if column < 3 else samples["dtheta"])[:, column % 3]
        for first, last in _standing(increment):
            missing[place[first] : place[last] + 1, column] = True
            begins = float(samples["time"][first])
            stuck.append(
                Stuck(channel, begins, float(samples["time"][last] + interval[last] - begins), last - first + 1)
            )
        rate[:, column] = np.interp(whole, place, sent[:, column])
    temperature = samples["temperature"][:, 0] if samples["temperature"].shape[1] else np.full(len(samples), np.nan)
    return Repaired(
        edges,
        rate,
        missing,
        np.interp(whole, place, temperature.astype(np.float64)),
        np.interp(whole, place, samples["supply"].astype(np.float64)),
        count - len(samples),
        tuple(stuck),
    )


def _standing(increment: Array) -> list[tuple[int, int]]:
    """Return runs (first repeated, last) of equal readings too long to be chance, given how often neighbours agree."""
    same = np.diff(increment) == 0.0
    if not same.any() or same.all():
        return []
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    first, last = edges[::2], edges[1::2]
    lengths = last - first
    # How often neighbours agree where nothing stands still: the median length resists a few long runs.
    plain = lengths <= max(3.0 * float(np.median(lengths)), 3.0)
    share = (float(lengths[plain].sum()) + 1.0) / (same.size - float(lengths[~plain].sum()) + 1.0)
    share = min(share, 0.999)
    longest = max(_SHORTEST_RUN, math.log(_CHANCE / same.size) / math.log(share))
    zero = increment[first] == 0.0  # a dead band stands at zero and is no stuck register
    return [(int(a) + 1, int(b)) for a, b, z in zip(first, last, zero, strict=True) if b - a >= longest and not z]


def fill(values: Array, missing: Mask) -> Array:
    """Return values (n,) with the missing ones on straight lines between the means beside them: a linear operation."""
    if not missing.any():
        return values
    filled = values.copy()
    if missing.all():
        filled[:] = 0.0
        return filled
    edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]]).astype(np.int8)))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        reach = max(1, min(end - first, 200))
        before = values[max(0, first - reach) : first][~missing[max(0, first - reach) : first]]
        after = values[end : end + reach][~missing[end : end + reach]]
        left = float(before.mean()) if before.size else float(after.mean()) if after.size else 0.0
        right = float(after.mean()) if after.size else left
        filled[first:end] = np.linspace(left, right, end - first + 2)[1:-1]
    return filled
