"""Readings that a dead band wider than the noise silenced (IEEE 528): where, and how wide it is.

A silenced sample has lost its noise together with its input and would pass for one that is known without any. So the
width is read off, and all samples near the band are taken out. A band of the noise's own width is left to the search,
but in a readout of steps much finer than the noise: there what reads zero again and again, and never a little more, can
be nothing else.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from inertial.documents import CHANNELS
from simulators.discrepancy.compare import Scene
from simulators.discrepancy.dead_band_width import HalfWidth, half_width
from simulators.discrepancy.read_off import ReadOff
from simulators.discrepancy.resolution import last_place
from simulators.discrepancy.standing import longest_by_rounding, spoken_by_rounding, step_of
from simulators.discrepancy.whitening import FREE_SHARE

Array = NDArray[np.float64]

_NEARLY_ALL = 0.98  # of silent samples, and of those beyond: the others are so by their noise
_WIDER = 4.0  # σ of a sample that a band is wide at least
_CLEAR = 3.0  # σ from its edges where it silences all, or none
_FEWEST_ZEROS, _FEWEST_SILENT, _FEWEST_SPOKEN = 20, 300, 50
_SILENT, _SPOKEN = 0.98, 0.8  # share of samples that are silent within, and of those expected that are not, beyond
_EXPECTED = 100.0  # readings within that would be other than zero without a band
_FINE, _BESIDE, _TOO_MANY = 10.0, 30.0, 10.0  # steps that a hole is wide, readings beside it, times the zeros expected
_ABOUT, _UNLIKELY = 0.3, 1e-4  # by what share zeros may be more or fewer than a band makes; chance of one at an input
_RUNS = 10.0  # times as many samples within as chance keeps at zero in one run


def find_silenced(scene: Scene) -> tuple[Scene, list[ReadOff]]:
    """Return the scene with the samples in reach of a dead band marked missing, and the bands."""
    missing, found = scene.data.missing.copy(), []
    for column, channel in enumerate(CHANNELS):
        came = ~missing[:, column]
        silent = came & (scene.measured[:, column] == 0.0)
        if silent.sum() < _FEWEST_ZEROS or (came & ~silent).sum() < _FEWEST_SPOKEN:
            continue
        noise = _noise(scene, column, came & ~silent)
        about = _about(scene, column, silent, came, noise) or _about_hole(scene, column, silent, came)
        read = None if about is None else half_width([scene], channel, about[0])
        if about is not None and read is not None and _as_many(scene, column, silent, came, read):
            missing[came & _in_reach(scene, column, read.value, noise), column] = True
            found.append(ReadOff("dead_band", channel, read.value, read.sigma, about[1]))
    return (replace(scene, data=replace(scene.data, missing=missing)) if found else scene), found


def without_band(scene: Scene, band: ReadOff) -> Scene:
    """Return the scene with the samples in reach of a dead band, known of otherwise, marked missing."""
    column, missing = CHANNELS.index(band.channel), scene.data.missing.copy()
    missing[_in_reach(scene, column, band.value, float(scene.noise_sigma[column])), column] = True
    return replace(scene, data=replace(scene.data, missing=missing))


def _in_reach(scene: Scene, column: int, half_width: float, noise: float) -> NDArray[np.bool_]:
    return np.asarray(np.abs(scene.predicted[:, column]) < half_width + _CLEAR * noise)


def _about_hole(
    scene: Scene, column: int, silent: NDArray[np.bool_], came: NDArray[np.bool_]
) -> tuple[float, float] | None:
    """Return how wide the hole about zero is that readings leave [y], and the evidence for it [nats]; or none.

    Of a fine readout hardly a reading is zero, and about as many lie within any width of it.
    """
    size = np.abs(scene.measured[came & ~silent, column])
    step = step_of(scene.data.sent[came, column]) / scene.seen.interval_s
    hole = float(size.min())
    beside = float(np.count_nonzero(size < 2.0 * hole))  # as wide again, on either side
    expected = beside * max(step / hole, 1.0 / len(size))
    if hole < _FINE * step or beside < _BESIDE or silent.sum() < _TOO_MANY * expected:
        return None
    return hole, float(silent.sum() * math.log(silent.sum() / max(expected, 1.0)))


def _as_many(scene: Scene, column: int, silent: NDArray[np.bool_], came: NDArray[np.bool_], read: HalfWidth) -> bool:
    """Whether a band of such a width in such noise silences about as many samples as are silent, and no others."""
    inputs, noise = scene.predicted[:, column], read.noise.sigma
    share = ndtr((read.value - inputs) / noise) - ndtr((-read.value - inputs) / noise)
    expected, unlikely = float(np.sum(share[came])), np.count_nonzero(silent & (share < _UNLIKELY))
    many = float(silent.sum())
    return bool(abs(many - expected) < _ABOUT * expected and unlikely < (1.0 - _NEARLY_ALL) * many)


def _noise(scene: Scene, column: int, spoken: NDArray[np.bool_]) -> float:
    """Return the σ of a single sample's noise [y], or a little more: what has slow structure in it bends little.

    There are the rounding errors of the frame at least.
    """
    off = (scene.measured[:, column] - scene.predicted[:, column])[spoken]
    bends = 1.4826 * float(np.median(np.abs(np.diff(off, 2)))) / math.sqrt(6.0)
    found = min(float(scene.noise_sigma[column]), bends) if bends > 0.0 else float(scene.noise_sigma[column])
    return max(found, last_place(column) / scene.seen.interval_s)


def _about(
    scene: Scene, column: int, silent: NDArray[np.bool_], came: NDArray[np.bool_], noise: float
) -> tuple[float, float] | None:
    """Return about how wide a band is [y] and the evidence for it [nats]; none where there is none that is wide."""
    inputs, size = scene.predicted[:, column], np.abs(scene.predicted[:, column])
    step = getattr(scene.model.noise, CHANNELS[column]).quantisation / scene.seen.interval_s
    white = noise * (FREE_SHARE if scene.model.noise.free else 1.0)
    about = float(np.quantile(size[silent], _NEARLY_ALL))
    beyond = came & ~silent & (size > about)
    if beyond.sum() < _FEWEST_SPOKEN:
        return None
    about = 0.5 * (about + float(np.quantile(size[beyond], 1.0 - _NEARLY_ALL)))
    within, spoken = came & (size < about - _CLEAR * noise), came & (size > about + _CLEAR * noise)
    if about < _WIDER * noise or within.sum() < _FEWEST_SILENT or silent[within].mean() < _SILENT:
        return None
    expected, said = (spoken_by_rounding(inputs[rows], white, step) for rows in (within, spoken))
    if said < _FEWEST_SPOKEN or np.count_nonzero(~silent[spoken]) < _SPOKEN * said:
        return None
    by_chance = longest_by_rounding(white / step, came.size) if step else 0.0
    return (about, expected) if expected > _EXPECTED and within.sum() > _RUNS * by_chance else None
