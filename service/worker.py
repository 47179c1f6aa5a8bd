"""Does what the sequencer orders and takes long: asks the block, estimates, writes files. One thread, in order."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import structlog

from drivers.commands import CommandError
from drivers.protocols.base import ProtocolError
from drivers.recording import Recording, RecordingError, RecordingMeta
from inertial.documents import DocumentError, StageTerms
from service.acquisition import Line
from service.compensate import compensate, partial
from service.config import BlockSettings, ReferenceSettings, Settings
from service.errors import RefusedInput
from service.report import render
from service.run_folder import RunFolder, recording_meta, write_whole
from service.sequencer import AskBlock, Conclude, Estimate, Keep, Order, Reply
from service.store import Store

log = structlog.get_logger()

FACTS = {"identity": "identity", "read": "previous_terms"}
"""Questions whose answers belong to the run: who the block is, and the terms it held before."""
REFUSALS = (RecordingError, DocumentError, RefusedInput, ValueError, OSError)


@dataclass(frozen=True)
class RunPlan:
    """What a run was asked to do."""

    method: str
    reference: ReferenceSettings
    folder: RunFolder
    block: BlockSettings


class Worker:
    """Takes orders from a queue and gives each its reply.

    Parameters
    ----------
    settings, store
        As the service has them.
    line
        To the block; None without one.
    reply
        Called from this thread with what became of each order.
    is_wanted
        Whether anybody still waits for orders of a token; the others are passed over.
    conditions
        The go / no-go conditions now, which a result is kept with.
    """

    def __init__(
        self,
        settings: Settings,
        store: Store,
        line: Line | None,
        reply: Callable[[Reply], None],
        is_wanted: Callable[[int], bool],
        conditions: Callable[[], list[dict[str, Any]]],
    ) -> None:
        self._settings, self._store, self._line, self._reply = settings, store, line, reply
        self._is_wanted, self._conditions = is_wanted, conditions
        self._orders: queue.SimpleQueue[Order | Callable[[], None] | None] = queue.SimpleQueue()
        self._plans: dict[str, RunPlan] = {}
        self._run_id: str | None = None
        self._facts: dict[str, Any] = {}
        self._begun_s: float | None = None
        self._thread = threading.Thread(target=self._work, name="worker", daemon=True)

    def start(self) -> None:
        """Begin to work."""
        self._thread.start()

    def stop(self, timeout_s: float = 10.0) -> None:
        """Finish what was ordered, then end."""
        self._orders.put(None)
        self._thread.join(timeout_s)

    def plan(self, run_id: str, plan: RunPlan) -> None:
        """Say what a run is to do, before its first order comes."""
        self.submit(lambda: self._take_plan(run_id, plan))

    def _take_plan(self, run_id: str, plan: RunPlan) -> None:
        self._plans, self._run_id, self._facts = {run_id: plan}, run_id, {}

    @property
    def waiting(self) -> int:
        """How many orders wait."""
        return self._orders.qsize()

    @property
    def busy_s(self) -> float:
        """How long [real s] the piece of work in hand has taken so far, 0 without one."""
        begun_s = self._begun_s
        return time.monotonic() - begun_s if begun_s is not None else 0.0

    def submit(self, order: Order | Callable[[], None]) -> None:
        """Queue an order, or any piece of work that must keep its place among them."""
        self._orders.put(order)

    def _work(self) -> None:
        while (order := self._orders.get()) is not None:
            self._begun_s = time.monotonic()
            try:
                if callable(order):
                    order()
                elif isinstance(order, Keep) or self._is_wanted(order.token):
                    self._do(order)
            except Exception:
                log.exception("worker", order=type(order).__name__)
                if isinstance(order, AskBlock | Estimate | Conclude):
                    self._reply(Reply(order.token, _what(order), error="a fault of the program; its log tells more"))
            self._begun_s = None

    def _do(self, order: Order) -> None:
        try:
            if isinstance(order, AskBlock):
                self._reply(Reply(order.token, order.what, self._ask(order)))
            elif isinstance(order, Estimate):
                self._estimate(order)
            elif isinstance(order, Conclude):
                self._conclude(order)
                self._reply(Reply(order.token, "conclude"))
            else:
                self._keep(order)
        except ProtocolError as error:
            self._reply(Reply(_token(order), _what(order), error=str(error), unsupported=True))
        except (CommandError, *REFUSALS) as error:
            log.warning("order failed", order=_what(order), error=str(error))
            self._reply(Reply(_token(order), _what(order), error=str(error)))

    # ------------------------------------------------------------------ the block

    def _ask(self, order: AskBlock) -> Any:
        if self._line is None:
            raise CommandError(order.what, "the block", "no line is configured", "Set [link] url")
        answer = self._line.ask(order.what, order.terms)
        if order.what in FACTS and answer is not None:
            fact = answer.model_dump(mode="json") if isinstance(answer, StageTerms) else answer
            self._facts[FACTS[order.what]] = fact
            if self._run_id is not None:
                self._store.note_block(self._run_id, self._facts)
        return answer

    # ------------------------------------------------------------------ estimates and files

    def _estimate(self, order: Estimate) -> None:
        plan = self._plans[order.run_id]
        meta = self._meta(plan, order)
        if order.final:
            recording = plan.folder.write_recording(order.samples, meta)
            self._reply(Reply(order.token, "final", compensate(recording, method=plan.method)))
            return
        path = plan.folder.recording  # where the windows so far would stand; nothing is written for progress
        recording = Recording(samples=order.samples, meta=meta, path=path, meta_path=path.with_suffix(".toml"))
        self._reply(Reply(order.token, "partial", partial(recording, order.windows, method=plan.method)))

    def _meta(self, plan: RunPlan, order: Estimate | Keep) -> RecordingMeta:
        site = self._settings.site
        return recording_meta(site, plan.block, plan.reference, order.samples, order.windows, order.turns)

    def _conclude(self, order: Conclude) -> None:
        folder = self._plans[order.run_id].folder
        fit = order.state == "READY" and order.result.fit
        reasons = list(order.result.reasons)
        if not fit and order.result.fit:
            reasons.append(f"{order.reason}: the block did not take the terms")
        result = order.result.model_copy(
            update={
                "state": order.state,
                "fit": fit,
                "verdict": order.result.verdict if fit else "not fit",
                "reasons": reasons,
                "block": {**order.result.block, **self._facts},
                "conditions": {**order.result.conditions, "go_no_go": self._conditions()},
            }
        )
        document = result.canonical_json()
        write_whole(folder.result, document)
        write_whole(folder.report, render(result))
        self._store.save_result(order.run_id, document, result.verdict)

    def _keep(self, order: Keep) -> None:
        if len(order.samples) > 1:
            plan = self._plans[order.run_id]
            meta = self._meta(plan, order)
            plan.folder.write_recording(order.samples, meta)


def _token(order: Order) -> int:
    return -1 if isinstance(order, Keep) else order.token


def _what(order: Order) -> str:
    if isinstance(order, AskBlock):
        return order.what
    if isinstance(order, Estimate):
        return "final" if order.final else "partial"
    return "conclude" if isinstance(order, Conclude) else "keep"
