"""What every route needs: the controller, who is asking, and the run that is meant."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Header, Path, Request

from service.api.problems import ProblemError
from service.controller import Controller, KeyReused, NotConfigured, UnknownRun
from service.lease import LeaseHeld, NoSuchLease
from service.security.tokens import Principal
from service.sequencer import NotAllowed


async def controller_of(request: Request) -> Controller:
    """Return the controller that the application serves.

    A coroutine, as every dependency that waits for nothing: plain functions are called in a thread, and changing
    threads twice costs a request more than all else.
    """
    controller: Controller = request.app.state.controller
    return controller


def principal_of(request: Request) -> Principal | None:
    """Return who asks, as the gate found out."""
    found: Principal | None = request.state.principal
    return found


def who_asks(request: Request, operator: str | None) -> str:
    """Return the name that goes into the audit: the token's, with the operator's where he gives one.

    Without tokens: the operator's, or the address the request came from.
    """
    principal = principal_of(request)
    if principal is not None and principal.how != "local":
        return principal.name if operator in (None, principal.name) else f"{operator} ({principal.name})"
    return operator or f"anonymous at {request.client.host if request.client is not None else 'unknown address'}"


async def may_command(
    controller: Annotated[Controller, Depends(controller_of)],
    lease_id: Annotated[str | None, Header(max_length=100, description="Of the lease, while one is held.")] = None,
) -> None:
    """Refuse a command while another console holds the lease."""
    try:
        controller.leases.check(lease_id)
    except LeaseHeld as error:
        raise lease_problem(423, error) from None
    except NoSuchLease as error:
        raise ProblemError(409, "lease-lost", f"{str(error).capitalize()}.") from None


def lease_problem(status: int, error: LeaseHeld) -> ProblemError:
    """Return what is answered where another console commands."""
    detail = f"{error}. Watch, wait, or take the lease over with a reason."
    return ProblemError(status, "lease-held", detail, holder=error.lease.holder, left_s=round(error.left_s, 1))


MayCommand = Depends(may_command)


ControllerHere = Annotated[Controller, Depends(controller_of)]
RunId = Annotated[str, Path(description="Id of a run, as POST /runs gave it.", max_length=40)]


def as_problem(error: Exception) -> ProblemError:
    """Return what a refused command answers with."""
    if isinstance(error, NotAllowed):
        return ProblemError(409, "not-allowed", f"{error}.", state=error.state.value, allowed=error.allowed)
    if isinstance(error, NotConfigured):
        return ProblemError(409, "not-configured", f"{error}.", allowed=[])
    if isinstance(error, KeyReused):
        return ProblemError(422, "idempotency-key-reused", f"{error}. Use a new key for a new request.")
    if isinstance(error, UnknownRun):
        return ProblemError(404, "unknown-run", f"There is no run {error.args[0]!r}. GET /api/v1/runs lists them.")
    raise error


REFUSALS = (NotAllowed, NotConfigured, KeyReused, UnknownRun)
