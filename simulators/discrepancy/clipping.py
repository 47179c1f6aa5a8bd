"""Readings that stood at a limit while the input went beyond it (saturation, IEEE 528): where, and at which limit.

A clipped sample has lost its noise together with its input, so it weighs like none of the others: the limit is read
off, and the samples are taken out. That the reading stands still shows where the input goes on changing, or, where it
does not, by the noise that is gone. One that is clipped now and then, by its noise alone, is left to the search, and
its samples are taken out when it has been named: their rounding errors would be lines.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from inertial.documents import CHANNELS
from simulators.discrepancy.compare import Scene
from simulators.discrepancy.read_off import ReadOff
from simulators.discrepancy.resolution import last_place
from simulators.discrepancy.runs import runs
from simulators.discrepancy.standing import longest_by_rounding
from simulators.discrepancy.whitening import FREE_SHARE

Array = NDArray[np.float64]

_WINDOW = 10  # samples averaged, so that the rounding of an integral hardly shows
_FEWEST = 30  # samples beyond the limit
_BEYOND = 3.0  # σ by which the input must exceed the limit, and vary while it does
_STANDS = 0.95  # share of those samples that stand at the limit
_WITHIN = 1.5  # steps that rounding may take a sum of readings off a line
_RESOLUTION = 0.1  # of a sample's white noise: no readout that is said to have no steps is finer for this
_FOLLOWS = 0.5  # slope of reading over input: one on which the input acts has 1, one at its limit 0


def find_clipped(scene: Scene) -> tuple[Scene, list[ReadOff]]:
    """Return the scene with the samples at a limit marked missing, and the limits."""
    missing, found = scene.data.missing.copy(), []
    for column, channel in enumerate(CHANNELS):
        noise = getattr(scene.model.noise, channel)
        step = max(noise.quantisation, last_place(column)) / scene.seen.interval_s
        came = ~missing[:, column]
        clipped = _clipped(scene, column, came, step)
        if clipped is not None:
            limit, sigma, nats, rows = clipped
            missing[rows, column] = True
            found.append(ReadOff("saturation", channel, limit, sigma, nats))
    return (replace(scene, data=replace(scene.data, missing=missing)) if found else scene), found


def without_limit(scene: Scene, limit: ReadOff) -> Scene:
    """Return the scene with the samples that a limit, known of otherwise, may have touched marked missing."""
    column, missing = CHANNELS.index(limit.channel), scene.data.missing.copy()
    missing[np.abs(scene.predicted[:, column]) > limit.value - _BEYOND * scene.noise_sigma[column], column] = True
    return replace(scene, data=replace(scene.data, missing=missing))


def _clipped(
    scene: Scene, column: int, came: NDArray[np.bool_], step: float
) -> tuple[float, float, float, NDArray[np.bool_]] | None:
    """Return limit, σ, evidence [nats] and the samples that it touches; none without a limit."""
    measured, predicted = scene.measured[:, column], scene.predicted[:, column]
    size, inputs = np.abs(measured), np.abs(predicted)
    noise = float(np.median(np.abs(np.diff(measured - predicted, 2)))) * 1.4826 / math.sqrt(6.0)
    smooth = np.abs(uniform_filter1d(measured, _WINDOW, mode="nearest"))
    rounding = step / _WINDOW
    largest = came & (inputs >= np.quantile(inputs[came], 1.0 - _FEWEST / max(came.sum(), _FEWEST)))
    limit = float(np.median(size[largest]))
    # What a limit does to slow noise, single samples hardly show.
    coarse, white = max(noise, step), max(min(noise, float(scene.noise_found[column])), _RESOLUTION * step)
    beyond = came & (inputs > limit + _BEYOND * white)
    # Not those where the input comes or goes within the window.
    inner = beyond & (uniform_filter1d(beyond.astype(np.float64), _WINDOW, mode="nearest") > 1.0 - 0.5 / _WINDOW)
    if inner.sum() < _FEWEST:
        return None
    varies = np.ptp(inputs[inner]) >= _BEYOND * coarse
    if not varies and not _lost_its_noise(scene, column, inner):
        return None
    limit = float(np.mean(size[inner]))
    stands = np.abs(smooth[inner] - limit) < 2.0 * rounding + 0.3 * noise / math.sqrt(_WINDOW)
    if stands.mean() < _STANDS or (varies and np.polyfit(inputs[inner], smooth[inner], 1)[0] > _FOLLOWS):
        return None
    rows = came & (inputs > limit - _BEYOND * white)
    nats = 0.5 * float(np.sum(((inputs - size)[inner] / coarse) ** 2))
    return limit, max(rounding, noise / math.sqrt(inner.sum())), nats, rows


def _lost_its_noise(scene: Scene, column: int, rows: NDArray[np.bool_]) -> bool:
    """Whether the sum over the longest run of rows keeps to a line within rounding, as noise never would."""
    first, end = max(zip(*runs(rows), strict=True), key=lambda run: int(run[1] - run[0]))
    readings = scene.measured[first:end, column]
    noise, interval_s = getattr(scene.model.noise, CHANNELS[column]), scene.seen.interval_s
    white = noise.white * math.sqrt(interval_s) * (FREE_SHARE if scene.model.noise.free else 1.0)
    step = max(noise.quantisation, _RESOLUTION * white)
    if white == 0.0 or end - first < longest_by_rounding(white / step, rows.size):
        return False
    total = interval_s * np.cumsum(readings - readings.mean())
    place = np.arange(total.size)
    return bool(np.ptp(total - np.polyval(np.polyfit(place, total, 1), place)) < _WITHIN * step)
