"""``/events``: state, progress, conditions and thinned samples as server-sent events."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from typing import Annotated

from fastapi import APIRouter, Depends, Header, Query, Request, Response

from service.api.common import ControllerHere, principal_of
from service.api.problems import ProblemError, responses
from service.api.stream import DOCUMENTED, EventStream, Message
from service.controller import Controller

router = APIRouter(tags=["events"])


async def room_for_one(controller: ControllerHere) -> None:
    """Refuse one stream too many before it begins."""
    limit = controller.settings.http.event_clients
    if len(controller.hub) >= limit:
        raise ProblemError(503, "too-many-streams", f"{limit} streams are open. Close one, or ask GET /status instead.")


@router.get(
    "/events",
    response_class=Response,
    responses={**DOCUMENTED, **responses(422, 503)},
    dependencies=[Depends(room_for_one)],
)
async def events(
    request: Request,
    controller: ControllerHere,
    limit: Annotated[int | None, Query(ge=1, le=1_000_000, description="End after so many events.")] = None,
    last_event_id: Annotated[str | None, Header(max_length=60, description="Go on after this event.")] = None,
) -> Response:
    """Stream ``status`` (once), ``state``, ``progress``, ``condition``, ``lease``, ``samples``, ``heartbeat``."""
    principal = principal_of(request)
    token_id = principal.token_id if principal is not None else None

    def valid() -> bool:
        return token_id is None or bool(request.app.state.access().tokens.holds(token_id))

    return EventStream(_messages(controller, last_event_id, limit, valid))


async def _messages(
    controller: Controller, after: str | None, limit: int | None, valid: Callable[[], bool]
) -> AsyncGenerator[Message]:
    hub, sent = controller.hub, 1
    yield Message("status", controller.status().body.decode(), retry_ms=1_000)
    if sent == limit:
        return
    async with aclosing(hub.subscribe(after=after)) as stream:
        async for event in stream:
            if not valid():
                return
            yield Message(event.kind, event.text, hub.id_of(event))
            sent += 1
            if sent == limit:
                return
