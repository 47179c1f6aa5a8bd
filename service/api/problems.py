"""Every error as RFC 9457 ``application/problem+json``."""

from __future__ import annotations

from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from sqlalchemy.exc import DatabaseError
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MEDIA_TYPE = "application/problem+json"


class Problem(BaseModel):
    """What went wrong and what can be done (RFC 9457)."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str
    allowed: list[str] | None = None
    state: str | None = None
    holder: str | None = None
    left_s: float | None = None
    errors: list[dict[str, Any]] | None = None


class ProblemError(Exception):
    """An error that an endpoint answers with."""

    def __init__(
        self, status: int, kind: str, detail: str, headers: Mapping[str, str] | None = None, **facts: Any
    ) -> None:
        super().__init__(detail)
        self.status, self.kind, self.detail, self.facts, self.headers = status, kind, detail, facts, headers


def responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI entries of an endpoint's errors."""
    return {
        status: {
            "description": HTTPStatus(status).phrase,
            "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
        }
        for status in statuses
    }


def answer(
    status: int, detail: str, kind: str = "about:blank", headers: Mapping[str, str] | None = None, **facts: Any
) -> JSONResponse:
    """Return one problem as a response."""
    problem = {"type": kind, "title": HTTPStatus(status).phrase, "status": status, "detail": detail, **facts}
    return JSONResponse(problem, status, headers=dict(headers or {}), media_type=MEDIA_TYPE)


class BodyLimit:
    """Refuses a body that is too large: at once where it says so, else as soon as it shows."""

    def __init__(self, app: ASGIApp, max_bytes: int) -> None:
        self._app, self._max_bytes = app, max_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on what is small enough."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        detail = f"The body is larger than {self._max_bytes} bytes."
        announced = dict(scope["headers"]).get(b"content-length", b"")
        if announced.isdigit() and int(announced) > self._max_bytes:
            await answer(413, detail)(scope, receive, send)
            return
        taken = 0

        async def counted() -> Message:
            nonlocal taken
            message = await receive()
            taken += len(message.get("body", b""))
            if taken > self._max_bytes:
                raise HTTPException(413, detail)
            return message

        await self._app(scope, counted, send)


def install(app: FastAPI, max_body_bytes: int) -> None:
    """Make the application answer every error as a problem."""
    app.add_middleware(BodyLimit, max_bytes=max_body_bytes)

    @app.exception_handler(ProblemError)
    async def known(_request: Request, error: ProblemError) -> JSONResponse:
        return answer(error.status, error.detail, f"urn:inertrim:problem:{error.kind}", error.headers, **error.facts)

    @app.exception_handler(HTTPException)
    async def http(request: Request, error: HTTPException) -> JSONResponse:
        detail = {
            400: "The body is not JSON in UTF-8.",
            404: f"There is nothing at {request.url.path}.",
            405: f"{request.method} is not possible at {request.url.path}.",
        }.get(error.status_code, str(error.detail))
        return answer(error.status_code, detail, headers=error.headers)

    @app.exception_handler(RequestValidationError)
    async def invalid(_request: Request, error: RequestValidationError) -> JSONResponse:
        errors = [
            {"place": ".".join(str(part) for part in one["loc"]), "message": one["msg"]} for one in error.errors()
        ]
        first = errors[0] if errors else {"place": "request", "message": "not valid"}
        return answer(
            422, f"{first['place']}: {first['message']}", "urn:inertrim:problem:invalid-request", errors=errors
        )

    @app.exception_handler(OSError)
    @app.exception_handler(DatabaseError)
    async def disk(_request: Request, error: OSError | DatabaseError) -> JSONResponse:
        reason = str(error.orig if isinstance(error, DatabaseError) else error.strerror)
        detail = f"The service could not keep what this takes ({reason}). See to its disk, then ask again."
        return answer(503, detail, "urn:inertrim:problem:store-unavailable")

    @app.exception_handler(Exception)
    async def unexpected(_request: Request, _error: Exception) -> JSONResponse:
        return answer(500, "The service met a fault of its own; its log tells more.")
