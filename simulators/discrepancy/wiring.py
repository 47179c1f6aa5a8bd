"""Mistakes of wiring, before anything subtle: sensors exchanged, signs turned, units mistaken.

Block means of each channel are held against every input of its triad, with either sign and the ratios of units that
happen; a mistake is found where it explains what is measured and the channel's own input does not. A readout whose step
is the stated one times the ratio of two units is in the other unit, however little the input has to say.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from inertial.documents import CHANNELS
from simulators.discrepancy.compare import Scene
from simulators.discrepancy.resolution import coarser
from simulators.effects.unit_error import FACTORS

Array = NDArray[np.float64]

_BLOCK_S = 2.0
_PARTS = 8  # of a block, whose means say how large the noise is
_LEAST = 60.0  # by how much χ² must fall
_SHARE = 0.05  # of χ² that may be left
_MISFIT = 0.1  # of the signal that may be left: other effects may be there too
_COINCIDENCE = 0.02  # how close a ratio must come to that of two units
_SHARP = 0.01  # share of itself within which it must be known, or anything may come as close
_STEP_COINCIDENCE = 0.001  # ... one of two steps
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
        sources, factors, explained, steady = _best(scenes, first)
        for c in range(3):
            source, factor = sources[c], factors[c]
            channel = CHANNELS[first + c]
            if source > c and sources[source] == c:
                pair = f"{channel}<-{CHANNELS[first + source]}"
                found.append(Mistake("axis_swap", pair, 1.0, explained[c] + explained[source], steady))
            if source != c and sources[source] != c:
                continue
            if factor < 0.0:
                found.append(Mistake("sign_flip", channel, 1.0, explained[c], steady))
            if abs(factor) != 1.0:
                found.append(Mistake("unit_error", channel, abs(factor), explained[c], steady))
    return _whole_triads(found)


def _stepped_units(scenes: list[Scene]) -> list[Mistake]:
    """Return the unit errors by which channels' steps are off the stated ones in all recordings."""
    found = []
    ratios = [f for ratio in FACTORS.values() if ratio not in _ROUND for f in (ratio, 1.0 / ratio)]
    for column, channel in enumerate(CHANNELS):
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


def _best(scenes: list[Scene], first: int) -> tuple[list[int], list[float], list[float], bool]:
    """Return for each sensor of a triad the source and factor that explain it, and by how much better than its own."""
    blocks = [_block_means(scene, first) for scene in scenes]
    measured = np.vstack([m for m, _, _ in blocks])
    predicted = np.vstack([p for _, p, _ in blocks])
    sigma = np.vstack([np.broadcast_to(s, m.shape) for m, _, s in blocks])
    steady = bool(np.max(np.ptp(predicted, axis=0)) < _STEADY * np.max(np.abs(predicted)))
    ratios = [1.0] + [f for ratio in FACTORS.values() for f in (ratio, 1.0 / ratio)]
    sources, factors, explained = [], [], []
    for c in range(3):
        m, s = measured[:, c], sigma[:, c]
        own = float(np.sum(((m - predicted[:, c]) / s) ** 2))
        best = (own, c, 1.0)
        for j in range(3):
            p = predicted[:, j]
            power = float(np.sum(p**2))
            if power == 0.0:
                continue
            slope = float(m @ p) / power
            sharp = float(np.mean(s)) / np.sqrt(power) < _SHARP * abs(slope)
            for factor in (sign * ratio for ratio in ratios for sign in (1.0, -1.0)):
                plain = j == c and factor == 1.0
                is_unit = j == c and sharp and abs(slope / factor - 1.0) < _COINCIDENCE
                if plain or (abs(factor) != 1.0 and not is_unit):
                    continue
                left = float(np.sum(((m - factor * p) / s) ** 2))
                noise = float(np.sum(s**2))
                misfit = (float(np.sum((m - factor * p) ** 2)) - 2.0 * noise) / max(float(np.sum(m**2)) - noise, 1e-300)
                fits = left < _SHARE * own and own - left > _LEAST and misfit < _MISFIT**2
                if fits and left < best[0]:
                    best = (left, j, factor)
        sources.append(best[1])
        factors.append(best[2])
        explained.append(own - best[0])
    for c in range(3):  # an exchange takes two
        if sources[c] != c and sources[sources[c]] != c:
            sources[c], factors[c] = c, 1.0
    return sources, factors, explained, steady


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
