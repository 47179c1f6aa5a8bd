"""How long each route takes to answer, measured around the whole application."""

from __future__ import annotations

import time

from prometheus_client import CollectorRegistry, Histogram
from starlette.types import ASGIApp, Message, Receive, Scope, Send

BUCKETS_S = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0)
NO_ROUTE = "none"
"""Label of requests that no route takes, so that guessed paths make no new series."""


def latency_histogram(registry: CollectorRegistry) -> Histogram:
    """Return the histogram that :class:`LatencyMiddleware` fills."""
    return Histogram(
        "inertrim_http_request_duration_seconds",
        "Time from a request to the first byte of its answer.",
        labelnames=["method", "route", "code"],
        buckets=BUCKETS_S,
        registry=registry,
    )


class LatencyMiddleware:
    """Times requests by method, route and status code; a stream of events counts until it begins."""

    def __init__(self, app: ASGIApp, histogram: Histogram) -> None:
        self._app, self._histogram = app, histogram

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began_s = time.perf_counter()

        async def timed(message: Message) -> None:
            if message["type"] == "http.response.start":
                route = getattr(scope.get("route"), "path_format", NO_ROUTE)
                labels = (scope["method"], route, str(message["status"]))
                self._histogram.labels(*labels).observe(time.perf_counter() - began_s)
            await send(message)

        await self._app(scope, receive, timed)
