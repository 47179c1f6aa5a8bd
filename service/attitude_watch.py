"""Whether the block stands as it stood when it was aligned, and if not, how it was turned."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.samples import SampleArray

Vector = NDArray[np.float64]
LONGEST_GAP_S = 0.2
"""Frames missing for longer than this may hide a turn."""


@dataclass(frozen=True)
class AttitudeChange:
    """How the block was turned since it was aligned.

    ``rotation_rad`` (3,): rotation vector in body axes, C_tb now = C_tb then · R. ``seen``: no frames were missing for
    long, so the heading is known as well as the tilt.
    """

    tilt_rad: float
    heading_rad: float
    rotation_rad: Vector
    seen: bool


class AttitudeWatch:
    """Compares the block's attitude with the one it was aligned at.

    Tilt comes from the mean specific force then and now, in which biases cancel; heading from what the gyros have
    turned since, less what they read at rest (Earth rate and bias).
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the reference."""
        self._up: Vector | None = None
        self._rest_rad = np.zeros(3)
        self._turned = Rotation.identity()
        self._last_s = math.nan
        self._seen = True

    def set_reference(self, aligned: SampleArray) -> None:
        """Take the samples of the alignment window as the attitude to keep."""
        self._up = _direction(aligned["dv"])
        self._rest_rad = aligned["dtheta"].mean(axis=0)
        self._turned = Rotation.identity()
        self._seen = True

    def feed(self, samples: SampleArray) -> None:
        """Add what the gyros turned beyond their reading at rest; frames that are missing count as rest."""
        if self._up is not None:
            rest = self._rest_rad * len(samples)
            self._turned = self._turned * Rotation.from_rotvec(samples["dtheta"].sum(axis=0) - rest)
            steps_s = np.diff(samples["time"], prepend=self._last_s)
            self._seen = self._seen and not np.any(steps_s > LONGEST_GAP_S)
        self._last_s = float(samples["time"][-1])

    def change(self, recent: SampleArray) -> AttitudeChange:
        """Return the change of attitude since the reference, given recent samples at rest."""
        if self._up is None:
            return AttitudeChange(0.0, 0.0, np.zeros(3), True)
        now = _direction(recent["dv"])  # R · now = up
        levelled = _least_turn(self._turned.apply(now), self._up) * self._turned
        least = _least_turn(now, self._up)
        heading = (levelled * least.inv()).as_rotvec() @ self._up
        return AttitudeChange(float(least.magnitude()), abs(float(heading)), levelled.as_rotvec(), self._seen)


def _direction(dv: Vector) -> Vector:
    force = np.asarray(dv.sum(axis=0), dtype=np.float64)
    return np.asarray(force / np.linalg.norm(force))


def _least_turn(first: Vector, second: Vector) -> Rotation:
    """Return the smallest rotation that takes one unit vector to another."""
    axis = np.cross(first, second)
    sine = float(np.linalg.norm(axis))
    angle = math.atan2(sine, float(first @ second))
    return Rotation.from_rotvec(axis * (angle / sine) if sine > 0 else np.zeros(3))
