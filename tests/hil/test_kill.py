"""SIGKILL in each state, and SIGTERM: what was recorded stays, the run is ABORTED with the reason, a new one starts."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from line_service import Bench, ServiceProcess

from drivers.recording import read_recording
from service.processes import free_port
from service.states import PATH


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    made = Bench(tmp_path_factory.mktemp("kill"))
    yield made
    made.close()


def samples_of(service: ServiceProcess, run_id: str, folder: Path) -> int:
    """Return how many samples the API gives of a run, once they are there."""
    end = time.monotonic() + 20
    while (answer := service.client.get(f"/runs/{run_id}/samples")).status_code != 200:
        assert time.monotonic() < end, answer.text
        time.sleep(0.05)
    recording = read_recording(folder / "inertrim-runs" / run_id / "recording")
    assert recording.path.read_bytes() == answer.content
    return len(recording.samples)


@pytest.mark.parametrize("state", [state.value for state in PATH])
def test_killed_in_any_state_nothing_recorded_is_lost_and_a_new_run_can_start(bench: Bench, state: str) -> None:
    wait_s = random.Random(state).uniform(0.0, 0.15)  # real seconds: a random point, the same each time
    service = ServiceProcess(bench, free_port())
    began = service.client.post("/runs", json={"operator": "before"}, headers={"Idempotency-Key": state}).json()
    run_id = began["run_id"]
    reached = service.until(state)
    time.sleep(wait_s)
    seen = service.get(f"/runs/{run_id}")
    result = service.client.get(f"/runs/{run_id}/result")
    service.kill()

    service = ServiceProcess(bench, free_port())
    status = service.get("/status")
    assert (status["state"], status["reason"], status["run_id"]) == ("ABORTED", "service_stopped", run_id)
    assert not status["fit"]
    assert status["allowed"] == ["start"]
    run = service.get(f"/runs/{run_id}")
    assert (run["state"], run["reason"]) == ("ABORTED", "service_stopped")
    assert run["transitions"][: len(seen["transitions"])] == seen["transitions"]
    assert run["transitions"][-1]["target"] == "ABORTED"
    if state == "READY":
        assert reached["fit"]
        assert service.client.get(f"/runs/{run_id}/result").content == result.content
    elif state not in ("VERIFYING", "POWER_UP"):
        assert service.client.get(f"/runs/{run_id}/result").status_code == 404
    if state not in ("POWER_UP", "SELF_TEST"):
        assert samples_of(service, run_id, bench.folder) > 100
    again = service.client.post("/runs", json={"operator": "before"}, headers={"Idempotency-Key": state}).json()
    assert again["run_id"] == run_id  # the key outlives the process as well
    new = service.client.post("/runs", json={})
    assert new.status_code == 202, new.text
    service.until("SETTLING")
    assert service.terminate() == 0

    service = ServiceProcess(bench, free_port())
    ended = service.get(f"/runs/{new.json()['run_id']}")
    assert (ended["state"], ended["reason"]) == ("ABORTED", "service_stopped")
    service.kill()


def test_a_fault_stays_a_fault_until_somebody_acknowledges(bench: Bench) -> None:
    service = ServiceProcess(bench, free_port())
    run_id = service.client.post("/runs", json={}).json()["run_id"]
    service.until("ALIGNING")
    bench.inject("stuck_sensor", channel="accel_x", duration_s=1e6)
    service.until("FAULT")
    time.sleep(0.2)
    service.kill()
    service = ServiceProcess(bench, free_port())
    status = service.get("/status")
    assert (status["state"], status["reason"], status["allowed"]) == ("FAULT", "stuck_sensor", ["acknowledge"])
    assert service.client.post("/runs", json={}).status_code == 409
    answer = service.client.post(f"/runs/{run_id}/acknowledge", json={"operator": "Ada", "reason": "sensor replaced"})
    assert answer.status_code == 202
    service.until("OFFLINE")
    assert service.terminate() == 0
