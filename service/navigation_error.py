"""How far navigation at rest goes astray with a result's terms in, and without them; from the result alone."""

from __future__ import annotations

from typing import Any

from inertial.documents import Result
from service.budget import predicted
from service.errors import RefusedInput
from service.radial import radial_without

AT_S = tuple(float(t) for t in range(15, 301, 15))


def navigation_error(result: Result) -> dict[str, Any]:
    """Return the radial error [m] over 300 s at rest: 50 and 95 % with the terms, and the mean without them.

    Nulls where the result does not tell.
    """
    without = radial_without(result, AT_S)
    try:
        radial = predicted(result, AT_S)["radial_m"]
    except RefusedInput:
        radial = {"50": [None] * len(AT_S), "95": [None] * len(AT_S)}
    return {"time_s": list(AT_S), "with_50_m": radial["50"], "with_95_m": radial["95"], "without_m": without}
