"""What the service already counts, read each time somebody asks."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.registry import Collector

from drivers.clock import ClockFit
from inertial.documents import Result, StageTerms
from service.controller import Controller
from service.states import Name

LINE_COUNTERS = {
    "bytes_in": ("received_bytes", "Bytes off the line that reached the decoder."),
    "bytes_discarded": ("discarded_bytes", "Bytes that belong to no whole frame."),
    "bytes_dropped": ("dropped_bytes", "Bytes that were read and never decoded: the queue was full."),
    "frames": ("frames", "Whole frames whose checksum holds."),
    "crc_failures": ("crc_failures", "Frames with a right header and a wrong checksum."),
    "resyncs": ("resyncs", "Frames found after bytes had to be discarded."),
    "timeouts": ("timeouts", "Headers whose frame did not come in time."),
    "decode_rejects": ("decode_rejects", "Whole frames that say nothing the protocol knows."),
    "samples": ("samples", "Samples decoded."),
    "gaps": ("gaps", "Places where the frame counter stepped too far."),
    "frames_lost": ("frames_lost", "Frames that those steps passed over."),
    "duplicates": ("duplicates", "Samples that came twice; the second was dropped."),
    "restarts": ("block_restarts", "Times that the block began to count anew."),
    "queue_drops": ("queue_drops", "Chunks dropped, oldest first, because nobody decoded them in time."),
    "openings": ("openings", "Times that the port was opened."),
    "open_failures": ("open_failures", "Times that the port could not be opened."),
    "disconnections": ("disconnections", "Times that an open port was lost."),
    "capture_failures": ("capture_failures", "Times that the raw capture could not be written and was given up."),
}
"""Each count of the line: its name here, and what it counts."""


class ServiceCollector(Collector):
    """Reads one controller each time it is asked."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    def collect(self) -> Iterator[Metric]:
        """Yield every metric; one whose value is not known now is NaN, and one of no run is absent."""
        facts = self._controller.status().facts
        yield InfoMetricFamily("inertrim_build", "The program.", value={"version": version("inertrim")})
        yield from _state(facts)
        yield from self._judgement(facts)
        yield from self._service()
        if self._controller.line is not None:
            for what, value in self._controller.line.counters().items():
                name, text = LINE_COUNTERS[what]
                yield CounterMetricFamily(f"inertrim_line_{name}", text, value=value)
            yield from _clock(self._controller.line.link.clock())

    def _judgement(self, facts: dict[str, Any]) -> Iterator[Metric]:
        """Yield the conditions and what the run in hand has found."""
        broken = GaugeMetricFamily(
            "inertrim_condition_broken", "1 while a go / no-go condition is broken.", labels=["condition", "severity"]
        )
        for one in self._controller.conditions()["conditions"]:
            broken.add_metric([one["name"], one["severity"]], float(one["state"] in ("failed", "acknowledged")))
        yield broken
        run_id = facts["run_id"]
        yield from _terms(self._controller.terms(run_id) if run_id is not None else {})
        yield from _verification(self._controller.result_in_hand())

    def _service(self) -> Iterator[Metric]:
        """Yield what tells whether the service itself keeps up."""
        controller = self._controller
        waiting = GaugeMetricFamily("inertrim_queue_items", "What waits to be done.", labels=["queue"])
        for queue, count in controller.waiting().items():
            waiting.add_metric([queue], count)
        yield waiting
        yield GaugeMetricFamily("inertrim_event_clients", "Clients on /events.", value=len(controller.hub))
        yield GaugeMetricFamily(
            "inertrim_acquisition_silence_seconds",
            "Time since the acquisition thread last finished a turn.",
            value=controller.silence_s(),
        )
        yield GaugeMetricFamily(
            "inertrim_worker_busy_seconds",
            "Time that the piece of work in hand has taken so far, 0 without one.",
            value=controller.busy_s(),
        )
        changes = CounterMetricFamily(
            "inertrim_transitions", "Changes of state, by the state they led to.", labels=["target"]
        )
        for target in Name:
            changes.add_metric([target.value], controller.transitions_made[target.value])
        yield changes
        yield CounterMetricFamily(
            "inertrim_store_failures", "Writes that the store did not take.", value=controller.store_failures
        )
        free = shutil.disk_usage(controller.settings.store.path.parent).free
        yield GaugeMetricFamily("inertrim_disk_free_bytes", "Space left beside the store.", value=free)


def _state(facts: dict[str, Any]) -> Iterator[Metric]:
    state = GaugeMetricFamily("inertrim_state", "1 for the state the sequencer is in.", labels=["state"])
    for one in Name:
        state.add_metric([one.value], float(facts["state"] == one.value))
    yield state
    yield GaugeMetricFamily("inertrim_fit", "1 when the navigation data are fit.", value=float(facts["fit"]))
    for name, key, text in (
        ("stage_progress_ratio", "progress", "Share of the step in hand that is done, NaN where it has no end."),
        ("stage_remaining_seconds", "remaining_s", "Time that the step in hand still takes, NaN where unknown."),
        ("frame_age_seconds", "age_s", "Age of the newest frame, NaN before the first."),
    ):
        yield GaugeMetricFamily(f"inertrim_{name}", text, value=math.nan if facts[key] is None else facts[key])


def _terms(stages: dict[str, Any]) -> Iterator[Metric]:
    """Yield the terms of the run in hand by stage and axis."""
    accel = GaugeMetricFamily(
        "inertrim_accel_term_meters_per_second_squared",
        "Term f of eq. (8), added to the reading, by stage.",
        labels=["stage", "axis"],
    )
    gyro = GaugeMetricFamily(
        "inertrim_gyro_term_radians_per_second",
        "Term g of eq. (9), added to the reading, by stage.",
        labels=["stage", "axis"],
    )
    for stage, found in stages.items():
        terms = StageTerms.model_validate(found)
        for axis, f, g in zip("xyz", terms.f_mps2, terms.g_radps, strict=True):
            accel.add_metric([stage, axis], f)
            gyro.add_metric([stage, axis], g)
    yield accel
    yield gyro


def _verification(result: Result | None) -> Iterator[Metric]:
    """Yield the verification's χ² beside its limit."""
    found = (result.verification if result is not None else None) or {}
    for name, key, text in (
        ("chi_squared", "chi_square", "χ² of the verification of the run in hand, NaN before it."),
        ("chi_squared_limit", "limit", "What that χ² may be at most."),
    ):
        yield GaugeMetricFamily(f"inertrim_verification_{name}", text, value=found.get(key, math.nan))


def _clock(fit: ClockFit | None) -> Iterator[Metric]:
    """Yield the block's clock against the host's, NaN before it is known."""
    values = [math.nan] * 4
    if fit is not None:
        values = [fit.skew, fit.skew_sigma, fit.offset_s, fit.sigma_s]
    texts = {
        "skew_ratio": "Seconds of the host per second of the block, less 1.",
        "skew_sigma_ratio": "1σ of the skew.",
        "offset_seconds": "Time of the service at the block's time 0.",
        "offset_sigma_seconds": "1σ of the offset, at the middle of its data.",
    }
    for (name, text), value in zip(texts.items(), values, strict=True):
        yield GaugeMetricFamily(f"inertrim_block_clock_{name}", text, value=value)
