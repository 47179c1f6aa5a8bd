"""``/events``: state, progress, conditions and thinned samples as server-sent events."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Depends, Header, Query, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent

from service.api.common import ControllerHere, principal_of
from service.api.problems import ProblemError, responses

router = APIRouter(tags=["events"])


def room_for_one(controller: ControllerHere) -> None:
    """Refuse one stream too many before it begins."""
    limit = controller.settings.http.event_clients
    if len(controller.hub) >= limit:
        raise ProblemError(503, "too-many-streams", f"{limit} streams are open. Close one, or ask GET /status instead.")


@router.get(
    "/events",
    response_class=EventSourceResponse,
    responses=responses(422, 503),
    dependencies=[Depends(room_for_one)],
)
async def events(
    request: Request,
    controller: ControllerHere,
    limit: Annotated[int | None, Query(ge=1, le=1_000_000, description="End after so many events.")] = None,
    last_event_id: Annotated[str | None, Header(max_length=60, description="Go on after this event.")] = None,
) -> AsyncIterator[ServerSentEvent]:
    """Stream ``status`` (once), ``state``, ``progress``, ``condition``, ``lease``, ``samples``, ``heartbeat``."""
    principal = principal_of(request)
    token_id = principal.token_id if principal is not None else None
    stream = controller.hub.subscribe(after=last_event_id)
    yield ServerSentEvent(event="status", data=controller.status().facts, retry=1_000)
    sent = 1
    if limit is not None and sent >= limit:
        return
    async for event in stream:
        if token_id is not None and not request.app.state.access().tokens.holds(token_id):
            return
        yield ServerSentEvent(event=event.kind, data=event.data, id=controller.hub.id_of(event))
        sent += 1
        if limit is not None and sent >= limit:
            return
