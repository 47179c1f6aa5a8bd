"""Registers that stood still: runs of one reading that neither rounding nor the input explains, taken out.

A readout whose step is of the order of the noise repeats values by itself, often and long. But what it rounds off it
carries on to the next sample, so the sum over such a run is right to a step; a register that stands still loses what
came meanwhile.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import lambertw, ndtri

from inertial.documents import CHANNELS
from simulators.discrepancy.compare import Scene, following_vibrations
from simulators.discrepancy.runs import runs
from simulators.discrepancy.whitening import FREE_SHARE

Array = NDArray[np.float64]

_CHANCE = 1e-5  # of a run of equal readings arising by itself in a channel that reads whole steps, the worst case
_SHORTEST_RUN = 3
_SHORT_RUN = 6
_INPUTS = 20.0  # that a record has at most, which are steady for as long as a run
_CUSTOM = 10  # runs from which on they are a custom
_ASIDE = 100  # samples on either side of a run, at least, that say what the register should have read
_NEXT = 10  # samples next to a run, and as many again as it has
_ASTRAY = 5.5  # by how many times its uncertainty a run's sum is off what its neighbours say
_NEAR_SHARE = 0.8  # ... of that, what its nearest neighbours say, who are few
_LONGER, _FAR_SHARE = 8.0, 0.5  # times the longest run by custom, and share of that which those far about then say
_FAR_ASTRAY = 8.0  # ... that of a short one, of which there are many
_ROUNDED = 1.0 / 6.0  # variance of a sum in steps whose ends are rounded [step²]
_LEAP = 3  # samples behind a run by which a leap is told
_SWING, _AS_FAR = 10, 0.7  # times its length on either side that a swing is looked for, and share of a run's sum
_BESIDE = 50  # samples beside a run that say how it would have been shaken
_BLOCK, _FEWEST_BLOCKS = 32, 8
_LESSER, _LESSER_SQUARES = 0.6, 0.2147  # of squares, and the mean of so many of a normal distribution's
_LEAST_NOISE = 0.05  # of a step
_EDGE_S = 0.1  # about the ends of a turn
_ORDINARY, _MOSTLY = 0.9, 0.5  # of inputs where readings are zero, and of readings at such inputs
_COUNTED = 30.0  # readings other than zero that are to be expected, to say that there are too few; or zeros too many
_MISSED = 3.0  # steps of a run's input, which a readout of small inputs would have read
_STEADY, _AS_LARGE = 0.5, 0.8  # of an input's mean, that its least is, and that others' means are
_FEWER, _FEWER_SIGMAS = 0.85, 3.0  # of what is to be expected, and of its scatter, that is too few
_TOO_MANY = 3.0  # times as many zeros as are to be expected
_NORMAL = ndtri((np.arange(9) + 0.5) / 9.0)  # of as many, each as likely


@dataclass(frozen=True)
class Stuck:
    """One sensor's register stood still from ``start_s`` for ``duration_s`` [s, device clock], both ± ``sigma_s``."""

    channel: str
    start_s: float
    duration_s: float
    sigma_s: float


@dataclass(frozen=True)
class _Driven:
    """What drives a channel's increments, sample by sample (n,).

    The prediction; by how much a vibration changes it from each sample to the next, for its course is not known but by
    the readings; whether the block turns, and whether a turn begins or ends there.
    """

    said: Array
    shaken: Array
    turning: NDArray[np.bool_]
    changing: NDArray[np.bool_]


def find_stuck(scene: Scene) -> tuple[Scene, list[Stuck]]:
    """Return the scene with the samples of registers that stood still marked missing, and which they were."""
    data, missing = scene.data, scene.data.missing
    interval, changing = np.diff(data.edges_s), scene.near_turn_ends(scene.time_s, _EDGE_S)
    turning = scene.turning(scene.time_s) | changing
    found = []
    for column, channel in enumerate(CHANNELS):
        came = np.flatnonzero(~missing[:, column])
        increment = data.sent[came, column]
        said = scene.predicted[came, column] * interval[came]
        off = scene.measured[came, column] * interval[came] - said
        white = getattr(scene.model.noise, channel).white * (FREE_SHARE if scene.model.noise.free else 1.0)
        white_by_model = white * math.sqrt(scene.seen.interval_s) or math.inf
        shaken = _vibrated(scene, column)[came] * interval[came]
        # That a turn ends late is no reading that stood still.
        settled = _without_ends(off, changing[came])
        driven = _Driven(said, shaken, turning[came], changing[came])
        for first, last in _standing(increment, (off, settled), driven, white_by_model, tilted=column < 3):
            found.append(stuck_from(scene, channel, int(came[first]), int(came[last])))
    return without_stuck(scene, found), found


def stuck_from(scene: Scene, channel: str, first: int, last: int) -> Stuck:
    """Return the register that stood still from a sample to another."""
    edges, column = scene.data.edges_s, CHANNELS.index(channel)
    came = scene.data.sent[~scene.data.missing[:, column], column]
    # A reading may have been the same by itself just before, or just after.
    sigma_s = scene.seen.interval_s * max(1.0, _mean_run(came))
    return Stuck(channel, float(edges[first]), float(edges[last + 1] - edges[first]), sigma_s)


def without_stuck(scene: Scene, found: Sequence[Stuck]) -> Scene:
    """Return the scene with the samples of registers that stood still marked missing, and taken for no vibration."""
    if not found:
        return scene
    missing, middle_s = scene.data.missing.copy(), 0.5 * (scene.data.edges_s[:-1] + scene.data.edges_s[1:])
    for one in found:
        within = (middle_s > one.start_s) & (middle_s < one.start_s + one.duration_s)
        missing[within, CHANNELS.index(one.channel)] = True
    return following_vibrations(replace(scene, data=replace(scene.data, missing=missing)))


def _without_ends(off: Array, ends: NDArray[np.bool_]) -> Array:
    """Return what is off (n,) with what lies about the ends of turns taken for as large as what is beside it."""
    kept = np.flatnonzero(~ends)
    if kept.size < 2 * _ASIDE:
        return off
    blocks = np.array_split(kept, kept.size // _ASIDE)
    means = [float(off[block].mean()) for block in blocks]
    beside = np.interp(np.flatnonzero(ends), [float(block.mean()) for block in blocks], means)
    settled = off.copy()
    settled[ends] = beside
    return settled


def _vibrated(scene: Scene, column: int) -> Array:
    """Return by how much a vibration changes a channel's rate from each sample to the next (n,)."""
    change = np.zeros(len(scene.measured))
    if column < 3:
        for rows, axis in scene.vibrations:
            if axis[column]:
                change[rows] = np.diff(scene.shaken[rows, column], prepend=scene.shaken[rows, column][:1])
    return change


def _jolts(shaken: Array, first: NDArray[np.int64], last: NDArray[np.int64]) -> Array:
    """Return the rms change before each run or after it, whichever is less: what it would have been during the run."""
    squares = np.concatenate([[0.0], np.cumsum(shaken**2)])
    before, behind = np.maximum(first - _BESIDE, 0), np.minimum(last + 1 + _BESIDE, shaken.size)
    sides = squares[first] - squares[before], squares[behind] - squares[last + 1]
    return np.asarray(np.sqrt(np.minimum(*sides) / _BESIDE))


def _standing(
    increment: Array,
    offs: tuple[Array, Array],
    driven: _Driven,
    white_by_model: float,
    *,
    tilted: bool,
) -> list[tuple[int, int]]:
    """Return runs (first repeated, last) of equal readings that are not chance: too long, or off their neighbours.

    ``offs`` is by how much each increment is off the prediction, as it is and without the ends of turns;
    ``white_by_model``: the σ of a sample's white noise, for what goes on slowly beside it does not break runs;
    ``tilted``: it is the block's attitude that is read, as by an accelerometer.
    """
    off, said, shaken = offs[0], driven.said, driven.shaken
    same = np.diff(increment) == 0.0
    if not same.any() or same.all():
        return []
    first, last = runs(same)
    lengths, at_nothing = last - first, increment[first] == 0.0
    step = step_of(increment)
    quiet = off[shaken == 0.0]  # where it is shaken it is never off: the course is the reading's own
    quiet = quiet if quiet.size > _FEWEST_BLOCKS * _BLOCK else off
    noise = _noise(quiet, step)
    # Noise that is slow changes little from sample to sample, whatever it sums up to.
    changes = np.sort(np.abs(np.diff(quiet)))
    fast = min(noise, math.sqrt(math.pi) / 2.0 * float(changes[: int(0.98 * changes.size)].mean()))
    by_custom = longest_by_custom(lengths, same.size)
    white = min(fast, white_by_model)
    by_rounding = np.where(
        at_nothing, longest_by_rounding(white / step, same.size), longest_off_zero(white / step, same.size)
    )
    longest = np.maximum(by_rounding, by_custom)
    jolts = _jolts(shaken, first, last)
    for run, jolt in enumerate(jolts):
        if jolt > white:
            longest[run] = min(longest[run], max(longest_by_rounding(float(jolt) / step, same.size), _SHORT_RUN))
    candidate = (lengths >= _SHORTEST_RUN) & ~_at_limit(increment, said, first, last, step)
    candidate &= (lengths >= longest) | _may_be_astray(off, first, last, step, noise)
    at_zero = candidate & at_nothing
    if _is_dead_band(first[at_zero], last[at_zero], increment / step, said / step, white / step):
        candidate &= ~at_zero
    # A coarse readout of a small input is at zero most of the time.
    unlike = _unlike_other_zeros(increment, said / step, driven.turning, first, last)
    candidate &= ~at_zero | (lengths >= by_custom) | unlike
    found = []
    for a, b, chance, jolt in zip(first[candidate], last[candidate], longest[candidate], jolts[candidate], strict=True):
        far_share = _FAR_SHARE if b - a > _LONGER * by_custom else 1.0
        begun, over = _alike(driven, int(a), int(b))
        as_is, without_ends = (
            _astray(one[begun:over], int(a) - begun, int(b) - begun, step, math.hypot(noise, jolt), far_share)
            for one in offs
        )
        leapt = tilted and _let_go(off, int(b), step, noise)
        if leapt:
            astray = as_is  # a turn that comes late leaves an attitude late, not all at once right
        elif not tilted and np.array_equal(offs[0][a + 1 : b + 1], offs[1][a + 1 : b + 1]):
            astray = without_ends  # what a turn's end does to a gyro's readings beside says nothing of the run
        else:
            astray = min(as_is, without_ends)
        short = b - a < _SHORT_RUN
        if short and driven.changing[a + 1] and not leapt:
            continue  # a turn that came late stands still for as long
        unseen = abs(float(np.sum(said[a + 1 : b + 1] - said[a])))
        if short and unseen < _FAR_ASTRAY * noise * math.sqrt(b - a) + 2.0 * step:
            continue  # of a few samples only a motion that goes on without them tells
        if not _was_read(off, int(a), math.hypot(noise, jolt, step)):
            continue
        if b - a >= chance or astray > (_FAR_ASTRAY if short else _ASTRAY):
            found.append((int(a) + 1, int(b)))
    return found


def _alike(driven: _Driven, a: int, b: int) -> tuple[int, int]:
    """Return from where to where a block stands still, or turns, as it does in a run; all there is, if it does both.

    What a turn does to readings beside a run at rest says nothing of it, nor the rest beside a turn of one in it.
    """
    turns = driven.turning & ~driven.changing
    other = ~turns if turns[a : b + 1].all() else driven.turning
    if other[a : b + 1].any():
        return 0, other.size
    before, behind = np.flatnonzero(other[:a]), np.flatnonzero(other[b + 1 :])
    return (int(before[-1]) + 1 if before.size else 0), (b + 1 + int(behind[0]) if behind.size else other.size)


def _at_limit(
    increment: Array, said: Array, first: NDArray[np.int64], last: NDArray[np.int64], step: float
) -> NDArray[np.bool_]:
    """Return which runs are of the largest reading there is, while the input is said to be larger still: at a limit."""
    sums = np.concatenate([[0.0], np.cumsum(said)])
    inputs = (sums[last + 1] - sums[first]) / (last + 1 - first)
    readings = increment[first]
    largest = np.abs(readings) > float(np.abs(increment).max()) - 1.5 * step
    return np.asarray(largest & (np.sign(readings) * inputs > np.abs(readings) + step))


def _unlike_other_zeros(
    reading: Array, said: Array, turning: NDArray[np.bool_], first: NDArray[np.int64], last: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return which runs of zeros miss some steps of a steady input ``said`` [steps], twice what others of such miss.

    What is said of a ``turning`` block may be off by more than a block at rest ever misses.
    """
    zero = np.flatnonzero(reading[first] == 0.0)
    sums = np.concatenate([[0.0], np.cumsum(said)])
    missed = np.abs(sums[last[zero] + 1] - sums[first[zero] + 1])
    size = missed / np.maximum(last[zero] - first[zero], 1)
    unlike = np.zeros(first.size, dtype=np.bool_)
    for place in np.flatnonzero(missed > _MISSED):
        run = zero[place]
        steady = np.min(np.abs(said[first[run] + 1 : last[run] + 1])) > _STEADY * size[place]
        others = (size > _AS_LARGE * size[place]) & (np.arange(zero.size) != place)
        others &= turning[first[run]] | ~turning[first[zero]]
        unlike[run] = steady and missed[place] > 2.0 * np.max(missed[others], initial=0.0)
    return unlike


def _is_dead_band(first: NDArray[np.int64], last: NDArray[np.int64], reading: Array, said: Array, white: float) -> bool:
    """Whether runs of zeros are where the input is small, whenever it is: a dead band, and no register that stuck.

    Readings, input and a sample's white noise are in steps. Outside the runs, a readout in steps is other than zero as
    often as input and noise together are large.
    """
    if not first.size:
        return False
    silent = np.zeros(said.size, dtype=np.bool_)
    for a, b in zip(first, last, strict=True):
        silent[a : b + 1] = True
    as_small = np.abs(said) <= np.quantile(np.abs(said[silent]), _ORDINARY)
    if float(np.mean(silent[as_small])) > _MOSTLY:
        return True
    beside = as_small & ~silent
    count, others = int(beside.sum()), int(np.count_nonzero(reading[beside]))
    expected = spoken_by_rounding(said[beside], white, 1.0)
    too_few_others = expected > _COUNTED and others < _FEWER * expected - _FEWER_SIGMAS * math.sqrt(expected)
    return too_few_others or count - others > max(_COUNTED, _TOO_MANY * (count - expected))


def spoken_by_rounding(inputs: Array, white: float, step: float) -> float:
    """Return how many of as many inputs (n,) with white noise are read as other than zero in such steps, all [y]."""
    jolted = np.abs(inputs[:, None] + white * _NORMAL)
    return float(np.sum(np.mean(np.minimum(jolted / step, 1.0), axis=1))) if step else float(len(inputs))


def _mean_run(increment: Array) -> float:
    """Return how many samples a reading stays the same in the mean."""
    return increment.size / (1.0 + float(np.sum(np.diff(increment) != 0.0)))


def step_of(increment: Array) -> float:
    """Return the readout's step: the smallest difference between readings that is no rounding of a float."""
    apart = np.diff(np.unique(increment))
    apart = apart[apart > 1e-9 * np.max(np.abs(increment))]
    return float(apart.min()) if apart.size else math.inf


def _noise(increment: Array, step: float) -> float:
    """Return the σ of a sample's noise before it was rounded, from sums over blocks, which rounding hardly touches.

    By their second differences, the lesser ones, so that a part of the record that is shaken or turned does not count.
    In these are four rounding errors of one step's width, times 1, 3, 3 and 1. No noise is taken to be so little that
    only rounding is left: nobody predicts an input as well as that.
    """
    count = increment.size // _BLOCK
    if count < _FEWEST_BLOCKS:
        return 0.0
    sums = increment[: count * _BLOCK].reshape(count, _BLOCK).sum(axis=1)
    squares = np.sort(np.square(np.diff(sums, 2)))
    lesser = float(np.mean(squares[: max(int(_LESSER * squares.size), 1)])) / _LESSER_SQUARES
    rounding = 20.0 / 12.0 * step**2 if math.isfinite(step) else 0.0
    return math.sqrt(max((lesser - rounding) / (6.0 * _BLOCK), (_LEAST_NOISE * step) ** 2 if rounding else 0.0))


def longest_by_rounding(steps: float, size: int) -> float:
    """Return the length that runs reach by chance when noise of so many steps a sample is summed and rounded.

    A random walk stays within one step for L samples with probability exp(-λL), λ = π²σ²/2 for small σ, the step
    widened by 1.166 σ for a walk that is looked at once a sample (Siegmund 1985, ch. 10).
    """
    nats, leaving = _staying(steps, size)
    return nats / leaving


def longest_off_zero(steps: float, size: int) -> float:
    """Return the length that runs of readings other than zero reach by chance.

    Of inputs of any size one in L/2 is within a step in L samples of a whole number of steps, and a record has few.
    """
    nats, leaving = _staying(steps, size)
    if nats < 2.0 * _INPUTS * leaving:
        return nats / leaving
    # L·λ + ln(L/2) = nats + ln inputs.
    return float(lambertw(2.0 * _INPUTS * leaving * math.exp(nats)).real) / leaving


def _staying(steps: float, size: int) -> tuple[float, float]:
    """Return how unlikely a run must be [nats], of all that could be, and how much so it grows with every sample."""
    leaving = 0.5 * (math.pi * steps / (1.0 + 1.166 * steps)) ** 2
    if steps > 1.0:
        leaving = min(leaving, math.log(2.5 * steps))
    return math.log(max(size * leaving, 1.0) / _CHANCE), max(leaving, 1e-9)


def longest_by_custom(lengths: NDArray[np.int64], size: int) -> float:
    """Return the length that runs reach by chance, from the tail of this record's runs, if there are many."""
    if lengths.size < _CUSTOM:
        return 0.0
    tail = float(np.quantile(lengths, 0.9))
    beyond = lengths[lengths >= tail] - tail
    mean = max(float(np.median(beyond)) / math.log(2.0), 1.0 / math.log(size))
    return tail + mean * math.log(max(beyond.size, 1) / _CHANCE)


def _may_be_astray(
    off: Array, first: NDArray[np.int64], last: NDArray[np.int64], step: float, noise: float
) -> NDArray[np.bool_]:
    """Return which runs :func:`_astray` is worth asking for, by their nearest neighbours and half its bound."""
    sums = np.concatenate([[0.0], np.cumsum(off)])
    low, high = np.maximum(first - _ASIDE, 0), np.minimum(last + 1 + _ASIDE, off.size)
    run = sums[last + 1] - sums[first + 1]
    count = last - first
    beside = (sums[high] - sums[low] - run) / np.maximum(high - low - count, 1)
    return np.asarray(np.abs(run - count * beside) - step > 0.5 * _ASTRAY * noise * np.sqrt(count))


def _astray(off: Array, a: int, b: int, step: float, noise: float, far_share: float) -> float:
    """Return how far the sum over a run is off what its neighbours say, over what it may be off.

    Those far about it, who need say but a share, know best what goes on all the time, those next to it whether the
    input itself swung so far: a register that stood still is off both. Nothing is astray where the input swings as far
    before or after it.
    """
    if _swings(off, a, b):
        return 0.0
    far, near = (_off_beside(off, a, b, step, noise, aside) for aside in (max(_ASIDE, 3 * (b - a)), _NEXT + b - a))
    return min(far / far_share, near / _NEAR_SHARE)


def _was_read(off: Array, a: int, sigma: float) -> bool:
    """Whether what is repeated from ``a`` on was a reading at first, as right as those before it.

    A dead band that a fast input passes repeats zeros that never were one.
    """
    before = off[max(a - _LEAP, 0) : a]
    return not before.size or abs(float(off[a] - before.mean())) < _ASTRAY * sigma


def _let_go(off: Array, b: int, step: float, noise: float) -> bool:
    """Whether a run that ends at ``b`` is followed by a leap."""
    behind = off[b + 1 : b + 1 + _LEAP]
    return bool(behind.size and abs(float(off[b] - behind.mean())) > _FAR_ASTRAY * math.hypot(noise, step))


def _swings(off: Array, a: int, b: int) -> bool:
    """Whether as many samples near a run add up to as much, a good part of it, beyond what is usual there."""
    count = b - a
    low, high = max(a + 1 - _SWING * count, 0), min(b + 1 + _SWING * count, off.size)
    sums = np.concatenate([[0.0], np.cumsum(off[low:high])])
    windows = sums[count:] - sums[:-count]
    windows = np.abs(windows - np.median(windows))  # of sums: the middle one of coarse readings is no mean
    own = a + 1 - low
    beside = np.concatenate([windows[: max(own - count, 0)], windows[own + count :]])
    return bool(np.max(beside, initial=0.0) > _AS_FAR * windows[own])


def _off_beside(off: Array, a: int, b: int, step: float, noise: float, aside: int) -> float:
    """Return :func:`_astray` by so many samples on either side.

    What the sum may be off is noise, rounding of the run, by one step at most, and of its neighbours, and what these
    differ by among themselves.
    """
    count = b - a
    sides = (off[max(0, a - aside) : max(0, a - 1)], off[b + 2 : b + 2 + aside])
    halves = [half for side in sides if side.size >= aside // 2 for half in np.array_split(side, 2)]
    if not halves:
        return 0.0
    means = np.array([float(half.mean()) for half in halves])
    fewest = min(half.size for half in halves)
    # What noise and rounding make them differ by is counted once, with that of the run itself.
    alike = 16.0 * noise**2 / fewest + (2.0 * step / fewest) ** 2
    apart = math.sqrt(max(float(np.ptp(means)) ** 2 - alike, 0.0))
    sigma = noise * math.sqrt(count * (1.0 + count / (len(halves) * fewest)))
    rounded = step * count / fewest * math.sqrt(_ROUNDED / len(halves))
    astray = abs(float(np.sum(off[a + 1 : b + 1])) - count * float(means.mean())) - step
    return astray / max(math.hypot(sigma, count * apart, rounded), 1e-300)
