"""Field life in a hurry: the real service and a simulated block for many simulated hours, with faults at random.

An operator, played by this script over HTTP, starts runs, acknowledges faults and starts again. Every few minutes
something befalls the block, the line, the service or its host (``_soak/faults.py``), one in five times two things at
once. Asked at the end: did the service always find back to READY, within the limits that its settings name; has it
kept every record it confirmed; and does its memory grow? The outcome goes to ``docs/reliability.md``.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import httpx
import numpy as np

from benchmarks._soak.faults import FAULTS, Fault
from benchmarks._soak.page import write_page
from benchmarks._soak.plant import Plant, memory_mb, open_files
from benchmarks._soak.records import Records
from benchmarks._soak.trend import spans, trend_of
from service.config import SequenceSettings

LOOK_EVERY_S = 0.1
"""Real seconds between looks at the status."""
GAP_S, READY_S = 240.0, 240.0
"""Simulated seconds, on average, from recovery to the next fault, and from READY to the next run."""
TWO_AT_ONCE = 0.2
START_REAL_S = 600.0
"""Real seconds that a start may take: minutes, where nothing was compiled before and the machine is loaded."""
ANSWER_REAL_S = 20.0
SLACK_REAL_S, ESTIMATE_REAL_S = 20.0, 60.0
"""Real seconds that a busy host may add to any limit, and that it may take for the final estimate."""
WATCHED_S = 120.0
"""Simulated seconds for which what a fault leads to is watched at least."""
TURNED_S = 30.0
"""Simulated seconds after which a block that was turned must not be called fit."""
RECOVERY_S = 5_400.0
"""Simulated seconds from a fault to READY after which the service counts as stuck: settling, holding and a run."""
ENDING = 0.5
"""Share of the time in which the service's process is ended as well; what follows is one long life."""
SPAN_S, FIRST_S = 300.0, 4 * 3_600.0
"""Memory is averaged over such spans [simulated s]; the first hours of a process fill caches and do not count."""


@dataclass
class Trouble:
    """One fault and what came of it."""

    faults: list[str]
    at_s: float
    state: str
    run_id: str | None
    reaction: str = "none"
    ready_s: float | None = None
    recovered_s: float | None = None
    same_run: bool = False


@dataclass
class Life:
    """One process of the service: when it was started, and what it held since [simulated s, MB, files]."""

    started_s: float
    times: list[float] = field(default_factory=list)
    resident_mb: list[float] = field(default_factory=list)
    own_mb: list[float] = field(default_factory=list)
    files: list[int] = field(default_factory=list)


class Soak:
    """One soak."""

    def __init__(self, plant: Plant, seed: int, hours: float, say: Callable[[str], None] = print) -> None:
        self.plant, self.random, self.end_s, self.say = plant, Random(seed), hours * 3600.0, say
        self.possible = [fault for fault in FAULTS if fault.possible(plant)]
        self.records, self.troubles, self.stuck = Records(), list[Trouble](), list[str]()
        self.lives: list[Life] = []
        self.unwritable: set[str] = set()
        self.false_fit: list[str] = []
        self._later: list[tuple[float, Fault, Callable[[], object]]] = []
        self._next_fault_s = 0.0
        self._next_run_s = 0.0
        self._status: dict[str, Any] = {}
        self._seen_real_s = time.monotonic()
        self._entered: tuple[str, float] = ("", 0.0)
        self._trouble: Trouble | None = None
        self._noted_s = 0.0
        self._pid, self._answered = 0, False
        self._limits = _dwell_limits_s(plant.speed)

    def run(self) -> None:
        """Let it live."""
        plant = self.plant
        plant.start_simulator()
        plant.start_service()
        while plant.now_s() < self.end_s or self._trouble is not None:
            self._undo()
            if self._look():
                self._operate()
                self._befall()
            if len(self.stuck) >= 5:
                self.say("five times stuck: given up")
                break
            time.sleep(LOOK_EVERY_S)

    # ------------------------------------------------------------------ looking

    def _look(self) -> bool:
        """Read the status; return whether there was one."""
        plant = self.plant
        pid = plant.service_pid()
        if pid is None:
            code = plant.ended()
            if code is not None:
                self.stuck.append(f"at {plant.now_s():.0f} s the service ended by itself with code {code}")
                plant.kill_service()
                plant.start_service()
            self._seen_real_s = time.monotonic()
            return False
        if not self.lives or pid != self._pid:
            self._pid, self._answered = pid, False
            self.lives.append(Life(plant.now_s()))
        try:
            answer = plant.client.get("/status", timeout=2.0)
            status = answer.json()
        except (httpx.TransportError, ValueError):
            silent_s = time.monotonic() - self._seen_real_s
            if silent_s > (ANSWER_REAL_S if self._answered else START_REAL_S):
                self._give_up(f"no answer for {silent_s:.0f} real s")
            return False
        self._seen_real_s, self._answered = time.monotonic(), True
        self._status = status
        if plant.full and status["run_id"] is not None:
            self.unwritable.add(status["run_id"])
        self._note(status, pid)
        return True

    def _note(self, status: dict[str, Any], pid: int) -> None:
        now_s, state = self.plant.now_s(), f"{status['state']} {status['since']}"
        if state != self._entered[0]:
            self._entered = (state, now_s)
        dwelt_s, limit_s = now_s - self._entered[1], self._limits[status["state"]]
        if dwelt_s > limit_s and not (status["state"] in ("OFFLINE", "FAULT", "ABORTED") and self._waits()):
            what = f"{status['state']} ({status['reason']}) for {dwelt_s:.0f} s, limit {limit_s:.0f} s"
            self._give_up(f"{what}; {status['reasons']}")
        if now_s - self._noted_s > 2.0 * self.plant.speed:
            self._noted_s = now_s
            life, held = self.lives[-1], memory_mb(pid)
            if held is not None:
                life.times.append(now_s - life.started_s)
                life.resident_mb.append(held[0])
                life.own_mb.append(held[1])
                life.files.append(open_files(pid))
            self._read_run(status["run_id"])
        self._follow(status, now_s)

    def _read_run(self, run_id: str | None) -> None:
        """Take down all that is told of a run."""
        if run_id is None:
            return
        try:
            answer = self.plant.client.get(f"/runs/{run_id}")
            if answer.status_code == 200:
                self.records.told(run_id, answer.json())
            elif answer.status_code == 404:
                self.records.lost.append(f"run {run_id} is unknown to the service")
            result = self.plant.client.get(f"/runs/{run_id}/result")
            if result.status_code == 200:
                self.records.result(run_id, result.content)
        except httpx.TransportError:
            return

    def _follow(self, status: dict[str, Any], now_s: float) -> None:
        """See what a trouble leads to."""
        trouble = self._trouble
        if trouble is None:
            return
        if status["state"] in ("HOLD", "FAULT", "ABORTED") and trouble.reaction == "none":
            trouble.reaction = f"{status['state']} {status['reason']}"
        elif status["state"] == "READY" and not status["fit"] and trouble.reaction == "none":
            trouble.reaction = "not fit while it lasts"
        since_s = now_s - trouble.at_s
        fit = status["state"] == "READY" and status["fit"]
        if not fit:
            trouble.ready_s = None
        elif trouble.ready_s is None:
            trouble.ready_s = since_s
        if fit and self.plant.displaced and "turn" in trouble.faults and since_s > TURNED_S:
            self.false_fit.append(f"at {now_s:.0f} s: fit, {since_s:.0f} s after {' + '.join(trouble.faults)}")
        over = not self._later and not self.plant.displaced and since_s > WATCHED_S
        if over and trouble.ready_s is not None:
            trouble.recovered_s = trouble.ready_s
            trouble.same_run = trouble.run_id == status["run_id"]
            if trouble.reaction == "none" and not trouble.same_run:
                trouble.reaction = "next run as usual"
            self.say(
                f"{now_s / 3600:7.2f} h  {' + '.join(trouble.faults):28} in {trouble.state:10} -> "
                f"{trouble.reaction:28} READY after {trouble.recovered_s:6.0f} s"
                f"{'' if trouble.same_run else ', another run'}"
            )
            self._trouble = None
            self._next_fault_s = now_s + self.random.expovariate(1.0 / GAP_S)
        elif since_s > RECOVERY_S:
            self._give_up(f"not READY {RECOVERY_S:.0f} s after it: {status['state']} {status['reason']}")

    def _give_up(self, what: str) -> None:
        """Note that the service is stuck, and start it anew so that the soak can go on."""
        self.plant.ask_threads()
        during = " + ".join(self._trouble.faults) if self._trouble is not None else "no fault"
        self.stuck.append(f"at {self.plant.now_s():.0f} s, {during}: {what}")
        self.say(f"STUCK {self.stuck[-1]}")
        for _, _, undo in self._later:
            undo()
        self._later, self._trouble = [], None
        self.plant.kill_service()
        self.plant.start_service()
        self._seen_real_s = time.monotonic()

    # ------------------------------------------------------------------ the operator

    def _operate(self) -> None:
        status, now_s = self._status, self.plant.now_s()
        if self._waits():
            return
        if status["state"] == "READY":
            if self._next_run_s == 0.0:
                self._next_run_s = now_s + self.random.expovariate(1.0 / READY_S)
            elif now_s > self._next_run_s:
                self._start()
        elif "acknowledge" in status["allowed"]:
            self._command("acknowledge", status["run_id"])
        elif "start" in status["allowed"]:  # OFFLINE, ABORTED, or a READY that was withdrawn
            self._start()

    def _waits(self) -> bool:
        """Whether an operator would wait: the block has been turned out of its stated attitude and is to come back."""
        return self.plant.displaced and self._status["link"] == "STREAMING"

    def _start(self) -> None:
        self._next_run_s = 0.0
        self._read_run(self._status["run_id"])
        answer = self._post("/runs", {"method": self.random.choice(["optimal", "optimal", "paper"])})
        if answer is not None and answer.status_code == 202:
            run_id = answer.json()["run_id"]
            self.records.begun(run_id)
            self.records.accepted("start", run_id)

    def _command(self, command: str, run_id: str) -> None:
        self._read_run(run_id)
        answer = self._post(f"/runs/{run_id}/{command}", {"reason": "soak"})
        if answer is not None and answer.status_code == 202:
            self.records.accepted(command, run_id)

    def _post(self, path: str, body: dict[str, Any]) -> httpx.Response | None:
        try:
            return self.plant.client.post(path, json={**body, "operator": "soak"})
        except httpx.TransportError:
            return None

    # ------------------------------------------------------------------ faults

    def _befall(self) -> None:
        """Let the next fault happen when its time has come; the first waits for the first READY."""
        now_s, status = self.plant.now_s(), self._status
        if self._trouble is not None or now_s > self.end_s:
            return
        if self._next_fault_s == 0.0:
            if status["state"] == "READY":
                self._next_fault_s = now_s + self.random.expovariate(1.0 / GAP_S)
            return
        if now_s < self._next_fault_s:
            return
        wanted = [fault for fault in self.possible if status["link"] == "STREAMING" or not fault.needs_line]
        if now_s > ENDING * self.end_s:
            wanted = [fault for fault in wanted if not fault.ends]
        tried = [name for trouble in self.troubles for name in trouble.faults]
        fewest = min(tried.count(fault.name) for fault in wanted)
        first = self.random.choice([fault for fault in wanted if tried.count(fault.name) <= fewest + 1])
        chosen = [first]
        if self.random.random() < TWO_AT_ONCE:
            beside = [fault for fault in wanted if fault is not first and not (fault.turns and first.turns)]
            chosen.append(self.random.choice(beside))
        self._read_run(status["run_id"])
        self._trouble = Trouble([fault.name for fault in chosen], now_s, status["state"], status["run_id"])
        self.troubles.append(self._trouble)
        for fault in sorted(chosen, key=lambda fault: fault.ends):  # clients come while there is a service
            self._later += [(now_s + after_s, fault, undo) for after_s, undo in fault.begin(self.plant, self.random)]

    def _undo(self) -> None:
        """Do what is due; what needs the block waits until it streams."""
        now_s = self.plant.now_s()
        streams = self._status.get("link") == "STREAMING"
        due = [one for one in self._later if one[0] <= now_s and (streams or not one[1].needs_line)]
        for one in due:
            self._later.remove(one)
            one[2]()

    # ------------------------------------------------------------------ the outcome

    def outcome(self, kept: dict[str, int]) -> dict[str, Any]:
        """Return what is to be told."""
        lives = [
            spans(np.array(life.times)[late], np.array(life.own_mb)[late], SPAN_S)
            for life in self.lives
            if (late := np.array(life.times) > FIRST_S).any()
        ]
        trend = trend_of(lives)
        growth = None
        if trend is not None:
            per_day = 86_400.0
            growth = {
                "mb_per_day": trend.slope * per_day,
                "sigma_mb_per_day": trend.sigma * per_day,
                "upper_95_mb_per_day": trend.upper() * per_day,
                "correlation": trend.correlation,
                "freedom": trend.freedom,
                "p_value": trend.p_value,
            }
        return {
            "hours": self.plant.now_s() / 3600.0,
            "speed": self.plant.speed,
            "troubles": [vars(trouble) for trouble in self.troubles],
            "not_possible": [fault.name for fault in FAULTS if fault not in self.possible],
            "stuck": self.stuck,
            "false_fit": self.false_fit,
            "lost": self.records.lost,
            "kept": kept,
            "bad_ends": self.plant.bad_ends,
            "lives": len(self.lives),
            "largest_resident_mb": max((max(life.resident_mb, default=0.0) for life in self.lives), default=0.0),
            "largest_open_files": max((max(life.files, default=0) for life in self.lives), default=0),
            "growth": growth,
            "own_mb": [level.round(2).tolist() for _, level in lives],
        }


def _dwell_limits_s(speed: float) -> dict[str, float]:
    """Return how long each state may last [simulated s] by the settings' defaults and what a busy host may add."""
    sequence, slack_s = SequenceSettings(), SLACK_REAL_S * speed
    operator_s = slack_s + 120.0
    limits = {
        "POWER_UP": max(sequence.power_up_timeout_s, 5.0 * speed),
        "SELF_TEST": max(sequence.self_test_timeout_s, 5.0 * speed),
        "SETTLING": sequence.settling_max_s,
        "ALIGNING": sequence.align_s,
        "VERIFYING": sequence.verify_s + ESTIMATE_REAL_S * speed,
        "HOLD": sequence.hold_max_s,
        "READY": sequence.validity_s,
        **dict.fromkeys(("STAGE_1", "STAGE_2", "STAGE_3"), sequence.stage_s),
        **dict.fromkeys(("OFFLINE", "FAULT", "ABORTED"), operator_s),
    }
    return {state: limit_s + slack_s for state, limit_s in limits.items()}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description=__doc__)
    parser.add_argument("--hours", type=float, default=24.0, help="simulated hours (default %(default)s)")
    parser.add_argument("--speed", type=float, default=40.0, help="simulated s per real s (default %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of block, noise and faults (default %(default)s)")
    parser.add_argument("--json", type=Path, help="write the outcome to this file")
    parser.add_argument("--page", type=Path, help="renew the table of this page, e.g. docs/reliability.md")
    parser.add_argument("--keep", type=Path, help="keep settings, logs and store in this new folder")
    arguments = parser.parse_args()
    folder = arguments.keep or Path(tempfile.mkdtemp(prefix="inertrim-soak-"))
    plant = Plant(folder, arguments.seed, arguments.speed)
    soak = Soak(plant, arguments.seed, arguments.hours, lambda text: print(text, flush=True))
    try:
        soak.run()
        plant.close()
        found = soak.outcome(soak.records.check(plant.store, soak.unwritable))
        if arguments.keep and plant.own_disk:
            shutil.copytree(plant.disk, folder / "disk-kept")
    finally:
        plant.close()
        plant.unmount()
        if not arguments.keep:
            shutil.rmtree(folder, ignore_errors=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=2) + "\n")
    if arguments.page:
        write_page(arguments.page, found, arguments.seed)
    print(json.dumps({key: value for key, value in found.items() if key not in ("troubles", "own_mb")}, indent=2))
    raise SystemExit(any(found[what] for what in ("stuck", "lost", "bad_ends", "false_fit")))


if __name__ == "__main__":
    main()
