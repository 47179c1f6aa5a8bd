"""Does what the sequencer orders and takes long: asks the block, and has a side process estimate and write files."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import structlog

from drivers.commands import CommandError
from drivers.protocols.base import ProtocolError
from inertial.documents import StageTerms
from service.acquisition import Line
from service.config import Settings
from service.estimation import RunPlan, final_result, keep_recording, prepare, terms_so_far, write_result
from service.lane import Lane
from service.orders import AskBlock, Conclude, Estimate, Keep, Order, Reply
from service.recovery import recover
from service.run_folder import RunFolder
from service.side_process import ProcessDied, SideProcess
from service.store import Store

log = structlog.get_logger()

FACTS = {"identity": "identity", "read": "previous_terms"}
"""Questions whose answers belong to the run: who the block is, and the terms it held before."""


Piece = Order | Callable[[], object]


class Worker:
    """Takes orders and gives each its reply: questions to the block in one lane, all else in another.

    So nobody who asks the block waits for an estimate or a disk. What the one lane needs of the other, the sequencer
    orders only after the reply.

    Parameters
    ----------
    settings, store
        As the service has them.
    line
        To the block; None without one.
    reply
        Called from a lane's thread with what became of each order.
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
        self._plans: dict[str, RunPlan] = {}
        self._run_id: str | None = None
        self._facts: dict[str, Any] = {}
        self._side = SideProcess(partial(prepare, settings.log))
        self._questions: Lane[Piece] = Lane("questions", self._do)
        self._work: Lane[Piece] = Lane("worker", self._do)

    def start(self) -> None:
        """Begin to work."""
        self._side.start()
        self._questions.start()
        self._work.start()

    def stop(self, timeout_s: float = 20.0) -> None:
        """Finish what was ordered, then end; after ``timeout_s`` [real s] end without."""
        end_s = time.monotonic() + timeout_s
        lanes = (self._questions, self._work)
        for lane in lanes:
            lane.finish()
        for lane in lanes:
            lane.join(max(end_s - time.monotonic(), 0.0))
        self._side.stop()

    def plan(self, run_id: str, plan: RunPlan) -> None:
        """Say what a run is to do, before its first order comes."""
        self._questions.submit(lambda: self._ask_for(run_id))
        self._work.submit(lambda: self._plan_for(run_id, plan))

    def _ask_for(self, run_id: str) -> None:
        self._run_id, self._facts = run_id, {}

    def _plan_for(self, run_id: str, plan: RunPlan) -> None:
        self._plans = {run_id: plan}

    def recover(self, folder: RunFolder) -> None:
        """Have the recording of an interrupted run made of its capture."""
        known = self._settings
        self.submit(lambda: self._side.call(recover, folder, known.link, known.site, known.block, known.reference))

    @property
    def waiting(self) -> int:
        """How many orders wait."""
        return self._questions.waiting + self._work.waiting

    @property
    def busy_s(self) -> float:
        """How long [real s] the longest piece of work in hand has taken so far, 0 without one."""
        return max(self._questions.busy_s, self._work.busy_s)

    def submit(self, piece: Piece) -> None:
        """Queue an order, or any work that must keep its place among those that write files."""
        lane = self._questions if isinstance(piece, AskBlock) else self._work
        lane.submit(piece)

    def _do(self, piece: Piece) -> None:
        try:
            if callable(piece):
                piece()
            elif isinstance(piece, Keep) or self._is_wanted(piece.token):
                self._obey(piece)
        except Exception:
            log.exception("worker", order=type(piece).__name__)
            if isinstance(piece, AskBlock | Estimate | Conclude):
                self._reply(Reply(piece.token, _what(piece), error="a fault of the program; its log tells more"))

    def _obey(self, order: Order) -> None:
        try:
            if isinstance(order, AskBlock):
                self._reply(Reply(order.token, order.what, self._ask(order)))
            elif isinstance(order, Estimate):
                self._estimate(order)
            elif isinstance(order, Conclude):
                self._conclude(order)
                self._reply(Reply(order.token, "conclude"))
            else:
                self._side.call(keep_recording, self._plans[order.run_id], order)
        except ProtocolError as error:
            self._reply(Reply(_token(order), _what(order), error=str(error), unsupported=True))
        except (CommandError, ProcessDied, ValueError, OSError) as error:
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
        what, work = ("final", final_result) if order.final else ("partial", terms_so_far)
        self._reply(Reply(order.token, what, self._side.call(work, self._plans[order.run_id], order)))

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
        document = self._side.call(write_result, folder, result)
        self._store.save_result(order.run_id, document, result.verdict)


def _token(order: Order) -> int:
    return -1 if isinstance(order, Keep) else order.token


def _what(order: Order) -> str:
    if isinstance(order, AskBlock):
        return order.what
    if isinstance(order, Estimate):
        return "final" if order.final else "partial"
    return "conclude" if isinstance(order, Conclude) else "keep"
