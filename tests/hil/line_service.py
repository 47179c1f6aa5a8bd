"""The whole chain over a real pseudo-terminal: the simulator in its own process, the service in this one or its own."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import httpx
import tomli_w
from forked import Program

from drivers.recording import read_recording
from drivers.samples import SampleArray
from service.config import load_settings
from service.controller import Controller
from simulators.scenarios import demo_model, demo_scenario
from simulators.simulate import write_calibration

SPEED = 10.0
RATE_HZ = 50.0
STALE_S = 12.0
"""At that speed and rate a pseudo-terminal holds 0.6 real seconds of frames, and the line counts as stale after 1.2:
what is tested is the service, not whether a busy machine gives it a turn ten times a second."""
SEED = 1
WINDOWS = {"align_s": 6.0, "stage_s": 12.0, "verify_s": 10.0, "settling_window_s": 8.0}
"""Shorter than an operator's, so that a run takes some six seconds."""


class Bench:
    """One folder with everything in it, a simulated block on a line, and settings that fit."""

    def __init__(self, folder: Path, speed: float = SPEED, **sequence: float) -> None:
        self.folder, self.speed, self.epoch_s = folder, speed, time.monotonic()
        self.line = folder / "line"
        scenario, model = demo_scenario(SEED).warmed_up(), demo_model(SEED)
        block = scenario.block.model_copy(update={"sample_rate_hz": RATE_HZ})
        scenario = scenario.model_copy(update={"block": block})
        write_calibration(model, folder / "calibration.json")
        (folder / "block.json").write_text(model.canonical_json())
        written = scenario.model_dump(mode="json", exclude_none=True, by_alias=True, exclude_defaults=True)
        (folder / "scenario.toml").write_text(tomli_w.dumps(written))
        settings = {
            "link": {"url": str(self.line), "stale_after_s": STALE_S},
            "site": {"latitude_deg": 35.7, "height_m": 1200.0},
            "reference": scenario.reference.model_dump(exclude_none=True),
            "block": {"calibration": "calibration.json", "gyro_kind": "dtg"},
            "sequence": {**WINDOWS, **sequence},
            "store": {"path": "inertrim.db"},
            "time": {"speed": speed, "epoch_s": self.epoch_s},
        }
        self.config = folder / "settings.toml"
        self.config.write_text(tomli_w.dumps(settings))
        self._simulator = self._start_simulator()

    def _start_simulator(self) -> Program:
        files = {"--pty": self.line, "--scenario": self.folder / "scenario.toml", "--model": self.folder / "block.json"}
        timing = {"--speed": self.speed, "--epoch": self.epoch_s, "--ledger": self.folder / "ledger.json"}
        arguments = [str(part) for pair in {**files, **timing}.items() for part in pair]
        (heard, said), (told, events) = os.pipe(), os.pipe()
        process = Program("simulate", *arguments, "--control", stdin=heard, stdout=events)
        for end in (heard, events):
            os.close(end)
        self._say, self._told = open(said, "wb"), open(told, "rb")  # noqa: SIM115
        assert json.loads(self._told.readline())["event"] == "ready"
        return process

    def inject(self, fault: str, **facts: object) -> None:
        """Let a fault happen now."""
        self._say.write((json.dumps({"fault": fault, **facts}) + "\n").encode())
        self._say.flush()

    def wait_s(self, simulated_s: float) -> None:
        """Let simulated time pass."""
        time.sleep(simulated_s / self.speed)

    def close(self) -> dict[str, Any]:
        """End the simulator and return its ledger."""
        self._simulator.terminate()
        self._simulator.wait(20)
        self._say.close()
        self._told.close()
        ledger: dict[str, Any] = json.loads((self.folder / "ledger.json").read_text())
        return ledger


def wait_for(condition: Callable[[], bool], shown: Callable[[], object], limit_s: float = 60.0) -> None:
    """Wait (real seconds) for a condition."""
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end, shown()
        time.sleep(0.01)


class Console:
    """The service in this process, as the sequencer's owner sees it."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.controller = Controller(load_settings(bench.config))
        self.controller.start()
        self.run_id = ""

    def start(self) -> str:
        request = {"method": "optimal", "azimuth_deg": None, "alignment": None, "operator": "test"}
        self.run_id, _ = self.controller.start_run(request, "test")
        return self.run_id

    def facts(self) -> dict[str, Any]:
        return self.controller.status().facts

    def until(self, condition: Callable[[dict[str, Any]], bool] | str, limit_s: float = 60.0) -> dict[str, Any]:
        """Wait (real seconds) until the status fulfils a condition, or reaches a state."""
        end = time.monotonic() + limit_s
        while True:
            facts = self.facts()
            if facts["state"] == condition if isinstance(condition, str) else condition(facts):
                return facts
            assert time.monotonic() < end, f"waited for {condition}: {facts} {self.changes()}"
            time.sleep(0.002)

    def changes(self) -> list[tuple[str, str, str]]:
        """Return what has been recorded of the run: (from, to, reason)."""
        record = self.controller.store.run(self.run_id)
        assert record is not None
        return [(one["source"], one["target"], one["reason"]) for one in record.transitions]

    def recorded(self, target: str) -> list[tuple[str, str, str]]:
        """Return the changes once the store has the last one, which leads to ``target``."""
        wait_for(lambda: self.changes()[-1][1] == target, self.changes)
        return self.changes()

    def until_recorded(self, change: tuple[str, str, str]) -> None:
        """Wait until the store has a change."""
        wait_for(lambda: change in self.changes(), self.changes)

    def kept_samples(self) -> SampleArray:
        """Return the samples of the run once they are on disk."""
        path = self.controller.folder(self.run_id).recording
        wait_for(path.with_suffix(".toml").is_file, lambda: str(path))
        return read_recording(path).samples

    def close(self) -> None:
        self.controller.stop()


class Configured(Protocol):
    """A folder with settings in it."""

    @property
    def folder(self) -> Path:
        """Where the service writes."""

    @property
    def config(self) -> Path:
        """Its settings."""


class ServiceProcess:
    """The service as it is installed: a process with an HTTP port."""

    def __init__(self, bench: Configured, port: int) -> None:
        self._log = (bench.folder / "service.log").open("ab")
        self.process = Program(
            *("serve", "--config", bench.config, "--port", str(port)), stderr=self._log, stdout=self._log
        )
        self.client = httpx.Client(base_url=f"http://127.0.0.1:{port}/api/v1", timeout=10)
        end = time.monotonic() + 60
        while True:
            try:
                if self.client.get("/healthz").status_code == 200:
                    return
            except httpx.TransportError:
                pass
            assert self.process.poll() is None, (bench.folder / "service.log").read_text()
            assert time.monotonic() < end
            time.sleep(0.05)

    def get(self, path: str) -> Any:
        answer = self.client.get(path)
        answer.raise_for_status()
        return answer.json()

    def until(self, state: str, limit_s: float = 60.0) -> dict[str, Any]:
        end = time.monotonic() + limit_s
        while (status := self.get("/status"))["state"] != state:
            assert time.monotonic() < end, status
            time.sleep(0.01)
        return dict(status)

    def kill(self) -> None:
        """SIGKILL: nothing is said, nothing is finished."""
        self.process.kill()
        self._end()

    def terminate(self) -> int:
        """SIGTERM; return the exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self._end()

    def _end(self) -> int:
        code = self.process.wait(60)
        self.client.close()
        self._log.close()
        return code
