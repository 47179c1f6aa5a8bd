"""Rounding errors that a readout in steps makes of the motion it was given, simulated."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from inertial.documents import ChannelNoise
from inertial.rounding import rounded_steps
from simulators.discrepancy.compare import Scene

Array = NDArray[np.float64]

_DRAWS = 40
NEAR_HZ = 2.0
"""By how much a line of the rounding errors may be elsewhere in what was measured."""


def rounding_errors(scene: Scene, column: int, noise: ChannelNoise) -> Iterator[Array]:
    """Yield records (n,) [y] as analysed of white noise and of the rounding errors that go with it, seeded.

    The mean motion is that of each turn and of what lies between two: noise of shorter stretches would be there twice.
    """
    per_step = scene.seen.interval_s / noise.quantisation
    sigma = noise.white / math.sqrt(scene.seen.interval_s) * per_step
    advance = np.repeat(scene.motion(column, stretches=1), scene.group) * per_step
    advance = np.pad(advance, (0, len(scene.time_s) - len(advance)), mode="edge")
    rng = np.random.default_rng(advance.size)
    for _ in range(_DRAWS):
        yield scene.analysed((rounded_steps(advance, sigma, rng) - advance) / per_step, column)


def largest_lines(scene: Scene, column: int, noise: ChannelNoise) -> tuple[Array, Array]:
    """Return frequencies [Hz] (m,) and the largest amplitude [y] (m,) of a line of rounding errors near each.

    A motion makes lines at its own frequencies; elsewhere its rounding errors are no more than noise.
    """
    hertz = largest = np.zeros(0)
    for errors in rounding_errors(scene, column, noise):
        hertz = np.asarray(np.fft.rfftfreq(errors.size, scene.interval_s))
        lines = 2.0 / errors.size * np.abs(np.fft.rfft(errors))
        largest = np.maximum(largest, lines) if largest.size else lines
    near = 2 * round(NEAR_HZ / hertz[1]) + 1
    return hertz, np.asarray(maximum_filter1d(largest, near, mode="nearest"))
