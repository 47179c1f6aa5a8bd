"""``/lease``: who commands; the others watch."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Header, Request, Response

from service.api.common import ControllerHere, lease_problem, who_asks
from service.api.models import LeaseRenewal, LeaseRequest, LeaseState, LeaseTaken
from service.api.problems import ProblemError, responses
from service.lease import LeaseHeld, NoSuchLease

router = APIRouter(prefix="/lease", tags=["lease"])
LeaseId = Annotated[str, Header(min_length=1, max_length=100, description="As POST /lease gave it.")]


@router.get("")
def read_lease(controller: ControllerHere) -> LeaseState:
    """Tell who commands."""
    held = controller.leases.current()
    if held is None:
        return LeaseState(holder=None, left_s=None)
    return LeaseState(holder=held[0].holder, left_s=round(held[1], 1))


@router.post("", status_code=201, responses=responses(400, 409, 413, 422))
def acquire_lease(body: LeaseRequest, request: Request, controller: ControllerHere) -> LeaseTaken:
    """Take the lease: from now on only commands with its id are taken, until it ends or another takes it over."""
    who = who_asks(request, body.holder)
    try:
        lease, before = controller.acquire_lease(who, body.lasts_s, body.take_over, body.reason or "")
    except LeaseHeld as error:
        raise lease_problem(409, error) from None
    return LeaseTaken(lease_id=lease.id, holder=lease.holder, lasts_s=body.lasts_s, taken_over_from=before)


@router.put("", responses=responses(400, 409, 413, 422))
def renew_lease(body: LeaseRenewal, lease_id: LeaseId, controller: ControllerHere) -> LeaseTaken:
    """Keep the lease."""
    try:
        lease = controller.leases.renew(lease_id, body.lasts_s)
    except NoSuchLease as error:
        raise ProblemError(409, "lease-lost", f"{str(error).capitalize()}.") from None
    return LeaseTaken(lease_id=lease.id, holder=lease.holder, lasts_s=body.lasts_s)


@router.delete("", status_code=204, response_class=Response, responses=responses(409, 422))
def release_lease(lease_id: LeaseId, controller: ControllerHere) -> None:
    """Give the lease back."""
    try:
        controller.release_lease(lease_id)
    except NoSuchLease as error:
        raise ProblemError(409, "lease-lost", f"{str(error).capitalize()}.") from None
