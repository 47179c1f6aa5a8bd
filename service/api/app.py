"""The FastAPI application: thin routes over :class:`service.controller.Controller`."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from http import HTTPStatus
from importlib.metadata import version
from typing import Any

from fastapi import FastAPI

from service.api import (
    ageing,
    conditions,
    discrepancies,
    events,
    lease,
    library,
    pages,
    problems,
    records,
    runs,
    session,
    status,
)
from service.api.gate import Access, Gate
from service.api.headers import SecurityHeaders
from service.controller import Controller
from service.metrics import Metrics
from service.metrics.latency import LatencyMiddleware
from service.security import roles

MAX_BODY_BYTES = 64 * 1024


def create_app(controller: Controller) -> FastAPI:
    """Return the application of one controller; starting and stopping the controller is the caller's."""
    app = FastAPI(
        title="inertrim",
        version=version("inertrim"),
        description="Trims a strapdown inertial navigation block on its launcher, and says whether its data are fit.",
        openapi_url="/api/v1/openapi.json",
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
    )
    app.state.controller = controller
    app.state.metrics = Metrics(controller)
    app.state.access = cache(lambda: Access(controller.tokens, controller.settings.http))
    problems.install(app, MAX_BODY_BYTES)
    app.add_middleware(Gate, access=app.state.access)
    app.add_middleware(SecurityHeaders)
    for module in (status, runs, events, library, discrepancies, conditions, lease, session, records, ageing):
        app.include_router(module.router, prefix="/api/v1")
    app.include_router(pages.router)
    app.include_router(status.probes, prefix="/api/v1")
    app.include_router(status.probes, include_in_schema=False)
    app.add_middleware(LatencyMiddleware, histogram=app.state.metrics.latency)  # outermost: the last one added
    app.openapi = partial(_document, app, app.openapi)  # type: ignore[method-assign]
    return app


def _document(app: FastAPI, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return the OpenAPI document with the schema that the error responses name."""
    if app.openapi_schema is None:
        schema = problems.Problem.model_json_schema(ref_template="#/components/schemas/{model}")
        make().setdefault("components", {}).setdefault("schemas", {})["Problem"] = schema
        assert app.openapi_schema is not None
        for path, methods in app.openapi_schema["paths"].items():
            for method, operation in methods.items():
                _add_no_http(operation["responses"])
                if roles.needed(method.upper(), path) is not None:
                    operation["responses"].update(_gate_responses())
    assert app.openapi_schema is not None
    return app.openapi_schema


def _add_no_http(responses: dict[str, Any]) -> None:
    """Add what the server answers before there is a request: its headers were no valid HTTP."""
    entry = responses.setdefault("400", {"description": HTTPStatus.BAD_REQUEST.phrase, "content": {}})
    entry["content"]["text/plain"] = {"schema": {"type": "string"}}


def _gate_responses() -> dict[str, Any]:
    """Return what the gate may answer before any endpoint is reached."""
    return {str(status): entry for status, entry in problems.responses(401, 403, 429).items()}
