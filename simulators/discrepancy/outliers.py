"""Single wild samples (outliers), far beyond what even heavy-tailed noise does: taken out, and said.

A step that begins with one sample and ends with the next would explain such a one, and so would half of the library.
Where the motion changes by as much from sample to sample, a wild one may be the reference's own error, and stays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from inertial.documents import CHANNELS
from simulators.discrepancy.compare import Scene

Array = NDArray[np.float64]

_WILD = 15.0  # σ of the noise beyond which a sample is wild
_TAME = 5.0  # ... within which those beside it are
_STEPS = 3.0  # of the readout, as well
_MOST = 1e-3  # of all samples: what comes more often belongs to the block
_EDGE_S = 0.3  # about the ends of a turn


@dataclass(frozen=True)
class Outlier:
    """One sample of a sensor, ``sigmas`` of its noise off the median of those about it."""

    channel: str
    time_s: float
    sigmas: float


def find_outliers(scene: Scene) -> tuple[Scene, list[Outlier]]:
    """Return the scene with its wild samples marked missing, and which they were."""
    missing, found = scene.data.missing.copy(), []
    changing = scene.near_turn_ends(scene.time_s, _EDGE_S)
    for column, channel in enumerate(CHANNELS):
        wild, off, sigma = _wild(scene, column)
        moved = changing & (np.abs(off) <= _swing(scene, column))
        wild &= ~(missing[:, column] | moved | (scene.shaking() if column < 3 else False))
        if not 0 < wild.sum() <= _MOST * wild.size:
            continue
        missing[wild, column] = True
        places = np.flatnonzero(wild)
        found += [Outlier(channel, float(scene.time_s[place]), float(off[place] / sigma)) for place in places]
    return (replace(scene, data=replace(scene.data, missing=missing)) if found else scene), found


def _swing(scene: Scene, column: int) -> Array:
    """Return how far the input goes about each sample (n,) [y], as far as the ends of a turn may be off."""
    size = 2 * round(_EDGE_S / scene.seen.interval_s) + 1
    inputs = scene.predicted[:, column]
    return np.asarray(maximum_filter1d(inputs, size) - minimum_filter1d(inputs, size))


def _wild(scene: Scene, column: int) -> tuple[NDArray[np.bool_], Array, float]:
    """Return which samples (n,) stand alone, how far off each is [y], and the 1σ of the noise."""
    off = scene.measured[:, column] - scene.predicted[:, column]
    beside = np.lib.stride_tricks.sliding_window_view(np.pad(off, 2, mode="edge"), 5)
    off = off - np.median(beside, axis=1)
    noise = getattr(scene.model.noise, CHANNELS[column])
    came = off[~scene.data.missing[:, column]]  # not what a dead band has silenced, which has no noise
    spread = float(np.median(np.abs(came - np.median(came)))) * 1.4826 if came.size else 0.0
    sigma = max(float(scene.noise_sigma[column]), spread)
    size = np.abs(off) - _STEPS * noise.quantisation / scene.seen.interval_s
    around = np.maximum(np.roll(size, 1), np.roll(size, -1))
    if not 0.0 < sigma < math.inf:
        return np.zeros(off.size, dtype=np.bool_), off, sigma
    return (size > _WILD * sigma) & (around < _TAME * sigma), off, sigma
