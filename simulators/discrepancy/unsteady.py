"""Noise that is not the same all the time: larger while the block turns, and hidden where it is shaken.

A sample that is noisier than those at rest is weighed down before anything is fitted. Along the axis of a vibration
only the mean is compared; the noise that this takes away is put back from the record's own stretch at rest, so that
the rest of the analysis may take the noise to be the same throughout.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct
from scipy.ndimage import median_filter

from inertial.documents import CHANNELS
from simulators.discrepancy.compare import Scene
from simulators.discrepancy.runs import runs
from simulators.discrepancy.second_differences import MEAN_SQUARE, ordinary_mean, second_differences
from simulators.discrepancy.whitening import cosine_basis

Array = NDArray[np.float64]

_BLOCK_S = 0.5  # noise of this time scale is looked at beside that of single samples
_EDGE_S = 0.3  # about the ends of a turn, where timing errors look like noise
_SIGNIFICANT = 1.35
_SIGMA = 0.9  # of ln of a mean size of second differences, times the root of their number
_CERTAIN = 4.0  # σ by which noise must be larger
_FEWEST = 24
_BANDS, _AROUND = 20, 3  # of the spectrum of noise, and how many a level is the median of
_SCATTER = 4.3  # variance of ln of a band's level, times the number of its frequencies: tapering doubles it
_STEP_NATS = 6.0  # that a step of the level must explain
_LEAST = 1e-6  # of what is stated
_FEWEST_EACH = 3  # block means for each input that may act on them
_SEEN = 1e-6  # of the largest input's bend


def level_spread(scene: Scene, channel: int) -> tuple[Array, Array]:
    """Return residual (n,) [y] as analysed, and by how much its noise exceeds that at rest (n,), 1 or more."""
    raw = scene.measured[:, channel] - scene.predicted[:, channel]
    residual = scene.analysed(raw, channel)
    spread = np.ones(len(residual))
    still, moving = _regimes(scene, channel, len(residual))
    if not any(rows.any() for rows in moving):
        return residual, spread
    residual = residual + _hidden_noise(scene, channel, residual, still)
    block = max(1, round(_BLOCK_S / scene.interval_s))
    white = math.isinf(scene.freely_rounded_hz(channel))
    blocks = (1, block) if white else (block,)  # the rounding of single samples is another in each motion
    inputs = _inputs(scene, channel)
    for rows in moving:
        if rows.sum() < _FEWEST or still.sum() < _FEWEST:
            continue
        ratios = [1.0]
        for block in blocks:
            calm, busy = _noise(residual, still, block), _noise(residual, rows, block, inputs)
            if calm is not None and busy is not None and calm > 0.0:
                sigma = _SIGMA * math.sqrt(block / still.sum() + block / rows.sum())
                if busy / calm > max(_SIGNIFICANT, math.exp(_CERTAIN * sigma)):
                    ratios.append(busy / calm)
        spread[rows] = max(ratios)
    return residual, spread


def _regimes(scene: Scene, channel: int, n: int) -> tuple[NDArray[np.bool_], list[NDArray[np.bool_]]]:
    """Return where a channel was measured at rest, and where while it turned and while it was shaken, as analysed."""
    came = ~scene.data.missing[: n * scene.group, channel].reshape(n, scene.group).any(axis=1)
    time_s = scene.time_s[: n * scene.group].reshape(n, scene.group)[:, -1] - 0.5 * scene.interval_s
    turning, edge = scene.turning(time_s), scene.near_turn_ends(time_s, _EDGE_S)
    shaking = scene.shaking()[: n * scene.group].reshape(n, scene.group).any(axis=1)
    return came & ~(turning | shaking | edge), [came & turning & ~edge, came & shaking & ~edge]


def _inputs(scene: Scene, channel: int) -> Array:
    """Return what acts on the sensors, and products of two of them (n, 27), as analysed."""
    sensed = np.hstack([scene.seen.accel_mps2, scene.seen.gyro_radps])
    sensed = sensed / np.maximum(np.max(np.abs(sensed), axis=0), 1e-300)
    first, second = np.triu_indices(sensed.shape[1])
    acting = np.hstack([sensed, sensed[:, first] * sensed[:, second]])
    return np.column_stack([scene.analysed(column, channel) for column in acting.T])


def _noise(values: Array, rows: NDArray[np.bool_], block: int, inputs: Array | None = None) -> float | None:
    """Return the noise of block means: the ordinary size of their second differences.

    What ``inputs`` (n, k) that change within a few blocks explain of them is no noise.
    """
    if rows.sum() < _FEWEST * block:
        return None
    bends = second_differences(values[rows], block)
    freedom = 1.0
    if block > 1 and inputs is not None:
        known = second_differences(inputs[rows], block)[:, : max(1, len(bends) // _FEWEST_EACH)]
        size, _, rank, _ = np.linalg.lstsq(known, bends, rcond=_SEEN)
        bends = bends - known @ size
        freedom = 1.0 - int(rank) / len(bends)
    return float(ordinary_mean(np.abs(bends))) / math.sqrt(freedom)


def _hidden_noise(scene: Scene, channel: int, residual: Array, still: NDArray[np.bool_]) -> Array:
    """Return noise (n,) of the kind at rest, where the vibration's own course has been taken out along with it."""
    n = len(residual)
    put_back = np.zeros(n)
    if channel >= 3:
        return put_back
    still = still if still.sum() >= _FEWEST else np.ones(n, dtype=np.bool_)
    moved = scene.motion(channel)
    level = _level(_tapered(residual, still), _stated(scene, channel, moved[still]), scene.interval_s)
    random = np.random.default_rng(n)
    for rows, axis in scene.vibrations:
        shaken = rows[: n * scene.group].reshape(n, scene.group).any(axis=1)
        if axis[channel] and shaken.any():
            power = np.interp(np.arange(n) / n, *level) * _resized(_stated(scene, channel, moved[shaken]), n)
            noise = idct(np.sqrt(power) * random.standard_normal(n), norm="ortho")[shaken]
            put_back[shaken] += abs(float(axis[channel])) * (noise - noise.mean())
    return put_back


def _tapered(values: Array, still: NDArray[np.bool_]) -> Array:
    """Return the values at rest, each stretch less its mean, for attitudes differ, and faded in and out.

    A strong line would leak all over the spectrum from where stretches are joined.
    """
    faded = []
    for first, end in zip(*runs(still), strict=True):
        window = np.sin(math.pi * (np.arange(end - first) + 0.5) / (end - first)) ** 2
        faded.append(math.sqrt(8.0 / 3.0) * window * (values[first:end] - values[first:end].mean()))
    return np.concatenate(faded)


def _stated(scene: Scene, channel: int, moved: Array) -> Array:
    """Return the power (m,) of the noise that the model states for a channel moved so (m,); one if it states none."""
    basis = cosine_basis(len(moved), scene.interval_s)
    power = basis.each(basis.stated(getattr(scene.model.noise, CHANNELS[channel]), 0.0, moved))
    return power if power.all() else np.ones(len(moved))


def _resized(power: Array, n: int) -> Array:
    """Return power (n,) at n frequencies of the same band."""
    return np.interp(np.arange(n) / n, np.arange(len(power)) / len(power), power)


def _level(quiet: Array, stated: Array, interval_s: float) -> tuple[Array, Array]:
    """Return at shares of the band by how much noise at rest is more than stated, less its lines.

    These stand in the columns that explain them; and what is slow at rest may be no noise, so that below a band of
    single blocks it is taken for as much more as there.
    """
    power = np.square(dct(quiet, norm="ortho")) / stated
    first = max(1, min(round(2.0 * interval_s / _BLOCK_S * len(power)), len(power) // 4))
    bands = min(_BANDS, max(1, (len(power) - first) // _FEWEST))
    edges = np.unique(np.round(np.geomspace(first, len(power), bands + 1)).astype(np.int64))
    level = np.array([ordinary_mean(power[a:b]) for a, b in itertools.pairwise(edges)]) / MEAN_SQUARE
    level = median_filter(np.log(np.maximum(level, _LEAST)), _AROUND, mode="nearest")  # what one band has is a line
    stepped = _in_steps(level, np.diff(edges) / _SCATTER)
    return 0.5 * (edges[1:] + edges[:-1]) / len(power), np.exp(stepped)


def _in_steps(level: Array, weight: Array, mean: float = 0.0) -> Array:
    """Return levels (m,) of one over variance ``weight`` (m,) with no more steps than they show, from ``mean`` on.

    A band of few frequencies tells its own level by a fifth: noise put back at that would pass for larger noise.
    """
    total, count = np.cumsum(weight), np.cumsum(weight * level)
    own = float(count[-1] / total[-1])
    if 0.5 * total[-1] * (own - mean) ** 2 < _STEP_NATS:
        own = mean
    if level.size == 1:
        return np.array([own])
    left, right = count[:-1] / total[:-1], (count[-1] - count[:-1]) / (total[-1] - total[:-1])
    gains = 0.5 * (total[:-1] * (left - own) ** 2 + (total[-1] - total[:-1]) * (right - own) ** 2)
    at = int(np.argmax(gains)) + 1
    if gains[at - 1] < _STEP_NATS:
        return np.full(level.size, own)
    return np.concatenate([_in_steps(level[:at], weight[:at], own), _in_steps(level[at:], weight[at:], own)])
