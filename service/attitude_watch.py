"""Whether the block stands as it stood when it was aligned."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from drivers.samples import SampleArray

Vector = NDArray[np.float64]


class AttitudeWatch:
    """Compares the block's attitude with the one it was aligned at.

    Tilt is the angle between the mean specific force then and now. Heading is the turn about that axis that the gyros
    have summed since, less what they read at rest (Earth rate and bias). A turn while frames were lost shows in the
    tilt alone.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the reference."""
        self._up: Vector | None = None
        self._rest_rad = np.zeros(3)
        self._turned_rad = np.zeros(3)

    def set_reference(self, aligned: SampleArray) -> None:
        """Take the samples of the alignment window as the attitude to keep."""
        force = aligned["dv"].sum(axis=0)
        self._up = force / np.linalg.norm(force)
        self._rest_rad = aligned["dtheta"].mean(axis=0)
        self._turned_rad = np.zeros(3)

    def feed(self, samples: SampleArray) -> None:
        """Sum what the gyros turned beyond their reading at rest; frames that are missing count as rest."""
        if self._up is not None:
            self._turned_rad += samples["dtheta"].sum(axis=0) - self._rest_rad * len(samples)

    def turned_deg(self, recent: SampleArray) -> float:
        """Return the larger of tilt and heading change [deg] since the reference, given recent samples at rest."""
        if self._up is None:
            return 0.0
        force = recent["dv"].sum(axis=0)
        force /= np.linalg.norm(force)
        tilt = math.atan2(float(np.linalg.norm(np.cross(self._up, force))), float(self._up @ force))
        return math.degrees(max(tilt, abs(float(self._turned_rad @ self._up))))
