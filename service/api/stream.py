"""Server-sent events as a response that ends, and frees all it holds, when its client goes."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import aclosing
from dataclasses import dataclass
from typing import Any

import anyio
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

MEDIA_TYPE = "text/event-stream"
DOCUMENTED: dict[int | str, dict[str, Any]] = {200: {"description": "Server-sent events", "content": {MEDIA_TYPE: {}}}}
HEADERS = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}


@dataclass(frozen=True)
class Message:
    """One event as it is sent, its facts as JSON; ``retry_ms`` tells a browser how soon to come back."""

    kind: str
    text: str
    id: str | None = None
    retry_ms: int | None = None

    def encoded(self) -> bytes:
        """Return the event's text."""
        lines = [f"event: {self.kind}", f"data: {self.text}"]
        lines += [f"id: {self.id}"] if self.id is not None else []
        lines += [f"retry: {self.retry_ms}"] if self.retry_ms is not None else []
        return ("\n".join(lines) + "\n\n").encode()


class EventStream(Response):
    """Sends what a generator yields.

    The generator is closed in every case, also when the client goes while a write to it waits: one that stops reading
    and then leaves must not stay in anybody's list.
    """

    def __init__(self, messages: AsyncGenerator[Message]) -> None:
        super().__init__(media_type=MEDIA_TYPE, headers=HEADERS)
        del self.headers["content-length"]
        self._messages = messages

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send until the generator ends or the client goes."""
        del scope
        async with aclosing(self._messages) as messages, anyio.create_task_group() as tasks:
            tasks.start_soon(_until_gone, receive, tasks.cancel_scope)
            await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
            async for message in messages:
                await send({"type": "http.response.body", "body": message.encoded(), "more_body": True})
            await send({"type": "http.response.body", "body": b"", "more_body": False})
            tasks.cancel_scope.cancel()


async def _until_gone(receive: Receive, scope: anyio.CancelScope) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass
    scope.cancel()
