"""All metrics of one service: what it counts, how it answers, what its process uses."""

from __future__ import annotations

from prometheus_client import (
    CONTENT_TYPE_LATEST,
    CollectorRegistry,
    GCCollector,
    ProcessCollector,
    disable_created_metrics,
    generate_latest,
)

from service.controller import Controller
from service.metrics.collector import ServiceCollector
from service.metrics.latency import latency_histogram

CONTENT_TYPE = CONTENT_TYPE_LATEST


class Metrics:
    """Registry of one controller and the application that serves it."""

    def __init__(self, controller: Controller) -> None:
        disable_created_metrics()  # type: ignore[no-untyped-call]  # a series beside each count that says when it began helps nobody here
        self._registry = CollectorRegistry()
        self._registry.register(ServiceCollector(controller))
        ProcessCollector(registry=self._registry)
        GCCollector(registry=self._registry)
        self.latency = latency_histogram(self._registry)

    def text(self) -> bytes:
        """Return all metrics in the Prometheus text format."""
        return generate_latest(self._registry)
