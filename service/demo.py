"""The main job shown end to end: a simulated block on a pty, the real service, driven over HTTP as a console does."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import tomli_w

from drivers.recording import read_recording
from inertial.documents import BlockModel, Result, parse_document
from service.compensate import compensate
from service.methods import DEFAULT_METHOD
from service.processes import Processes, free_port
from service.trials import distances, planted, trials, worth
from simulators.scenarios import Scenario, demo_model, demo_scenario
from simulators.simulate import write_calibration

START_TIMEOUT_S = 90.0
"""Real seconds that a cold start (first compilation included) may take on a busy machine."""
RUN_TIMEOUT_S = 1800.0
"""Simulated seconds in which a run must end."""
ENDED = ("READY", "FAULT", "ABORTED")
POLL_S = 0.1

Show = Callable[[dict[str, Any]], None]


class DemoFailed(RuntimeError):
    """The demo could not be carried through; the text says where it stuck and where to look."""


@dataclass(frozen=True)
class Folder:
    """What the demo leaves behind, all in one folder."""

    path: Path

    def make(self) -> None:
        """Make the folder, without what a demo before left there."""
        self.path.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(self.runs, ignore_errors=True)
        for old in self.path.glob("inertrim.db*"):
            old.unlink()
        self.pty.unlink(missing_ok=True)

    @property
    def pty(self) -> Path:
        """Where the simulated block's line appears."""
        return self.path / "block.pty"

    @property
    def runs(self) -> Path:
        """Where the service keeps its runs, beside its database."""
        return self.path / "inertrim-runs"

    def file(self, name: str) -> Path:
        """Return a file of the demo."""
        return self.path / name


@dataclass(frozen=True)
class Console:
    """What a launch console does: wait for the service, start a run, follow it, fetch what it found."""

    client: httpx.Client
    processes: Processes

    def wait_for_service(self) -> None:
        """Wait until the service answers."""
        self._until(self._answers, "the service to answer")

    def start_run(self, method: str) -> str:
        """Start a run as soon as the service allows it; return the run's id."""
        self._until(lambda: "start" in self.get("/api/v1/status")["allowed"], "the service to allow a run")
        answer = self._ask("POST", "/api/v1/runs", {"method": method, "operator": "demo"})
        return str(answer.json()["run_id"])

    def follow(self, run_id: str, show: Show, limit_s: float) -> dict[str, Any]:
        """Show every status until the run has ended; return the last one."""
        end = time.monotonic() + limit_s
        while time.monotonic() < end:
            self.processes.check()
            status: dict[str, Any] = self.get("/api/v1/status")
            show(status)
            if status["state"] in ENDED:
                return status
            if status["state"] == "HOLD" and (verified := self._verified(run_id)) is not None:
                return {**status, **verified}
            time.sleep(POLL_S)
        raise DemoFailed(f"the run did not end in {limit_s:.0f} s; it stands in {status['state']}: {status['reason']}")

    def _verified(self, run_id: str) -> dict[str, Any] | None:
        """Return what the run came to if it was READY between two looks: on a busy host that may not last."""
        ready = [one for one in self.get(f"/api/v1/runs/{run_id}")["transitions"] if one["target"] == "READY"]
        return {"state": "READY", "reason": ready[0]["reason"]} if ready else None

    def get(self, path: str) -> Any:
        """Return the JSON at a path."""
        return json.loads(self.fetch(path))

    def fetch(self, path: str) -> bytes:
        """Return what lies at a path."""
        return self._ask("GET", path).content

    def _ask(self, method: str, path: str, document: dict[str, str] | None = None) -> httpx.Response:
        try:
            answer = self.client.request(method, path, json=document)
        except httpx.TransportError as error:
            self.processes.check()
            raise DemoFailed(
                f"{method} {path} got no answer ({error}); service.log in the demo's folder says more"
            ) from None
        if not answer.is_success:
            raise DemoFailed(f"{method} {path} answered {answer.status_code}: {answer.text}")
        return answer

    def _answers(self) -> bool:
        try:
            return self.client.get("/healthz").is_success
        except httpx.TransportError:
            return False

    def _until(self, condition: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + START_TIMEOUT_S
        while not condition():
            self.processes.check()
            if time.monotonic() > end:
                raise DemoFailed(f"waited {START_TIMEOUT_S:.0f} s for {what}; the logs in the demo's folder say more")
            time.sleep(POLL_S)


def run_demo(path: Path, seed: int, speed: float, show: Show) -> dict[str, Any]:
    """Run the whole chain once and return its facts.

    Parameters
    ----------
    path
        Folder for everything the demo leaves: configuration, database, recordings, result, report, logs.
    seed
        Draws shifts, reference errors and noise.
    speed
        Simulated seconds per real second.
    show
        Called with every status of the service.

    Raises
    ------
    DemoFailed, ProcessFailed
        The run could not be carried through. A run that does not end READY is no error.
    """
    folder = Folder(path)
    folder.make()
    scenario, model = demo_scenario(seed), demo_model(seed)
    with Processes() as processes:
        port = free_port()
        epoch_s = time.monotonic()
        _start_block(processes, folder, scenario, model, speed, epoch_s)
        _start_service(processes, folder, scenario, model, speed, epoch_s, port)
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=10.0) as client:
            console = Console(client, processes)
            console.wait_for_service()
            run_id = console.start_run(DEFAULT_METHOD)
            begun_s = time.monotonic()
            status = console.follow(run_id, show, RUN_TIMEOUT_S / speed + START_TIMEOUT_S)
            took_s = time.monotonic() - begun_s
            if status["state"] == "READY":
                folder.file("result.json").write_bytes(console.fetch(f"/api/v1/runs/{run_id}/result"))
                folder.file("report.html").write_bytes(console.fetch(f"/api/v1/runs/{run_id}/report"))
    facts: dict[str, Any] = {
        "state": status["state"],
        "reason": status["reason"],
        "reasons": status["reasons"],
        "run_id": run_id,
        "seed": seed,
        "planted": planted(scenario, model),
        "time": {"speed": speed, "real_s": took_s, "simulated_s": took_s * speed},
        "line": _line_counts(folder.file("line.json")),
        "paths": {"folder": str(path), "logs": str(path)},
    }
    if status["state"] != "READY":
        return facts
    return {**facts, **_findings(folder, run_id, scenario, model)}


def _findings(folder: Folder, run_id: str, scenario: Scenario, model: BlockModel) -> dict[str, Any]:
    """Return what the run found, what it is worth, and whether its recording gives the same again."""
    result = parse_document(Result, folder.file("result.json").read_bytes(), "result.json")
    recording = folder.runs / run_id / "recording.parquet"
    again = compensate(read_recording(recording))
    made = trials(scenario, model, folder.path)
    return {
        "verdict": result.verdict,
        "reasons": result.reasons,
        "terms": {stage: terms.model_dump() for stage, terms in result.terms.items()},
        "sigma": result.sigma.model_dump(),
        "distance_sigma": distances(scenario, model, result),
        "replay_identical": again.terms == result.terms,
        **worth(made, result),
        "paths": {
            "folder": str(folder.path),
            "recording": str(recording),
            "result": str(folder.file("result.json")),
            "report": str(folder.file("report.html")),
            "rest": str(made["rest"].path),
            "turn": str(made["turn"].path),
            "configuration": str(folder.file("inertrim.toml")),
            "logs": str(folder.path),
        },
    }


def _start_block(
    processes: Processes, folder: Folder, scenario: Scenario, model: BlockModel, speed: float, epoch_s: float
) -> None:
    document = scenario.model_dump(mode="json", exclude_none=True)
    folder.file("scenario.toml").write_text(tomli_w.dumps({key: value for key, value in document.items() if value}))
    folder.file("block.json").write_text(model.canonical_json())
    folder.file("line.json").unlink(missing_ok=True)
    arguments = ["simulate", "--pty", str(folder.pty), "--scenario", str(folder.file("scenario.toml"))]
    arguments += ["--model", str(folder.file("block.json")), "--speed", str(speed), "--epoch", repr(epoch_s)]
    arguments += ["--ledger", str(folder.file("line.json"))]
    processes.start("simulated block", arguments, folder.file("block.log"))
    end = time.monotonic() + START_TIMEOUT_S
    while not folder.pty.exists():
        processes.check()
        if time.monotonic() > end:
            raise DemoFailed(f"the simulated block did not appear at {folder.pty} in {START_TIMEOUT_S:.0f} s")
        time.sleep(POLL_S)


def _start_service(
    processes: Processes,
    folder: Folder,
    scenario: Scenario,
    model: BlockModel,
    speed: float,
    epoch_s: float,
    port: int,
) -> None:
    """Start the service on the block's line, with what a launcher knows: site, reference, calibration."""
    write_calibration(model, folder.file("calibration.json"))
    configuration = {
        "link": {"url": str(folder.pty.absolute()), "protocol": "native"},
        "site": scenario.site.model_dump(exclude_none=True),
        "reference": scenario.reference.model_dump(exclude_none=True),
        "block": {"calibration": "calibration.json", "gyro_kind": model.gyro_kind},
        "store": {"path": "inertrim.db"},
        "http": {"host": "127.0.0.1", "port": port},
        "time": {"speed": speed, "epoch_s": epoch_s},
    }
    folder.file("inertrim.toml").write_text(tomli_w.dumps(configuration))
    processes.start("service", ["serve", "--config", str(folder.file("inertrim.toml"))], folder.file("service.log"))


def _line_counts(ledger: Path) -> dict[str, Any]:
    """Return what the line's ledger counts, without its list of every frame touched."""
    if not ledger.exists():
        return {}
    counts: dict[str, Any] = json.loads(ledger.read_text())
    return {name: value for name, value in counts.items() if name != "cycles"}
