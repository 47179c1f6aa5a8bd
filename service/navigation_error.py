"""How far navigation at rest goes astray with a result's terms in, and without them; from the result alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from inertial.documents import Result
from service.budget import predicted
from service.errors import RefusedInput

AT_S = tuple(float(t) for t in range(15, 301, 15))


def navigation_error(result: Result) -> dict[str, Any]:
    """Return the radial error [m] over 300 s at rest: 50 and 95 % with the terms, and the mean without them.

    Without: to first order what the terms themselves would add, ``½·f·t² + (ω × g)·t³/6`` in the horizontal plane.
    Nulls where the result does not tell.
    """
    time_s = np.array(AT_S)
    without = _without(result, time_s)
    try:
        radial = predicted(result, AT_S)["radial_m"]
    except RefusedInput:
        radial = {"50": [None] * len(AT_S), "95": [None] * len(AT_S)}
    return {"time_s": list(AT_S), "with_50_m": radial["50"], "with_95_m": radial["95"], "without_m": without}


def _without(result: Result, time_s: np.ndarray[Any, np.dtype[np.float64]]) -> list[float]:
    C_tb = np.array(result.alignment["C_tb"])
    f = C_tb @ np.array(result.terms["final"].f_mps2)
    g = C_tb @ np.array(result.terms["final"].g_radps)
    up = np.array([0.0, 0.0, result.site["gravity_mps2"]])
    away = np.outer(time_s**2 / 2, f) + np.outer(time_s**3 / 6, np.cross(g, up))
    return [float(one) for one in np.hypot(away[:, 0], away[:, 1])]
