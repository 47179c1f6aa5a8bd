"""The running service behind the API: the sequencer under one lock, fed by acquisition, its outcomes recorded."""

from __future__ import annotations

import hashlib
import json
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import structlog

from drivers.timebase import Timebase
from inertial.documents import BlockModel, Noise, Result, parse_document
from service import motion_watch
from service.acquisition import Acquisition, Line
from service.conditions import Board, CannotAcknowledge
from service.conditions.gather import Gatherer
from service.config import BlockSettings, ReferenceSettings, SequenceSettings, Settings
from service.discrepancy_desk import DiscrepancyDesk
from service.estimation import RunPlan
from service.events import EventHub
from service.lease import Lease, LeaseDesk, LeaseHeld
from service.logs import correlate
from service.model_choice import ModelChoice
from service.motion_watch import MotionWatch
from service.native_memory import trim
from service.orders import Reply
from service.run_folder import RunFolder
from service.security.tokens import Tokens
from service.sequencer import LineView, NotAllowed, Sequencer
from service.states import Name
from service.store import RunRecord, Store, TransitionRecord, utc_now
from service.thinning import Thinner
from service.worker import Worker

log = structlog.get_logger()

SNAPSHOT_EVERY_S = 0.05
PROGRESS_EVERY_S = 0.2
SAMPLES_EVERY_S = 0.2
"""Real seconds between events of each kind."""
RECORD_AGAIN_S = 1.0
"""Real seconds before a change of state that the store did not take is offered again."""
HOST_PATIENCE_S = 5.0
"""Real seconds that power-up and self-test get at least, however fast simulated time runs."""
ALWAYS_SHOWN = "sample_rate:"
"""Condition that no state names for itself, and that an operator must know of before a run ends unfit."""
HANGS_AFTER_S = 300.0
"""Real seconds after which a piece of work (an estimate, a write) hangs: a disk or database does not answer."""
DEAD_AFTER_S = 2.0
"""Real seconds without a sign of life of the acquisition thread after which nothing it said counts."""


class NotConfigured(Exception):
    """A run cannot start because a setting is missing; the text says which."""


class UnknownRun(Exception):
    """There is no such run."""


class KeyReused(Exception):
    """An idempotency key came again with another request."""


@dataclass(frozen=True)
class Published:
    """A status as it is sent: bytes, entity tag, facts, and when [monotonic s] it was made."""

    body: bytes
    etag: str
    facts: dict[str, Any]
    made_s: float


def publish(facts: dict[str, Any]) -> Published:
    """Return a status ready to be sent."""
    body = json.dumps(facts, separators=(",", ":"), allow_nan=False).encode()
    return Published(body, f'"{hashlib.blake2b(body, digest_size=12).hexdigest()}"', facts, time.monotonic())


class Controller:
    """Everything that runs: store, line, sequencer, worker, events.

    Methods may be called from any thread. Commands are serialised; none of them waits for the block.
    """

    def __init__(self, settings: Settings, beat: Callable[[], None] = lambda: None) -> None:
        self.settings = settings
        self.transitions_made: Counter[str] = Counter()
        self.store_failures = 0
        self.timebase = Timebase(settings.time.speed, settings.time.epoch_s)
        self.store = Store(settings.store.database, settings.store.launcher, alone=True)
        self.hub = EventHub()
        self.leases = LeaseDesk()
        self.tokens = Tokens(self.store)
        beside = settings.store.path
        self.models = ModelChoice(settings.block.model, beside.with_name(beside.stem + "-models"))
        self.desk = DiscrepancyDesk(settings, self.store, self.hub, self.models, self.folder, self._busy)
        left = self.store.last_transition()
        interrupted = self.store.abort_interrupted()
        # The last run may have ended, and its process been killed before the recording was written.
        last = left["run_id"] if left is not None else None
        self._to_recover = dict.fromkeys([*interrupted, *([last] if last is not None else [])])
        at, reason, run_id = _begin_at(left, interrupted)
        correlate(run_id)
        self._sequencer = Sequencer(
            _patience(settings.sequence, self.timebase),
            MotionWatch(_noise(self.models.path())),
            at=at,
            reason=reason,
            run_id=run_id,
        )
        self._lock = threading.RLock()
        self._commands = threading.Lock()
        self._records: queue.SimpleQueue[TransitionRecord | None] = queue.SimpleQueue()
        self._stopping = threading.Event()
        self._recorder = threading.Thread(target=self._record, name="recorder", daemon=True)
        self.line = Line(settings.link, self.timebase) if settings.link.url is not None else None
        self._worker = Worker(
            settings, self.store, self.line, self._on_reply, self._sequencer.is_wanted, self._standing_conditions
        )
        self._acquisition = Acquisition(self.line, self._on_batch, self._on_idle, self._on_tick, beat)
        self._gatherer = Gatherer(settings, self.line)
        self._board = Board(utc_now)
        self._progress_s = 0.0
        self._told: tuple[object, ...] = ()
        self._thinner = Thinner(SAMPLES_EVERY_S * self.timebase.speed)
        self._look()

    # ------------------------------------------------------------------ life

    def start(self) -> None:
        """Open the line and begin to watch."""
        self._worker.start()  # whose process gets ready while this one does
        motion_watch.prepare()
        self._recorder.start()
        self._gatherer.start()
        self.tokens.start()
        for run_id in self._to_recover:
            self._worker.recover(RunFolder(self.settings.store.runs, run_id))
        self._acquisition.start()
        self.desk.jobs.start_working()

    def stop(self) -> None:
        """End a run in hand as ABORTED (``service_stopped``), then everything, losing nothing that was taken in."""
        with self._commands, self._lock:
            if "abort" in self._sequencer.allowed():
                self._sequencer.abort(self.timebase.now_s(), "service_stopped", "the service was stopped")
            self._dispatch()
        self._acquisition.stop()
        self._gatherer.stop()
        self.tokens.stop()
        self._worker.stop()
        self._stopping.set()
        self._records.put(None)
        self._recorder.join(10.0)
        self.store.close()

    # ------------------------------------------------------------------ what is read

    def status(self) -> Published:
        """Return the last status; one that is too old to be true says so and is not fit."""
        published = self._published
        if time.monotonic() - published.made_s > DEAD_AFTER_S:
            reasons = ["the acquisition thread does not answer", *published.facts["reasons"]]
            return publish({**published.facts, "fit": False, "reasons": reasons, "link": "STALE"})
        return published

    def health(self) -> list[str]:
        """Return why the service is not alive; nothing when it is."""
        dead_s, busy_s = self.silence_s(), self.busy_s()
        reasons = [f"the acquisition thread is silent for {dead_s:.1f} s"] if dead_s > DEAD_AFTER_S else []
        if busy_s > HANGS_AFTER_S:
            reasons.append(f"one piece of work has taken {busy_s:.0f} s")
        return reasons

    def busy_s(self) -> float:
        """Return for how long [real s] the worker has been at the piece of work in hand."""
        return self._worker.busy_s

    def silence_s(self) -> float:
        """Return how long ago [real s] the acquisition thread finished a turn."""
        return time.monotonic() - self._acquisition.beat_s

    def waiting(self) -> dict[str, int]:
        """Return how many pieces of work wait in each queue."""
        line = {"line": self.line.link.queued} if self.line is not None else {}
        return {"worker": self._worker.waiting, "recorder": self._records.qsize(), **line}

    def result_in_hand(self) -> Result | None:
        """Return the result of the run in hand, or of the last one, once there is one."""
        with self._lock:
            return self._sequencer.run.result if self._sequencer.run is not None else None

    def readiness(self) -> list[str]:
        """Return why the service cannot take a run; nothing when it can."""
        missing = self._missing()
        try:
            self.store.check()
        except Exception as error:
            missing = [*missing, f"the store cannot be read: {error}"]
        return [*self.health(), *missing]

    def terms(self, run_id: str) -> dict[str, Any]:
        """Return the terms that the stages of the run in hand have given so far."""
        with self._lock:
            run = self._sequencer.run
            if run is None or run.run_id != run_id:
                return {}
            return {name: terms.model_dump(mode="json") for name, terms in run.terms.items()}

    def run(self, run_id: str) -> RunRecord:
        """Return one run or raise :class:`UnknownRun`."""
        record = self.store.run(run_id)
        if record is None:
            raise UnknownRun(run_id)
        return record

    def folder(self, run_id: str) -> RunFolder:
        """Return the folder of a run that the store knows; no other name reaches the file system."""
        return RunFolder(self.settings.store.runs, self.run(run_id).id)

    def conditions(self) -> dict[str, Any]:
        """Return the go / no-go conditions with the judgement of the status that they belong to."""
        status = self.status().facts
        with self._lock:
            return {"fit": status["fit"], "reasons": status["reasons"], "conditions": self._board.listing()}

    def _standing_conditions(self) -> list[dict[str, Any]]:
        """Return what of the conditions a result is kept with: how each stood, by which measure."""
        kept = ("name", "severity", "state", "measured", "limit", "unit", "text", "acknowledgement")
        with self._lock:
            return [{key: one[key] for key in kept} for one in self._board.listing()]

    # ------------------------------------------------------------------ commands

    def acknowledge_condition(self, name: str, who: str, why: str) -> None:
        """Take note of a broken condition.

        Raises
        ------
        UnknownCondition, CannotAcknowledge
            The latter recorded in the audit as refused.
        """
        with self._commands:
            try:
                with self._lock:
                    self._board.acknowledge(name, who, why)
                    self._look()
                    self.hub.publish("condition", self._board.entry(name))
            except CannotAcknowledge as error:
                self.store.audit(who, f"acknowledge {name}", self._run_id(), "refused", str(error))
                raise
            self.store.audit(who, f"acknowledge {name}", self._run_id(), "accepted", why)

    def acquire_lease(self, who: str, lasts_s: float, take_over: bool, why: str) -> tuple[Lease, str | None]:
        """Give the lease, and tell from whom it was taken over.

        Raises
        ------
        LeaseHeld
            Recorded in the audit as refused.
        """
        command = "take over the lease" if take_over else "acquire the lease"
        try:
            lease, before = self.leases.acquire(who, lasts_s, take_over=take_over)
        except LeaseHeld as error:
            self.store.audit(who, command, self._run_id(), "refused", str(error))
            raise
        detail = f"from {before}" + (f": {why}" if why else "") if before is not None else why
        self.store.audit(who, command, self._run_id(), "accepted", detail)
        self.hub.publish("lease", {"holder": who, "lasts_s": lasts_s, "taken_over_from": before})
        return lease, before

    def release_lease(self, lease_id: str) -> None:
        """Take the lease back from its holder; raises :class:`service.lease.NoSuchLease`."""
        lease = self.leases.release(lease_id)
        self.store.audit(lease.holder, "release the lease", self._run_id(), "accepted")
        self.hub.publish("lease", {"holder": None, "lasts_s": 0.0, "taken_over_from": None})

    def _run_id(self) -> str | None:
        run = self._sequencer.run
        return run.run_id if run is not None else None

    def start_run(self, request: dict[str, Any], who: str, key: str | None = None) -> tuple[str, bool]:
        """Start a run, or return the one that ``key`` started before, and whether it is new.

        Raises
        ------
        NotAllowed, NotConfigured, KeyReused
            Recorded in the audit as refused.
        """
        with self._commands:
            try:
                run_id, new = self._start_run(request, who, key)
            except (NotAllowed, NotConfigured, KeyReused) as error:
                self.store.audit(who, "start", None, "refused", str(error))
                raise
            self.store.audit(who, "start", run_id, "accepted", "" if new else "the same key again: no new run")
            return run_id, new

    def _start_run(self, request: dict[str, Any], who: str, key: str | None) -> tuple[str, bool]:
        before = None
        known = self.store.run_of_key(key) if key is not None else None
        if known is None:
            if missing := self._missing():
                raise NotConfigured("; ".join(missing))
            with self._lock:
                self._sequencer.check("start")
                before = self._sequencer.run
        try:
            record, new = self.store.create_run(request, str(request["method"]), who, key)
        except KeyError:
            raise KeyReused(f"the key {key!r} belongs to run {known}, which was asked for something else") from None
        if not new:
            return record.id, False
        try:
            self._begin(record, request)
        except (OSError, NotAllowed) as error:  # the run is in the store and did not begin: say so there as well
            end = TransitionRecord("OFFLINE", "ABORTED", "not_started", str(error), 0.0, utc_now(), record.id)
            self.store.add_transitions([end])
            raise
        if before is not None:
            self.store.end_run(before.run_id)
        return record.id, True

    def _begin(self, record: RunRecord, request: dict[str, Any]) -> None:
        folder = RunFolder(self.settings.store.runs, record.id)
        block = self._block()
        folder.make(block)
        self._worker.plan(
            record.id, RunPlan(record.method, self.settings.site, self._reference(request), folder, block)
        )
        with self._lock:
            self._sequencer.check("start")
            if self.line is not None:
                self.line.capture_to(folder.capture)
            swaying = self._reference(request).alignment == "inertial"
            correlate(record.id)
            self._sequencer.start(record.id, self.timebase.now_s(), swaying=swaying)
            self._dispatch()

    def abort_run(self, run_id: str, who: str, why: str = "") -> None:
        """Abort the run in hand.

        Raises
        ------
        UnknownRun, NotAllowed
            The latter recorded in the audit as refused.
        """
        self._command("abort", run_id, who, why)

    def acknowledge_run(self, run_id: str, who: str, why: str = "") -> None:
        """Take note of a FAULT of the last run; as :meth:`abort_run`."""
        self._command("acknowledge", run_id, who, why)

    def _command(self, command: str, run_id: str, who: str, why: str) -> None:
        self.run(run_id)
        detail = f"by {who}" + (f": {why}" if why else "")
        with self._commands:
            try:
                with self._lock:
                    self._check_in_hand(command, run_id)
                    if command == "abort":
                        self._sequencer.abort(self.timebase.now_s(), "operator", detail)
                    else:
                        self._sequencer.acknowledge(self.timebase.now_s(), detail)
                    self._dispatch()
            except NotAllowed as error:
                self.store.audit(who, command, run_id, "refused", str(error))
                raise
            self.store.audit(who, command, run_id, "accepted", why)

    def _check_in_hand(self, command: str, run_id: str) -> None:
        run = self._sequencer.run
        if run is None or run.run_id != run_id:
            raise NotAllowed(command, self._sequencer.state, "this run is over", self._allowed())
        self._sequencer.check(command)

    def _busy(self) -> bool:
        with self._lock:
            return "abort" in self._sequencer.allowed()

    def _block(self) -> BlockSettings:
        """Return the block's settings with the model in use."""
        return self.settings.block.model_copy(update={"model": self.models.path()})

    def _reference(self, request: dict[str, Any]) -> ReferenceSettings:
        asked = {key: request[key] for key in ("azimuth_deg", "alignment") if request.get(key) is not None}
        return self.settings.reference.model_copy(update=asked)

    def _missing(self) -> list[str]:
        """Settings without which no run can start."""
        missing = []
        if self.settings.link.url is None:
            missing.append("no line is configured: set [link] url or give --link")
        if self.settings.site is None:
            missing.append("no site is configured: set [site] latitude_deg")
        return missing

    # ------------------------------------------------------------------ what comes in

    def _on_batch(self, samples: Any, restart: bool) -> None:
        with self._lock:
            self._sequencer.on_batch(samples, self.timebase.now_s(), restart)
        if len(self.hub) and len(samples):
            if (facts := self._thinner.feed(samples)) is not None:
                self.hub.publish("samples", facts)
        else:
            self._thinner.clear()

    def _on_idle(self) -> None:
        with self._lock:
            self._sequencer.on_idle(self.timebase.now_s())

    def _on_tick(self, line: LineView) -> None:
        with self._lock:
            self._sequencer.on_tick(self.timebase.now_s(), line)
            self._dispatch()

    def _on_reply(self, reply: Reply) -> None:
        with self._lock:
            self._sequencer.on_reply(reply)
            self._dispatch()

    def _dispatch(self) -> None:
        """Send on what the sequencer has left; the caller holds the lock, nothing here waits."""
        sequencer = self._sequencer
        changed = bool(sequencer.transitions)
        while sequencer.orders:
            self._worker.submit(sequencer.orders.popleft())
        now_s = time.monotonic()
        if changed or now_s - self._published.made_s > SNAPSHOT_EVERY_S:
            self._look()
        while sequencer.transitions:
            record = sequencer.transitions.popleft()
            log.info("state", **asdict(record))
            self.transitions_made[record.target] += 1
            if record.target == Name.OFFLINE:
                correlate(None)
            self._records.put(record)
            self.hub.publish("state", {**asdict(record), "status": self._published.facts})
            if record.target in (Name.READY, Name.FAULT, Name.ABORTED):
                if self.line is not None:
                    self._worker.submit(self.line.capture_end)
                self._worker.submit(trim)  # the run has left its holes, and nothing is measured now
        facts = self._published.facts
        told = (facts["link"], facts["fit"])
        if len(self.hub) and (told != self._told or now_s - self._progress_s > PROGRESS_EVERY_S):
            self._progress_s, self._told = now_s, told
            self.hub.publish("progress", facts)

    def _look(self) -> None:
        """Judge the conditions and make the status; the caller holds the lock."""
        sequencer = self._sequencer
        result = sequencer.run.result if sequencer.run is not None else None
        facts = self._gatherer.facts(sequencer.line, sequencer.judged(), result)
        for name in self._board.update(facts, self.timebase.now_s()):
            self.hub.publish("condition", self._board.entry(name))
        self._published = publish(self._facts())

    def _facts(self) -> dict[str, Any]:
        facts = self._sequencer.snapshot()
        facts["allowed"] = self._allowed()
        missing = self._missing()
        if missing and self._sequencer.state is Name.OFFLINE:
            facts["reasons"] = missing
            return facts
        against = self._board.against()
        facts["fit"] = facts["fit"] and not against
        shown = against if self._sequencer.fit else [words for words in against if words.startswith(ALWAYS_SHOWN)]
        facts["reasons"] = [*shown, *facts["reasons"], *self._board.noted()]
        return facts

    def _allowed(self) -> list[str]:
        allowed = self._sequencer.allowed()
        return [command for command in allowed if command != "start"] if self._missing() else allowed

    def _record(self) -> None:
        """Write changes of state to the store; one that cannot be written is tried again until the service ends."""
        while (record := self._records.get()) is not None:
            while not self._recorded(record) and not self._stopping.wait(RECORD_AGAIN_S):
                pass

    def _recorded(self, record: TransitionRecord) -> bool:
        try:
            self.store.add_transitions([record])
        except Exception as error:
            self.store_failures += 1
            log.error("store", transition=record.target, error=str(error))
            return False
        return True


def _begin_at(left: dict[str, Any] | None, interrupted: list[str]) -> tuple[Name, str, str | None]:
    """Return the state to begin in, after what the process before left: a FAULT stays until it is acknowledged."""
    if interrupted:
        return Name.ABORTED, "service_stopped", interrupted[-1]
    if left is not None and left["target"] == Name.FAULT:
        return Name.FAULT, left["reason"], left["run_id"]
    return Name.OFFLINE, "service_started", None


def _noise(model: Path | None) -> Noise | None:
    """Return the block's noise where its model tells it."""
    if model is None:
        return None
    noise = parse_document(BlockModel, model.read_bytes(), str(model)).noise
    return None if noise.free else noise


def _patience(settings: SequenceSettings, timebase: Timebase) -> SequenceSettings:
    """Return the settings with time-outs no shorter than a host needs for a few commands, however fast time runs."""
    return settings.model_copy(
        update={
            "power_up_timeout_s": timebase.limit_s(settings.power_up_timeout_s, HOST_PATIENCE_S),
            "self_test_timeout_s": timebase.limit_s(settings.self_test_timeout_s, HOST_PATIENCE_S),
        }
    )
