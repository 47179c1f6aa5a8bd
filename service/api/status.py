"""``/status``, and the probes that machines ask: ``/healthz``, ``/readyz``, ``/metrics``."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Header, Request, Response

from service.api.common import ControllerHere
from service.api.models import Health, Status
from service.api.problems import responses
from service.metrics import CONTENT_TYPE, Metrics

router = APIRouter(tags=["status"])
probes = APIRouter(tags=["probes"])


@router.get(
    "/status",
    response_model=Status,
    responses={304: {"description": "Not changed since that ETag"}, **responses(422)},
)
async def read_status(
    request: Request, if_none_match: Annotated[str | None, Header(max_length=200)] = None
) -> Response:
    """Tell the state now: made ahead, sent as it is."""
    published = request.app.state.controller.status()
    headers = {"ETag": published.etag, "Cache-Control": "no-cache"}
    if if_none_match is not None and published.etag in if_none_match:
        return Response(status_code=304, headers=headers)
    return Response(published.body, headers=headers, media_type="application/json")


@probes.get("/healthz", responses={503: {"model": Health}})
def healthz(controller: ControllerHere, response: Response) -> Health:
    """Tell whether the service lives."""
    reasons = controller.health()
    response.status_code = 503 if reasons else 200
    return Health(ok=not reasons, reasons=reasons)


@probes.get("/readyz", responses={503: {"model": Health}})
def readyz(controller: ControllerHere, response: Response) -> Health:
    """Tell whether a run could be started, as far as configuration, store and threads go."""
    reasons = controller.readiness()
    response.status_code = 503 if reasons else 200
    return Health(ok=not reasons, reasons=reasons)


@probes.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
def metrics(request: Request) -> Response:
    """Give all metrics to Prometheus (docs/metrics.md)."""
    made: Metrics = request.app.state.metrics
    return Response(made.text(), media_type=CONTENT_TYPE)
