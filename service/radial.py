"""The navigation error that terms undo, in closed form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from inertial.documents import Result


def radial_without(result: Result, time_s: Sequence[float]) -> list[float]:
    """Return the radial error [m] at rest without the terms, by time [s].

    To first order what the terms themselves add: ``½·f·t² + (g × up)·γ·t³/6`` in the horizontal plane, tangent axes,
    γ gravity.
    """
    if "C_tb" not in result.alignment:
        return [0.0] * len(time_s)
    time = np.array(time_s, dtype=np.float64)
    C_tb = np.array(result.alignment["C_tb"])
    f, g = (C_tb @ np.array(values) for values in (result.terms["final"].f_mps2, result.terms["final"].g_radps))
    gravity = np.array([0.0, 0.0, result.site["gravity_mps2"]])
    away = np.outer(time**2 / 2, f) + np.outer(time**3 / 6, np.cross(g, gravity))
    return [float(one) for one in np.hypot(away[:, 0], away[:, 1])]
