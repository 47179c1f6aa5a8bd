"""The FastAPI application: thin routes over :class:`service.controller.Controller`."""

from __future__ import annotations

from importlib.metadata import version

from fastapi import FastAPI

from service.api import events, library, problems, runs, status
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
        max_body_size=MAX_BODY_BYTES,
        redirect_slashes=False,
    )
    app.state.controller = controller
    problems.install(app)
    for module in (status, runs, events, library):
        app.include_router(module.router, prefix="/api/v1")
    app.include_router(status.probes, prefix="/api/v1")
    app.include_router(status.probes, include_in_schema=False)
    return app
