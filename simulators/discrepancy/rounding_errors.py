"""Rounding errors that a readout in steps makes of the motion it was given, simulated."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from inertial.documents import ChannelNoise
from inertial.rounding import rounded_steps
from simulators.discrepancy.compare import Scene
from simulators.discrepancy.whitening import freely_rounded_hz

Array = NDArray[np.float64]

_DRAWS = 40


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


def largest_line(scene: Scene, column: int, noise: ChannelNoise) -> float:
    """Return the largest amplitude [y] of a line that rounding errors of the motion show, above what noise covers."""
    hidden_hz = freely_rounded_hz(noise, scene.interval_s)
    largest = 0.0
    for errors in rounding_errors(scene, column, noise):
        free = np.fft.rfftfreq(errors.size, scene.interval_s) > hidden_hz
        largest = max(largest, 2.0 / errors.size * float(np.max(np.abs(np.fft.rfft(errors))[free], initial=0.0)))
    return largest
