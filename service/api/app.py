"""The FastAPI application: thin routes over :class:`service.controller.Controller`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from typing import Any

from fastapi import FastAPI

from service.api import discrepancies, events, library, problems, runs, status
from service.controller import Controller

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
    problems.install(app, MAX_BODY_BYTES)
    for module in (status, runs, events, library, discrepancies):
        app.include_router(module.router, prefix="/api/v1")
    app.include_router(status.probes, prefix="/api/v1")
    app.include_router(status.probes, include_in_schema=False)
    app.openapi = partial(_document, app, app.openapi)  # type: ignore[method-assign]
    return app


def _document(app: FastAPI, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return the OpenAPI document with the schema that the error responses name."""
    if app.openapi_schema is None:
        schema = problems.Problem.model_json_schema(ref_template="#/components/schemas/{model}")
        make().setdefault("components", {}).setdefault("schemas", {})["Problem"] = schema
    assert app.openapi_schema is not None
    return app.openapi_schema
