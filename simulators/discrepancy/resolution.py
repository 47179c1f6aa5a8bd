"""The step in which a sensor is read out (IEEE 528: resolution), as the increments themselves show it.

A readout in steps sends whole numbers of them. What the spectrum says of the step depends on the noise model; that all
increments lie on one lattice does not.
"""

from __future__ import annotations

from drivers.protocols.native import DTHETA_LSB_RAD, DV_LSB_MPS
from inertial.documents import CHANNELS
from inertial.rounding import increment_step
from simulators.discrepancy.compare import Scene

AS_STATED = 0.02
"""By how much a step may differ from the one that the model states and be the same."""


def last_place(column: int) -> float:
    """Return the step in which a frame counts a channel's increments [y·s]."""
    return DV_LSB_MPS if column < 3 else DTHETA_LSB_RAD


def coarser(scene: Scene, column: int) -> float | None:
    """Return how many times the step that the model states a channel's readout has, None where either is unknown."""
    stated = getattr(scene.model.noise, CHANNELS[column]).quantisation
    if not stated:
        return None
    came = ~scene.data.missing[:, column]
    found = increment_step(scene.data.sent[came, column], last_place(column))
    return None if found is None else found[0] / stated
