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

_CHANCE = 1e-4  # of a run of equal readings arising by itself somewhere in a channel
_SHORTEST_RUN = 6
_ASIDE = 200  # samples on either side of a run that say what the register should have read
_ASTRAY = 5.5  # σ by which a run's sum is off what its neighbours say
_BLOCK = 32


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
    """Return runs (first repeated, last) of equal readings that are not chance: too long, or off their neighbours.

    A readout whose step is of the order of the noise repeats values by itself, often and long. But what it rounds off
    it carries on to the next sample, so the sum over such a run is right to a step; a register that stands still loses
    what came meanwhile.
    """
    same = np.diff(increment) == 0.0
    if not same.any() or same.all():
        return []
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    first, last = edges[::2], edges[1::2]
    lengths = last - first
    step, noise = _step(increment), _noise(increment)
    longest = max(_longest_by_rounding(noise / step, same.size), _longest_by_custom(lengths, same.size))
    found = []
    for a, b in zip(first, last, strict=True):
        if b - a < _SHORTEST_RUN or increment[a] == 0.0:  # a dead band stands at zero and is no stuck register
            continue
        if b - a >= longest or _astray(increment, int(a), int(b), step, noise) > _ASTRAY:
            found.append((int(a) + 1, int(b)))
    return found


def _step(increment: Array) -> float:
    """Return the readout's step: the smallest difference between readings that is no rounding of a float."""
    apart = np.diff(np.unique(increment))
    apart = apart[apart > 1e-9 * np.max(np.abs(increment))]
    return float(apart.min()) if apart.size else math.inf


def _noise(increment: Array) -> float:
    """Return the σ of a sample's noise before it was rounded, from sums over blocks, which rounding hardly touches."""
    count = increment.size // _BLOCK
    if count < 8:
        return 0.0
    sums = increment[: count * _BLOCK].reshape(count, _BLOCK).sum(axis=1)
    return 1.4826 * float(np.median(np.abs(np.diff(sums, 2)))) / math.sqrt(6.0 * _BLOCK)


def _longest_by_rounding(steps: float, size: int) -> float:
    """Return the length that runs reach by chance when noise of so many steps a sample is summed and rounded.

    A random walk stays within one step for L samples with probability exp(-λL), λ = π²σ²/2 for small σ, the step
    widened by 1.166 σ for a walk that is looked at once a sample (Siegmund 1985, ch. 10).
    """
    leaving = 0.5 * (math.pi * steps / (1.0 + 1.166 * steps)) ** 2
    if steps > 1.0:
        leaving = min(leaving, math.log(2.5 * steps))
    return math.log(max(size * leaving, 1.0) / _CHANCE) / max(leaving, 1e-9)


def _longest_by_custom(lengths: NDArray[np.int64], size: int) -> float:
    """Return the length that runs reach by chance, from the tail that the runs of this record have."""
    tail = float(np.quantile(lengths, 0.9))
    beyond = lengths[lengths >= tail] - tail
    mean = max(float(np.median(beyond)) / math.log(2.0), 1.0 / math.log(size))
    return tail + mean * math.log(max(beyond.size, 1) / _CHANCE)


def _astray(increment: Array, a: int, b: int, step: float, noise: float) -> float:
    """Return by how many σ the sum over a run is off what the neighbours on either side say, rounding granted."""
    count = b - a
    off = []
    for aside in (increment[max(0, a - _ASIDE) : max(0, a - 1)], increment[b + 2 : b + 2 + _ASIDE]):
        if aside.size < _ASIDE // 4:
            continue
        wild = max(noise, _noise(aside))
        spread = wild * math.sqrt(count * (1.0 + count / aside.size)) + step * count / aside.size
        off.append((abs(count * (increment[a] - float(aside.mean()))) - step) / max(spread, 1e-300))
    return min(off, default=0.0)


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
