"""The sequencer: samples, ticks, replies and commands in; states, orders and records out.

It owns no thread, no clock and no file. :meth:`Sequencer.on_batch` takes samples, :meth:`Sequencer.on_tick` the
simulated time and the state of the line; what it wants done by the block or the estimator it leaves in ``orders``,
and what became of it comes back through :meth:`Sequencer.on_reply`. Block time ends windows; simulated host time
ends patience. docs/states.md is the table of all this.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.samples import SampleArray, Status
from inertial.documents import Result, StageTerms, WindowRecord
from service.attitude_watch import AttitudeChange, AttitudeWatch
from service.buffer import SampleBuffer, frames_lost
from service.config import SequenceSettings
from service.monitors import DPH_RADPS, MG_MPS2, OVERRANGE, FlagMonitor, Settled, SettlingMonitor, StuckMonitor
from service.orders import AskBlock, Conclude, Estimate, Keep, MeasuredTurn, Order, Question, Reply
from service.states import OPERATOR_COMMANDS, PATH, RESUMABLE, WINDOWS, Name, TrimStates
from service.store import TransitionRecord, utc_now
from service.windows import INERTIAL_ALIGN_S

STREAMING = "STREAMING"
FLAGS_LAST_S = 0.5
SWAY_OFFER = 'the launcher moves: a new run with "alignment": "inertial" settles and aligns while it sways'
GUARD_S = 1.0
"""A step ends this much after its window, so that motion at the window's end is still seen before it is used."""


class NotAllowed(Exception):
    """A command does not fit the state; ``allowed`` holds the commands that do."""

    def __init__(self, command: str, state: Name, reason: str, allowed: list[str]) -> None:
        super().__init__(f"{command} is not possible in {state} ({reason})")
        self.command, self.state, self.allowed = command, state, allowed


class Stillness(Protocol):
    """Judge of motion."""

    def feed(self, samples: SampleArray) -> bool:
        """Take a batch; return whether the block is still at its end."""

    def reset(self) -> None:
        """Forget what was learnt: the data that follow do not continue the old ones."""


@dataclass(frozen=True)
class LineView:
    """The line as the link tells it: its state and the age [simulated s] of the newest frame."""

    state: str = "DISCONNECTED"
    age_s: float | None = None


@dataclass(frozen=True)
class Judged:
    """What the sequencer can say of the block now; None where it cannot. ``valid_for_s``: of the last READY."""

    still: bool | None
    settled: bool | None
    settling_evidence: str
    temperature_c: float | None
    ready: bool
    valid_for_s: float | None


@dataclass
class RunContext:
    """What the run in hand has gathered so far; ``swaying``: it settles and aligns although the launcher moves."""

    run_id: str
    swaying: bool = False
    windows: dict[Name, WindowRecord] = field(default_factory=dict)
    terms: dict[str, StageTerms] = field(default_factory=dict)
    turns: list[MeasuredTurn] = field(default_factory=list)
    result: Result | None = None
    restarts: int = 0
    holds: int = 0
    facts: dict[str, Any] = field(default_factory=dict)


class Sequencer:
    """One block's sequencer.

    Parameters
    ----------
    settings
        Steps, limits and time-outs.
    stillness
        Judge of motion, fed every batch.
    at, reason, run_id
        State to begin in: OFFLINE, or FAULT or ABORTED left by the process before.
    utc
        Wall clock of the records.
    """

    def __init__(
        self,
        settings: SequenceSettings,
        stillness: Stillness,
        *,
        at: Name = Name.OFFLINE,
        reason: str = "service_started",
        run_id: str | None = None,
        utc: Callable[[], str] = utc_now,
    ) -> None:
        self._settings = settings
        self._stillness = stillness
        self._utc = utc
        self._machine = TrimStates(self._changed, at)
        self._now_s = 0.0
        self._line = LineView()
        self._token = 0
        self._pending: set[str] = set()
        self._since_s, self._since_utc = 0.0, utc()
        self._reason, self._detail = reason, ""
        self._held: Name | None = None
        self._held_from_s = math.nan
        self._run = RunContext(run_id) if run_id is not None else None
        self.orders: deque[Order] = deque()
        self.transitions: deque[TransitionRecord] = deque()
        self.buffer = SampleBuffer()
        self._stuck = StuckMonitor(settings.stuck_s)
        self._flags = FlagMonitor(FLAGS_LAST_S)
        self._settling = SettlingMonitor(
            settings.settling_window_s,
            settings.temperature_slope_cpmin,
            settings.accel_drift_mg_per_min * MG_MPS2,
            settings.gyro_drift_dph_per_min * DPH_RADPS,
        )
        self._attitude = AttitudeWatch()
        self._settled: Settled | None = None
        self._still = True
        self._still_since_s = math.nan
        self._window_start_s = math.nan
        self._last_s = math.nan
        self._newest_c = math.nan
        self._ready_temperature_c = math.nan
        self._ready_until_s = math.inf
        self._conclusion: tuple[str, str, str] = ("", "", "")

    # ------------------------------------------------------------------ what others read

    @property
    def state(self) -> Name:
        """The state now."""
        return self._machine.name_now

    @property
    def run(self) -> RunContext | None:
        """The run in hand, or the last one."""
        return self._run

    @property
    def line(self) -> LineView:
        """The line as it was last told."""
        return self._line

    @property
    def fit(self) -> bool:
        """Whether the navigation data are fit: READY, with a result that says so, on a line that is fresh."""
        return self.state is Name.READY and self._streaming() and self._run is not None and self._run.result is not None

    def is_wanted(self, token: int) -> bool:
        """Whether the reply to an order of this token would still be taken."""
        return token == self._token

    def allowed(self) -> list[str]:
        """Commands that fit the state."""
        return [command for command in OPERATOR_COMMANDS if self._machine.may(command, self._held)]

    def snapshot(self) -> dict[str, Any]:
        """Return the facts of ``GET /status`` (docs/api.md)."""
        state = self.state
        elapsed_s = max(self._now_s - self._since_s, 0.0)
        progress, remaining_s = self._progress(state)
        return {
            "state": state.value,
            "since": self._since_utc,
            "reason": self._reason,
            "detail": self._detail,
            "run_id": self._run.run_id if self._run is not None else None,
            "stage": self._stage(state),
            "progress": progress,
            "elapsed_s": round(elapsed_s, 3),
            "remaining_s": remaining_s,
            "link": self._line.state,
            "age_s": None if self._line.age_s is None else round(self._line.age_s, 3),
            "fit": self.fit,
            "reasons": self._reasons(),
            "allowed": self.allowed(),
        }

    def judged(self) -> Judged:
        """Return what the go / no-go conditions are judged by."""
        state, held = self.state, self._held
        over = state is Name.HOLD and held is Name.READY
        step = held if state is Name.HOLD and held is not None else state
        begun = PATH.index(step) if step in PATH else 0
        settled = (self._reason != "temperature_changed") if begun > PATH.index(Name.SETTLING) else None
        vouched = state is Name.READY or over
        return Judged(
            still=self._still if self._streaming() and not math.isnan(self._last_s) else None,
            settled=settled,
            settling_evidence=self._settled.text if self._settled is not None else "",
            temperature_c=None if math.isnan(self._newest_c) else round(self._newest_c, 2),
            ready=state is Name.READY,
            valid_for_s=max(self._ready_until_s - self._now_s, 0.0) if vouched else None,
        )

    # ------------------------------------------------------------------ commands of the operator

    def check(self, command: str) -> None:
        """Raise :class:`NotAllowed` when a command does not fit the state."""
        if not self._machine.may(command, self._held):
            raise NotAllowed(command, self.state, self._reason, self.allowed())

    def start(self, run_id: str, now_s: float, *, swaying: bool = False) -> None:
        """Begin a run; ``swaying``: with an alignment that takes motion for what it is."""
        self.check("start")
        self._now_s = now_s
        self._leave()
        self._run = RunContext(run_id, swaying)
        self._send("start", "start", "")
        self._held = None
        self._power_up()

    def abort(self, now_s: float, reason: str = "operator", detail: str = "") -> None:
        """End the run in hand."""
        self.check("abort")
        self._now_s = now_s
        self._leave()
        self._keep()
        self._send("abort", reason, detail)

    def acknowledge(self, now_s: float, detail: str = "") -> None:
        """Take note of a FAULT."""
        self.check("acknowledge")
        self._now_s = now_s
        self._send("acknowledge", "acknowledged", detail)

    # ------------------------------------------------------------------ what comes from the line

    def on_batch(self, samples: SampleArray, now_s: float, restart: bool = False) -> None:
        """Take the next samples, in order; ``restart``: the block began anew before the first of them."""
        self._now_s = max(self._now_s, now_s)
        if len(samples) == 0:
            return
        backwards = np.flatnonzero(np.diff(samples["time"]) <= 0)
        if len(backwards):
            cut = int(backwards[0]) + 1
            self.on_batch(samples[:cut], now_s, restart)
            self.on_batch(samples[cut:], now_s, restart=True)
            return
        if restart or samples["time"][0] <= self._last_s:
            self._on_restart()
        self._take(samples)

    def on_idle(self, now_s: float) -> None:
        """Take note that the block has just woken and sends nothing until told to."""
        self._now_s = max(self._now_s, now_s)
        if self.state is not Name.POWER_UP:
            self._on_restart()
        elif "start" not in self._pending:
            self._ask("start")

    def on_tick(self, now_s: float, line: LineView) -> None:
        """Take the time and the state of the line; call it at least a few times a second."""
        self._now_s = max(self._now_s, now_s)
        self._line = line
        state = self.state
        elapsed_s = self._now_s - self._since_s
        limits = self._settings
        if not self._streaming() and (state in RESUMABLE or state is Name.READY):
            self._hold("link_stale", f"no frame; the line is {line.state}")
        elif state is Name.POWER_UP and elapsed_s > limits.power_up_timeout_s:
            self._fault("power_up_timeout", f"{self._power_up_misses()} within {limits.power_up_timeout_s:g} s")
        elif state is Name.SELF_TEST and elapsed_s > limits.self_test_timeout_s:
            self._fault("self_test_timeout", f"no result within {limits.self_test_timeout_s:g} s")
        elif state is Name.SETTLING and elapsed_s > limits.settling_max_s:
            text = self._settled.text if self._settled is not None else "no samples"
            self._fault("settling_timeout", f"after {limits.settling_max_s:g} s: {text}")
        elif state is Name.HOLD and self._held is not Name.READY and elapsed_s > limits.hold_max_s:
            self._fault("hold_timeout", f"{self._reason} lasted more than {limits.hold_max_s:g} s")
        elif state is Name.READY and self._now_s > self._ready_until_s:
            self._hold("validity_expired", f"{limits.validity_s:g} s have passed since the result")

    def on_reply(self, reply: Reply) -> None:
        """Take what became of an order; replies to orders of a step that is over change nothing."""
        if reply.what == "partial":
            if self._run is not None and reply.value is not None:
                self._run.terms.update(reply.value)
            return
        if reply.token != self._token:
            return
        self._pending.discard(reply.what)
        handle = {
            Name.POWER_UP: self._replied_at_power_up,
            Name.SELF_TEST: self._replied_at_self_test,
            Name.VERIFYING: self._replied_at_verifying,
        }.get(self.state)
        if handle is not None:
            handle(reply)

    # ------------------------------------------------------------------ steps

    def _take(self, samples: SampleArray) -> None:
        state = self.state
        if state in PATH[:-1] or (state is Name.HOLD and self._held is not Name.READY):
            self.buffer.append(samples)
        self._watch(samples)
        self._last_s = float(samples["time"][-1])
        self._newest_c = _temperature_c(samples[-1:])
        if self.state is Name.POWER_UP:
            self._maybe_powered_up(samples)
        elif self.state is Name.SETTLING:
            self._settle(samples)
        elif self.state is Name.HOLD:
            self._maybe_resume()
        elif self.state in WINDOWS:
            self._fill_windows()
        elif self.state is Name.READY:
            self._watch_temperature(samples)

    def _watch(self, samples: SampleArray) -> None:
        """Judge motion, flags and stuck channels, whatever the state."""
        still = self._stillness.feed(samples)
        self._attitude.feed(samples)
        stuck, flags = self._stuck.feed(samples), self._flags.feed(samples)
        if not still:
            self._still_since_s = math.nan
        elif not self._still or math.isnan(self._still_since_s):
            self._still_since_s = float(samples["time"][0])
        self._still = still
        state = self.state
        if state is Name.POWER_UP or state not in (*PATH, Name.HOLD):
            return
        if stuck and state is not Name.SELF_TEST:  # there the block tells for itself what is wrong with it
            self._give_up("stuck_sensor", f"{', '.join(stuck)} repeated one value for {self._settings.stuck_s:g} s")
        elif flags:
            self._give_up("sensor_invalid", f"the block reports {', '.join(flags)}")
        elif np.any(samples["status"] & Status.START_UP):
            self._on_restart()
        elif state in WINDOWS or state is Name.READY:
            if np.any(samples["status"] & OVERRANGE):
                self._hold("overrange", "the block reports overload or out of range")
            elif not still and not (state is Name.ALIGNING and self._may_sway()):
                self._hold("motion", "the block moved")

    def _may_sway(self) -> bool:
        return self._run is not None and self._run.swaying

    def _give_up(self, reason: str, detail: str) -> None:
        """FAULT while a run is under way; READY is withdrawn instead, because its run is complete."""
        if self.state is Name.READY:
            self._hold(reason, detail)
        elif not (self.state is Name.HOLD and self._held is Name.READY):
            self._fault(reason, detail)

    def _on_restart(self) -> None:
        """Begin again from the top: what the block does after a restart does not continue what it did before."""
        self._forget_samples()
        if self.state is Name.READY:
            self._hold("block_restart", "the block restarted; its turn-on is another one now")
        elif self._run is not None and self._machine.may("restart", self._held):
            self._run.restarts += 1
            if self._run.restarts > self._settings.restart_max_count:
                self._fault("block_restarts", f"the block restarted {self._run.restarts} times in this run")
                return
            self._send("restart", "block_restart", f"restart {self._run.restarts} of this run")
            self._power_up()

    def _forget_samples(self) -> None:
        self.buffer.clear()
        self._stillness.reset()
        self._attitude.reset()
        self._stuck = StuckMonitor(self._settings.stuck_s)
        self._flags = FlagMonitor(FLAGS_LAST_S)
        self._last_s = self._still_since_s = math.nan

    # POWER_UP

    def _power_up(self) -> None:
        self._leave()
        self._forget_samples()
        if self._run is not None:
            self._run.windows.clear()
            self._run.terms.clear()
            self._run.turns.clear()
        self._ask("identity")
        self._ask("read")
        self._ask("start")

    def _replied_at_power_up(self, reply: Reply) -> None:
        if reply.error is not None and not reply.unsupported:
            if self._now_s - self._since_s <= self._settings.power_up_timeout_s:
                self._ask(reply.what)  # type: ignore[arg-type]  # a block that is still waking up is asked again
            return
        if self._run is not None and reply.value is not None:
            self._run.facts["previous_terms" if reply.what == "read" else reply.what] = reply.value

    def _maybe_powered_up(self, samples: SampleArray) -> None:
        if not self._pending and not int(samples["status"][-1]) & Status.START_UP:
            self._send("advance", "streaming", "the block answers and sends samples")
            self._enter(Name.SELF_TEST)

    def _power_up_misses(self) -> str:
        if self._pending:
            return f"no answer to {', '.join(sorted(self._pending))}"
        return "no samples" if math.isnan(self._last_s) else "the block did not finish its start-up"

    # SELF_TEST

    def _replied_at_self_test(self, reply: Reply) -> None:
        if reply.error is not None and not reply.unsupported:
            self._fault("self_test_no_answer", reply.error)
        elif not reply.unsupported and reply.value:
            self._fault("self_test_failed", f"the block reports {reply.value}")
        else:
            self._send("advance", "self_test_passed", "the block has no self-test" if reply.unsupported else "")
            self._enter(Name.SETTLING)

    # SETTLING

    def _settle(self, samples: SampleArray) -> None:
        if not self._still and not self._may_sway():
            self._settling.reset()
            return
        self._settled = self._settling.feed(samples)
        if self._settled.settled:
            self._window_start_s = math.nan
            self._send("advance", "settled", self._settled.text)
            self._enter(Name.ALIGNING)

    # windows: ALIGNING, STAGE_1 … STAGE_3, VERIFYING

    def _window_length_s(self, step: Name) -> float:
        if step is Name.ALIGNING:
            return max(self._settings.align_s, INERTIAL_ALIGN_S) if self._may_sway() else self._settings.align_s
        return self._settings.verify_s if step is Name.VERIFYING else self._settings.stage_s

    def _fill_windows(self) -> None:
        """End every step whose window is full; the next window begins where the last one ended."""
        while self.state in WINDOWS and not self._pending:
            step = self.state
            if math.isnan(self._window_start_s):
                self._window_start_s = float(self.buffer.rows()["time"][-1])
            end_s = self._window_start_s + self._window_length_s(step)
            if self._too_many_lost(step, end_s) or self._last_s < end_s + GUARD_S:
                return
            self._window_full(step, end_s)

    def _too_many_lost(self, step: Name, end_s: float) -> bool:
        used = self.buffer.span(self._window_start_s, end_s)
        if len(used) < 2:
            if self._last_s < end_s:
                return False  # it has only begun
            self._hold("frames_lost", "no frame of the window came")  # a gap has swallowed all of it
            return True
        lost = frames_lost(used)
        per_s = (len(used) + lost) / (used["time"][-1] - used["time"][0])
        expected = max(per_s * self._window_length_s(step), 1.0)
        if lost <= self._settings.lost_fraction * expected:
            return False
        limit = self._settings.lost_fraction * 100
        self._hold("frames_lost", f"{lost} of {expected:.0f} frames lost (limit {limit:g} %)")
        return True

    def _window_full(self, step: Name, end_s: float) -> None:
        assert self._run is not None
        kind = WINDOWS[step]
        self._run.windows[step] = WindowRecord(kind=kind, start_s=self._window_start_s, end_s=end_s)
        if step is Name.VERIFYING:
            self._order_estimate(final=True)
            return
        if step is Name.ALIGNING:
            self._attitude.set_reference(self.buffer.span(self._window_start_s, end_s))
        else:
            self._order_estimate(final=False)
        self._window_start_s = end_s
        self._send("advance", "aligned" if step is Name.ALIGNING else "stage_complete", "")

    def _order_estimate(self, *, final: bool) -> None:
        assert self._run is not None
        if final:
            self._pending.add("final")
        self.orders.append(
            Estimate(self._token, self._run.run_id, self._windows(), tuple(self._run.turns), self.buffer.rows(), final)
        )

    def _windows(self) -> tuple[WindowRecord, ...]:
        """The windows of the run that are full, in the order of their use."""
        full = self._run.windows if self._run is not None else {}
        return tuple(full[step] for step in WINDOWS if step in full)

    # VERIFYING → READY

    def _replied_at_verifying(self, reply: Reply) -> None:
        if reply.what == "final":
            self._estimated(reply)
        elif reply.what == "conclude":
            self._concluded(reply)
        elif reply.error is not None and not reply.unsupported:
            self._conclude("FAULT", "write_failed", reply.error)
        elif reply.what == "write" and not reply.unsupported:
            self._ask("read_back")
        elif reply.unsupported:
            self._conclude(
                "READY", "verified", "the block keeps no terms; users of its frames take them from the result"
            )
        else:
            self._read_back(reply.value)

    def _estimated(self, reply: Reply) -> None:
        assert self._run is not None
        if reply.error is not None:
            self._fault("estimation_failed", reply.error)
            return
        result: Result = reply.value
        self._run.result = result
        self._run.terms = {str(name): terms for name, terms in result.terms.items()}
        if result.fit:
            self._ask("write", result.terms["final"])
        else:
            self._conclude("FAULT", "verification_failed", "; ".join(result.reasons))

    def _read_back(self, held: StageTerms) -> None:
        assert self._run is not None
        assert self._run.result is not None
        written = self._run.result.terms["final"]
        if held == written:
            self._conclude("READY", "verified", self._run.result.verdict)
        else:
            self._conclude("FAULT", "read_back_differs", f"wrote {written}, the block holds {held}")

    def _conclude(self, state: Literal["READY", "FAULT"], reason: str, detail: str) -> None:
        """Have the result kept before anyone is told of it."""
        assert self._run is not None
        assert self._run.result is not None
        self._conclusion = (state, reason, detail)
        self._pending.add("conclude")
        self.orders.append(Conclude(self._token, self._run.run_id, state, reason, self._run.result))

    def _concluded(self, reply: Reply) -> None:
        state, reason, detail = self._conclusion
        if reply.error is not None:
            self._fault("store_failed", reply.error)
        elif state == "FAULT":
            self._leave()
            self._send("fault", reason, detail)
        else:
            self._ready_until_s = self._now_s + self._settings.validity_s
            self._ready_temperature_c = _temperature_c(self.buffer.rows()[-1:])
            self._send("advance", reason, detail)

    # READY

    def _watch_temperature(self, samples: SampleArray) -> None:
        change_c = _temperature_c(samples) - self._ready_temperature_c
        if abs(change_c) > self._settings.ready_temperature_change_c:
            limit = self._settings.ready_temperature_change_c
            self._hold("temperature_changed", f"by {change_c:+.1f} °C since the result (limit {limit:g} °C)")

    # HOLD, FAULT

    def _hold(self, reason: str, detail: str) -> None:
        held = self.state
        if held is Name.HOLD:
            return
        self._leave()
        self._held, self._held_from_s = held, self._last_s
        if self._run is not None:
            self._run.holds += 1
            if held is not Name.READY and self._run.holds > self._settings.hold_max_count:
                self._fault("too_many_holds", f"{self._run.holds} in this run, the last for {reason}")
                return
        self._still_since_s = math.nan
        self._send("hold", reason, detail)

    def _maybe_resume(self) -> None:
        """Begin the held step again once the block has been still, and the line whole, for long enough."""
        held, wait_s = self._held, self._settings.still_again_s
        sways = self._may_sway() and held in (Name.SETTLING, Name.ALIGNING)
        good_since_s = self._held_from_s if sways else self._still_since_s
        if held is None or held is Name.READY or math.isnan(good_since_s) or not self._streaming():
            return
        if self._last_s - good_since_s < wait_s:
            return
        recent = self.buffer.span(self._last_s - wait_s)
        if frames_lost(recent) > self._settings.lost_fraction * len(recent):
            return
        change = self._attitude.change(recent)
        if held not in WINDOWS or held is Name.ALIGNING or self._stands_as_aligned(change):
            self._resume(held, f"after {self._reason}")
        else:
            self._carry_or_fault(change)

    def _resume(self, step: Name, detail: str) -> None:
        self._held = step
        self._send("resume", "still_again", detail)
        self._enter(step)

    def _stands_as_aligned(self, change: AttitudeChange) -> bool:
        limits = self._settings
        same_heading = change.heading_rad <= math.radians(limits.same_heading_deg) or not change.seen
        return same_heading and change.tilt_rad <= math.radians(limits.same_tilt_deg)

    def _carry_or_fault(self, change: AttitudeChange) -> None:
        """Begin again at ALIGNING with the measured turn in the record, where it is small and was seen whole."""
        assert self._run is not None
        turned_deg = math.degrees(float(np.linalg.norm(change.rotation_rad)))
        if change.seen and turned_deg <= self._settings.carry_deg:
            end_s = self._last_s
            self._run.turns.append(MeasuredTurn(self._held_from_s, end_s, change.rotation_rad))
            self._run.windows.clear()
            self._resume(Name.ALIGNING, f"after {self._reason}; the block was turned by {turned_deg:.3g}°")
            return
        why = f"limit {self._settings.carry_deg:g}°" if change.seen else "frames were missing meanwhile"
        self._fault(
            "attitude_changed",
            f"the block stands {turned_deg:.3g}° from where it was aligned ({why}); the reference is no longer true",
        )

    def _fault(self, reason: str, detail: str) -> None:
        self._leave()
        self._keep()
        self._send("fault", reason, detail)

    def _keep(self) -> None:
        """Have the samples of an unfinished run kept; a finished one has its recording."""
        finished = self.state is Name.READY or (self.state is Name.HOLD and self._held is Name.READY)
        if self._run is not None and not finished and len(self.buffer):
            self.orders.append(Keep(self._run.run_id, self._windows(), tuple(self._run.turns), self.buffer.rows()))

    # ------------------------------------------------------------------ common ground

    def _enter(self, step: Name) -> None:
        """Begin a step anew."""
        self._leave()
        self._held = None
        if step is Name.SELF_TEST:
            self._ask("self_test")
        elif step is Name.SETTLING:
            self._settling.reset()
            self._settled = None
        elif step in WINDOWS:
            self._window_start_s = math.nan

    def _leave(self) -> None:
        """Make replies to orders of the step in hand meaningless."""
        self._token += 1
        self._pending.clear()

    def _ask(self, what: Question, terms: StageTerms | None = None) -> None:
        self._pending.add(what)
        self.orders.append(AskBlock(self._token, what, terms))

    def _send(self, event: str, reason: str, detail: str) -> None:
        self._machine.send(event, held=self._held, reason=reason, detail=detail)

    def _changed(self, source: Name, target: Name, reason: str, detail: str) -> None:
        self._since_s, self._since_utc = self._now_s, self._utc()
        self._reason, self._detail = reason, detail
        run_id = self._run.run_id if self._run is not None else None
        self.transitions.append(
            TransitionRecord(source.value, target.value, reason, detail, self._now_s, self._since_utc, run_id)
        )

    def _streaming(self) -> bool:
        return self._line.state == STREAMING

    def _stage(self, state: Name) -> str | None:
        if state in PATH:
            return state.value
        return self._held.value if state is Name.HOLD and self._held is not None else None

    def _progress(self, state: Name) -> tuple[float | None, float | None]:
        """Return the share of the step in hand that is done, and its remaining time [block s], where known."""
        if state in WINDOWS:
            length_s = self._window_length_s(state) + GUARD_S
            done_s = 0.0 if math.isnan(self._window_start_s) else self._last_s - self._window_start_s
            return _share(done_s, length_s)
        if state is Name.SETTLING:
            gathered_s = self._settled.gathered_s if self._settled is not None else 0.0
            if gathered_s < self._settings.settling_window_s:
                return _share(gathered_s, self._settings.settling_window_s)
            return 0.99, None
        return (1.0, 0.0) if state is Name.READY else (None, None)

    def _wants_stillness(self) -> bool:
        """Whether only the launcher's motion keeps the run from settling or aligning by averages."""
        step = self._held if self.state is Name.HOLD else self.state
        waiting = self._reason == "motion" if self.state is Name.HOLD else not self._still
        return step in (Name.SETTLING, Name.ALIGNING) and waiting and not self._may_sway()

    def _reasons(self) -> list[str]:
        """Why the data are not fit, or what a fit result adds, in words."""
        if self.state is not Name.READY:
            why = f"{self.state}: {self._reason}" + (f" ({self._detail})" if self._detail else "")
            return [why, SWAY_OFFER] if self._wants_stillness() else [why]
        if not self._streaming():
            return [f"the line is {self._line.state}"]
        return list(self._run.result.reasons) if self._run is not None and self._run.result is not None else []


def planned(settings: SequenceSettings) -> list[tuple[str, float | None]]:
    """Return the way of a run with the least time of each step [block s]; None where the block decides."""
    lengths = {
        Name.SETTLING: settings.settling_window_s,
        Name.ALIGNING: settings.align_s + GUARD_S,
        Name.VERIFYING: settings.verify_s + GUARD_S,
        **dict.fromkeys((Name.STAGE_1, Name.STAGE_2, Name.STAGE_3), settings.stage_s),
    }
    return [(step.value, lengths.get(step)) for step in PATH]


def _share(done_s: float, length_s: float) -> tuple[float, float]:
    done_s = min(max(done_s, 0.0), length_s)
    return round(done_s / length_s, 4), round(length_s - done_s, 3)


def _temperature_c(samples: SampleArray) -> float:
    """Mean of all temperature sensors; NaN where there are none."""
    values: NDArray[np.float32] = samples["temperature"]
    return float(np.mean(values)) if values.size else math.nan
