"""``/conditions``: go / no-go by named conditions, and taking note of a broken one."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Request

from service.api.common import ControllerHere, MayCommand, who_asks
from service.api.models import AcknowledgementNote, Condition, Conditions
from service.api.problems import ProblemError, responses
from service.conditions import CannotAcknowledge, UnknownCondition

router = APIRouter(prefix="/conditions", tags=["conditions"])


@router.get("")
def read_conditions(controller: ControllerHere) -> Conditions:
    """Tell every condition with its value, limit, cause and remedy."""
    return Conditions(**controller.conditions())


@router.post("/{name}/acknowledge", responses=responses(400, 404, 409, 413, 422, 423), dependencies=[MayCommand])
def acknowledge_condition(
    name: Annotated[str, Path(max_length=40)], body: AcknowledgementNote, request: Request, controller: ControllerHere
) -> Condition:
    """Take note of a broken condition; a warning then no longer speaks against going, and stays in the reasons."""
    try:
        controller.acknowledge_condition(name, who_asks(request, body.operator), body.reason)
    except UnknownCondition:
        detail = f"There is no condition {name!r}. GET /api/v1/conditions lists them."
        raise ProblemError(404, "unknown-condition", detail) from None
    except CannotAcknowledge as error:
        raise ProblemError(409, "not-allowed", f"{error}; there is nothing to acknowledge.") from None
    listed = controller.conditions()["conditions"]
    return Condition(**next(one for one in listed if one["name"] == name))
