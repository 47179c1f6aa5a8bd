"""Mistakes of wiring, before anything subtle: sensors exchanged, signs turned, units mistaken.

Block means of each channel are held against every input of its triad, with either sign and the ratios of units that
happen, of which the sample rate is one; a mistake is found where it explains what is measured and the channel's own
input does not. A readout whose step is the stated one times the ratio of two units is in the other unit, however little
the input has to say; so is a sensor that has the noise for it, where another of its triad tells the unit.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from inertial.documents import CHANNELS
from simulators.discrepancy.compare import Scene
from simulators.discrepancy.one_unit import proportions_of, sharing
from simulators.discrepancy.resolution import coarser
from simulators.effects.unit_error import FACTORS

Array = NDArray[np.float64]

_BLOCK_S = 2.0
_PARTS = 8  # of a block, whose means say how large the noise is
_LEAST = 60.0  # by how much χ² must fall
_SHARE = 0.05  # of χ² that may be left
_PER_MISTAKE = 2.0 * math.log(100.0)  # χ² by which two mistakes must explain more than one
_MISFIT = 0.1  # of the signal that may be left: other effects may be there too
_COINCIDENCE = 0.02  # how close a ratio must come to that of two units
_SHARP = 0.01  # share of itself within which it must be known, or anything may come as close
_STEP_COINCIDENCE = 0.001  # ... one of two steps
_ONE_RATE = 1e-3  # share by which sample rates may differ and be one
_NO_SCALE = 0.5  # logarithm of a ratio that is too large for a scale factor
_STEADY = 0.02  # share of itself by which an input that stands still may move
_ROUND = (2.0, 10.0, 1e3)  # ratios that steps have for other reasons too


@dataclass(frozen=True)
class Mistake:
    """A mistake of wiring: effect, channel, factor of a unit error, χ² that it explains (so d = √χ²)."""

    effect: str
    channel: str
    factor: float = 1.0
    explained: float = 0.0
    constant: bool = False
    """Whether the input stood still throughout, so that a shift of bias would look the same."""


def find_mistakes(scenes: list[Scene]) -> list[Mistake]:
    """Return the mistakes of wiring that all recordings show."""
    found = _stepped_units(scenes)
    scenes = [replace(scene, measured=mend(scene.measured, found)) for scene in scenes] if found else scenes
    for first in (0, 3):
        found += _mistakes(_Triad.of(scenes, first))
    return _whole_triads(found)


def _mistakes(triad: _Triad) -> list[Mistake]:
    """Return the mistakes of a triad."""
    found = []
    wires = triad.in_one_unit(_exchanged_both_ways(triad.in_pairs([triad.best(c) for c in range(3)])))
    explained = [triad.left(_Wire(c), c) - triad.left(wire, c) for c, wire in enumerate(wires)]
    for c, wire in enumerate(wires):
        channel = triad.names[c]
        if wire.source > c:
            pair = f"{channel}<-{triad.names[wire.source]}"
            found.append(Mistake("axis_swap", pair, 1.0, explained[c] + explained[wire.source], triad.steady))
        if wire.factor < 0.0:
            found.append(Mistake("sign_flip", channel, 1.0, explained[c], triad.steady))
        if abs(wire.factor) != 1.0:
            found.append(Mistake("unit_error", channel, abs(wire.factor), explained[c], triad.steady))
    return found


def _stepped_units(scenes: list[Scene]) -> list[Mistake]:
    """Return the unit errors by which channels' steps are off the stated ones in all recordings."""
    found = []
    for column, channel in enumerate(CHANNELS):
        known = FACTORS[channel.partition("_")[0]].values()
        ratios = [f for ratio in known if ratio not in _ROUND for f in (ratio, 1.0 / ratio)]
        times = [coarser(scene, column) for scene in scenes]
        for ratio in ratios:
            if all(step is not None and abs(step / ratio - 1.0) < _STEP_COINCIDENCE for step in times):
                explained = sum(_explained(scene, column, ratio) for scene in scenes)
                found.append(Mistake("unit_error", channel, ratio, max(explained, _LEAST), False))
    return found


def _explained(scene: Scene, column: int, factor: float) -> float:
    """Return by how much a factor of the unit lowers χ² of a channel's block means."""
    measured, predicted, sigma = (v[..., column % 3] for v in _block_means(scene, column - column % 3))
    off = np.square((measured - predicted) / sigma) - np.square((measured / factor - predicted) / (sigma / factor))
    return float(np.sum(off))


def _whole_triads(found: list[Mistake]) -> list[Mistake]:
    """Join the same unit error of all three sensors of a triad into one."""
    for triad in ("accel", "gyro"):
        same = [m for m in found if m.effect == "unit_error" and m.channel.startswith(triad)]
        if len(same) == 3 and len({m.factor for m in same}) == 1:
            joined = Mistake("unit_error", triad, same[0].factor, sum(m.explained for m in same), same[0].constant)
            found = [m for m in found if m not in same] + [joined]
    return found


def mend(rates: Array, mistakes: list[Mistake]) -> Array:
    """Return rates (n, 6) with the mistakes undone."""
    mended = rates.copy()
    for mistake in mistakes:
        names = [name for name in CHANNELS if name.startswith(mistake.channel.partition("<-")[0])]
        columns = [CHANNELS.index(name) for name in names]
        if mistake.effect == "unit_error":
            mended[:, columns] /= mistake.factor
        elif mistake.effect == "sign_flip":
            mended[:, columns] *= -1.0
    for mistake in mistakes:
        if mistake.effect == "axis_swap":
            on, _, by = mistake.channel.partition("<-")
            pair = [CHANNELS.index(on), CHANNELS.index(by)]
            mended[:, pair] = mended[:, pair[::-1]]
    return mended


@dataclass(frozen=True)
class _Wire:
    """What a sensor reads: which input of its triad, times what."""

    source: int
    factor: float = 1.0

    def times(self, ratio: float) -> _Wire:
        """Return the same with another ratio of units."""
        return _Wire(self.source, math.copysign(ratio, self.factor))


@dataclass(frozen=True)
class _Triad:
    """Block means (k, 3) of three sensors, measured and predicted, and their noise (k, 3).

    ``ratios`` are those of units that are mistaken, ``proportions`` (3,) of the noise as stated.
    """

    names: tuple[str, ...]
    measured: Array
    predicted: Array
    sigma: Array
    ratios: tuple[float, ...]
    proportions: Array

    @classmethod
    def of(cls, scenes: list[Scene], first: int) -> _Triad:
        """Look at one triad in all recordings."""
        blocks = [_block_means(scene, first) for scene in scenes]
        names = tuple(CHANNELS[first : first + 3])
        known = [*FACTORS[names[0].partition("_")[0]].values(), *_sample_rate(scenes)]
        return cls(
            names,
            np.vstack([m for m, _, _ in blocks]),
            np.vstack([p for _, p, _ in blocks]),
            np.vstack([np.broadcast_to(s, m.shape) for m, _, s in blocks]),
            tuple(f for ratio in known for f in (ratio, 1.0 / ratio)),
            proportions_of(scenes[0].model.noise, first),
        )

    @property
    def steady(self) -> bool:
        """Whether the input stood still throughout."""
        return bool(np.max(np.ptp(self.predicted, axis=0)) < _STEADY * np.max(np.abs(self.predicted)))

    def left(self, wire: _Wire, c: int) -> float:
        """Return χ² of what a sensor so wired leaves."""
        off = self.measured[:, c] - wire.factor * self.predicted[:, wire.source]
        return float(np.sum(np.square(off / self.sigma[:, c])))

    def misfit(self, wire: _Wire, c: int) -> float:
        """Return what it leaves, as a share of the signal's power, without the noise of both."""
        m, noise = self.measured[:, c], float(np.sum(self.sigma[:, c] ** 2))
        off = float(np.sum((m - wire.factor * self.predicted[:, wire.source]) ** 2))
        return (off - 2.0 * noise) / max(float(np.sum(m**2)) - noise, 1e-300)

    def tells(self, c: int) -> bool:
        """Whether a sensor's own input, as it is, leaves next to nothing of what it reads."""
        return self.left(_Wire(c), c) < _SHARE * self.left(_Wire(c, 0.0), c)

    def best(self, c: int) -> _Wire:
        """Return the wire that explains a sensor: its own, unless another leaves next to nothing of what that does.

        Of another's input that is next to nothing either sign does: that it is turned, too, must tell by itself.
        """
        own = self.left(_Wire(c), c)
        least, found = own, _Wire(c)
        for wire in self._wires(c):
            left = self.left(wire, c)
            fits = left < _SHARE * own and own - left > _LEAST and self.misfit(wire, c) < _MISFIT**2
            cost = left + (_LEAST if wire.factor < 0.0 and wire.source != c else 0.0)
            if fits and cost < least:
                least, found = cost, wire
        return found

    def in_pairs(self, wires: list[_Wire]) -> list[_Wire]:
        """Return wires with two sensors exchanged that each for itself seem wired otherwise, where that does as well.

        Of inputs that are opposite, two turned signs explain the same, and of each alone chance says which.
        """
        for a, b in itertools.combinations(range(3), 2):
            if wires[a] == _Wire(a) or wires[b] == _Wire(b):
                continue
            apart = self.left(wires[a], a) + self.left(wires[b], b)
            if self.left(_Wire(b), a) + self.left(_Wire(a), b) < apart + _PER_MISTAKE:
                wires = [{a: _Wire(b), b: _Wire(a)}.get(c, wire) for c, wire in enumerate(wires)]
        return wires

    def _wires(self, c: int) -> Iterator[_Wire]:
        """Yield what a sensor may read by mistake: another input, either sign, its own in a unit that it is near to."""
        for j in range(3):
            if np.any(self.predicted[:, j]):
                yield from (_Wire(j, sign) for sign in (1.0, -1.0) if (j, sign) != (c, 1.0))
        p = self.predicted[:, c]
        power = float(p @ p)
        if power == 0.0:
            return
        slope = float(self.measured[:, c] @ p) / power
        if float(np.mean(self.sigma[:, c])) / np.sqrt(power) < _SHARP * abs(slope):
            signed = (sign * ratio for ratio in self.ratios for sign in (1.0, -1.0))
            yield from (_Wire(c, factor) for factor in signed if abs(slope / factor - 1.0) < _COINCIDENCE)

    def in_one_unit(self, wires: list[_Wire]) -> list[_Wire]:
        """Give sensors that tell nothing else, or nearly the same, the unit of the one that tells its own best."""
        told = [c for c, wire in enumerate(wires) if wire.source == c and abs(wire.factor) != 1.0]
        if not told:
            return wires
        surest = max(told, key=lambda c: self.left(_Wire(c), c))
        near = [c for c in told if _near(wires[c].factor, wires[surest].factor)]

        def left(ratio: float) -> float:
            return sum(self.left(wires[c].times(ratio), c) for c in near)

        factor = min((ratio for ratio in self.ratios if _near(ratio, wires[surest].factor)), key=left)
        noisy = sharing(factor, near, np.mean(self.sigma, axis=0), self.proportions)
        alike = {*near, *(c for c in noisy if wires[c] == _Wire(c) and not self.tells(c))}
        return [wire.times(factor) if c in alike else wire for c, wire in enumerate(wires)]


def _near(one: float, other: float) -> bool:
    """Whether two factors are such that a sensor may take one for the other."""
    return abs(abs(one / other) - 1.0) < 2.0 * _COINCIDENCE


def _exchanged_both_ways(wires: list[_Wire]) -> list[_Wire]:
    """Return wires without half an exchange: it takes two."""
    return [wire if wires[wire.source].source == c else _Wire(c) for c, wire in enumerate(wires)]


def _sample_rate(scenes: list[Scene]) -> list[float]:
    """Return by what rates are larger than increments: the sample rate [Hz], if all have one that is far from 1."""
    rates = np.array([1.0 / scene.seen.interval_s for scene in scenes])
    one = np.ptp(rates) < _ONE_RATE * rates.min() and abs(math.log(rates[0])) > _NO_SCALE
    return [float(rates[0])] if one else []


def _block_means(scene: Scene, first: int) -> tuple[Array, Array, Array]:
    size = max(1, round(_BLOCK_S / scene.seen.interval_s))
    count = max(len(scene.measured) // size, 1)
    rows = slice(0, count * size)
    columns = slice(first, first + 3)
    # Shaking is predicted as the accelerometer that should feel it read it: no witness against an exchange of two.
    quiet = ~scene.shaking()[rows].reshape(count, -1).any(axis=1)
    kept = quiet if quiet.any() else ~quiet
    measured = scene.measured[rows, columns].reshape(count, -1, 3).mean(axis=1)[kept]
    predicted = scene.predicted[rows, columns].reshape(count, -1, 3).mean(axis=1)[kept]
    # Of means over parts of a block: most readings in coarse steps are the same as the next.
    part = max(1, size // _PARTS)
    residual = (scene.measured - scene.predicted)[: len(scene.measured) // part * part, columns]
    means = residual.reshape(-1, part, 3).mean(axis=1)
    noise = 1.4826 * np.median(np.abs(np.diff(means, 2, axis=0)), axis=0) / np.sqrt(6.0)
    sigma = np.maximum(noise * np.sqrt(part / size), 1e-7 * np.max(np.abs(predicted), initial=1e-12))
    return measured, predicted, sigma
