"""Metrics in the Prometheus text format, made from what the service already counts."""

from __future__ import annotations

import math
from collections.abc import Iterator

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from drivers.clock import ClockFit
from service.controller import Controller
from service.states import Name

CONTENT_TYPE = CONTENT_TYPE_LATEST


class ServiceCollector(Collector):
    """Reads one controller each time it is asked."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    def collect(self) -> Iterator[Metric]:
        """Yield state, fitness, age of the newest frame and the line's counters."""
        facts = self._controller.status().facts
        state = GaugeMetricFamily("inertrim_state", "1 for the state the sequencer is in.", labels=["state"])
        for name in Name:
            state.add_metric([name.value], float(facts["state"] == name.value))
        yield state
        yield GaugeMetricFamily("inertrim_fit", "1 when the navigation data are fit.", value=float(facts["fit"]))
        age = facts["age_s"]
        yield GaugeMetricFamily(
            "inertrim_frame_age_seconds",
            "Age of the newest frame, NaN before the first.",
            value=float("nan") if age is None else age,
        )
        yield GaugeMetricFamily("inertrim_event_clients", "Clients on /events.", value=len(self._controller.hub))
        if self._controller.line is not None:
            for what, value in self._controller.line.counters().items():
                yield CounterMetricFamily(f"inertrim_line_{what}", f"Line counter {what}.", value=value)
            yield from self._clock(self._controller.line.link.clock())

    def _clock(self, fit: ClockFit | None) -> Iterator[Metric]:
        """Yield the block's clock against the host's, NaN before it is known."""
        values = [math.nan] * 4
        if fit is not None:
            values = [fit.skew, fit.skew_sigma, fit.offset_s, fit.sigma_s]
        texts = {
            "skew": "Seconds of the host per second of the block, less 1.",
            "skew_sigma": "1σ of the skew.",
            "offset_seconds": "Time of the service at the block's time 0.",
            "offset_sigma_seconds": "1σ of the offset, at the middle of its data.",
        }
        for (name, text), value in zip(texts.items(), values, strict=True):
            yield GaugeMetricFamily(f"inertrim_block_clock_{name}", text, value=value)


def exposition(controller: Controller) -> bytes:
    """Return all metrics as text."""
    registry = CollectorRegistry()
    registry.register(ServiceCollector(controller))
    return generate_latest(registry)
