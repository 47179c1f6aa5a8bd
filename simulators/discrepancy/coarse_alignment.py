"""Coarse alignment, where a recording's reference gives no level or no azimuth: levelling and gyrocompassing.

What is not given is free, but an error of attitude is linear only near by: it must begin near the truth.
Groves, *Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems* (2013), 5.6.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from simulators.discrepancy.repair import Repaired
from simulators.motion import Setup

Array = NDArray[np.float64]

_LEVELLED_S = 10.0
_STILL_RADPS = 1e-3  # rates below which a scale factor's error is nothing beside Earth's
_FEWEST = 100  # samples that are still, or all are taken
_BIAS_RADPS = 5e-5  # about the horizontal Earth rate
_LEAST_NOISE_RADPS = 1e-12
_ANGLES = 180  # tried in half a turn


def levelled(setup: Setup, data: Repaired) -> Setup:
    """Return the set-up with roll and pitch from the accelerometers' first ten seconds, before it first moves."""
    few = max(10, int(_LEVELLED_S / np.diff(data.edges_s).mean()))
    for motion in setup.motions:
        few = min(few, max(10, int(np.searchsorted(data.edges_s, motion.start_s))))
    up = np.median(data.rate[:few, :3], axis=0)
    if not np.linalg.norm(up) > 1.0:
        return setup
    up = up / np.linalg.norm(up)
    forward = setup.C_tb[0] - up * (setup.C_tb[0] @ up)
    forward /= np.linalg.norm(forward)
    return replace(setup, C_tb=np.array([forward, np.cross(up, forward), up]))


def azimuth_by_gyros(
    measured: Array, came: NDArray[np.bool_], predicted: Callable[[float], Array], noise: Array
) -> float:
    """Return the azimuth [rad] at which gyros read what they are predicted to, by weighted least squares.

    Biases are as unsure as a gyro is that knows nothing of north: what changes as the block turns counts for more.

    Parameters
    ----------
    measured : (n, 3) rad/s.
    came : (n,) the samples that were measured.
    predicted : gives the readings (n, 3) [rad/s] at an azimuth [rad]. They are linear in its cosine and sine.
    noise : 1σ of a single sample (3,) [rad/s].
    """
    north, east, south = (predicted(angle) for angle in (0.0, 0.5 * math.pi, math.pi))
    middle = 0.5 * (north + south)
    still = came & (np.max(np.abs(middle), axis=1) < _STILL_RADPS)
    rows = still if still.sum() >= _FEWEST else came
    columns = np.stack([north - middle, east - middle, measured - middle])[:, rows]  # (3, k, 3)
    mean = columns.mean(axis=1)
    turned = (columns - mean[:, None]) / np.maximum(noise, _LEAST_NOISE_RADPS)
    steady = mean / np.hypot(noise / math.sqrt(rows.sum()), _BIAS_RADPS)
    normal = np.einsum("iks,jks->ij", turned, turned) + steady @ steady.T

    def misfit(angle: float) -> float:
        point = np.array([math.cos(angle), math.sin(angle), -1.0])
        return float(point @ normal @ point)

    step = math.pi / _ANGLES
    near = min((step * place for place in range(2 * _ANGLES)), key=misfit)
    return float(minimize_scalar(misfit, (near - step, near, near + step)).x)
