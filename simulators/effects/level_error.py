"""Level error: the stated attitude is tilted against the true level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from inertial.attitude import rotation_matrix
from simulators.effects.base import Array, ChannelKind, Occasion, Parameter, Range, SetupEffect
from simulators.motion import Motion, Setup, Turn, Vector


class LevelError(SetupEffect):
    """True attitude = R(tilt) · stated one, tilt a rotation vector about tangent axes 1 and 2.

    ``rides`` = 0: the error stays with the room (a tilted level reference), so axes fixed in the room tilt with it;
    1: it rides with the block (its case is tilted against its sensors), so the block's own axes do.
    """

    name = "level_error"
    text = "The launcher's level is not the one stated."
    term = "level reference error"
    channels = ChannelKind.BLOCK
    parameters = (
        Parameter("tilt_1", "rad", "about tangent axis 1", {"any": Range(1e-5, 1e-2)}),
        Parameter("tilt_2", "rad", "about tangent axis 2", {"any": Range(1e-5, 1e-2)}),
        Parameter("rides", "1", "0 stays with the room, 1 rides with the block", {"any": Range(0.0, 1.0)}),
    )
    shown_by = "rest at two headings a known angle apart"
    source = "0.001 deg (electronic level) to 0.5 deg (by eye)"

    def arrange(self, setup: Setup, occasion: Occasion) -> Setup:
        """Tilt the attitude and the axes that belong to what is tilted."""
        tilt = rotation_matrix(np.array([occasion.values["tilt_1"], occasion.values["tilt_2"], 0.0]))
        C_tb = tilt @ setup.C_tb
        if occasion.values["rides"]:
            moved, turned = "body", C_tb.T @ setup.C_tb
        else:
            moved, turned = "tangent", tilt
        motions = tuple(_tilted(motion, moved, turned) for motion in setup.motions)
        return replace(setup, C_tb=C_tb, motions=motions)


def _tilted(motion: Motion, moved: str, turned: Array) -> Motion:
    if not isinstance(motion, Turn) or motion.frame != moved:
        return motion
    x, y, z = (float(v) for v in turned @ np.asarray(motion.axis, dtype=np.float64))
    axis: Vector = (x, y, z)
    return replace(motion, axis=axis)


EFFECT = LevelError()
