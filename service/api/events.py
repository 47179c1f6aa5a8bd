"""``/events``: state, progress and thinned samples as server-sent events."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.sse import EventSourceResponse, ServerSentEvent

from service.api.common import ControllerHere
from service.api.problems import responses

router = APIRouter(tags=["events"])


@router.get("/events", response_class=EventSourceResponse, responses=responses(422))
async def events(
    controller: ControllerHere,
    limit: Annotated[int | None, Query(ge=1, le=1_000_000, description="End after so many events.")] = None,
) -> AsyncIterator[ServerSentEvent]:
    """Stream ``status`` (once, at the beginning), ``state``, ``progress``, ``samples`` and ``heartbeat``."""
    stream = controller.hub.subscribe()
    yield ServerSentEvent(event="status", data=controller.status().facts, retry=2_000)
    sent = 1
    if limit is not None and sent >= limit:
        return
    async for event in stream:
        number = str(event.number) if event.number else None
        yield ServerSentEvent(event=event.kind, data=event.data, id=number)
        sent += 1
        if limit is not None and sent >= limit:
            return
