"""The slow course of an accelerometer while it is shaken along its axis, of which the mean alone is compared.

A random walk goes on meanwhile. Left at its mean it would jump where the vibration begins and where it ends, as no walk
does: slope and bend of what is hidden are taken to be any, as far as the vibration was large.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from simulators.discrepancy.compare import Scene

Array = NDArray[np.float64]

_ORDERS = 1, 2  # of Legendre polynomials: with the mean, they lead from what was before to what comes after


def hidden_courses(scene: Scene) -> list[tuple[int, Array, float]]:
    """Return channel, course (n,) of no mean, about 1 at its ends, and its σ [m/s²], of each that may be hidden."""
    found = []
    for rows, axis in scene.vibrations:
        place = np.linspace(-1.0, 1.0, int(rows.sum()))
        for channel in np.flatnonzero(axis):
            sigma = float(np.std(scene.shaken[rows, channel]))
            for order in _ORDERS if sigma > 0.0 else ():
                course = np.zeros(scene.time_s.size)
                values = legendre.legval(place, np.eye(order + 1)[order])
                course[rows] = values - values.mean()
                found.append((int(channel), course, sigma))
    return found
