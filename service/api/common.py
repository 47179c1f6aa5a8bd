"""What every route needs: the controller, who is asking, and the run that is meant."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Path, Request

from service.api.problems import ProblemError
from service.controller import Controller, KeyReused, NotConfigured, UnknownRun
from service.sequencer import NotAllowed


def controller_of(request: Request) -> Controller:
    """Return the controller that the application serves."""
    controller: Controller = request.app.state.controller
    return controller


def who_asks(request: Request, operator: str | None) -> str:
    """Return the name that goes into the audit: the operator's, or the address the request came from."""
    return operator or f"anonymous at {request.client.host if request.client is not None else 'unknown address'}"


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
