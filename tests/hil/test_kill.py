"""SIGKILL in each state, and SIGTERM: what was recorded stays, the run is ABORTED with the reason, a new one starts."""

from __future__ import annotations

import io
import random
import time
from collections.abc import Iterator

import pyarrow.parquet as pq
import pytest
from line_service import Bench, Console, ServiceProcess, wait_for

from service.processes import free_port
from service.states import PATH
from service.store import Store


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    made = Bench(tmp_path_factory.mktemp("kill"))
    yield made
    made.close()


@pytest.mark.parametrize("state", [state.value for state in PATH])
def test_killed_in_any_state_nothing_recorded_is_lost_and_a_new_run_can_start(bench: Bench, state: str) -> None:
    wait_s = random.Random(state).uniform(0.0, 0.15)  # real seconds: a random point, the same each time
    service = ServiceProcess(bench, free_port())
    request = {"method": "optimal", "azimuth_deg": None, "alignment": None, "operator": "before"}
    key = f"key of {state}"
    run_id = service.client.post("/runs", json=request, headers={"Idempotency-Key": key}).json()["run_id"]
    reached = service.until(state)
    time.sleep(wait_s)
    seen = service.get(f"/runs/{run_id}")["transitions"]
    result = service.client.get(f"/runs/{run_id}/result")
    service.kill()

    console = Console(bench)  # the same store, opened again
    console.run_id = run_id
    status = console.facts()
    assert (status["state"], status["reason"], status["run_id"]) == ("ABORTED", "service_stopped", run_id)
    assert (status["fit"], status["allowed"]) == (False, ["start"])
    changes = console.changes()
    assert changes[: len(seen)] == [(one["source"], one["target"], one["reason"]) for one in seen]
    assert changes[-1][1:] == ("ABORTED", "service_stopped")
    document = console.controller.store.result(run_id)
    if state == "READY":
        assert reached["fit"]
        assert document == result.text
    elif state not in ("VERIFYING", "POWER_UP"):  # the one may end within the wait, the other says nothing yet
        assert document is None
    if state not in ("POWER_UP", "SELF_TEST"):
        assert len(console.kept_samples()) > 100
    again, new = console.controller.start_run(request, "before", key)
    assert (again, new) == (run_id, False)  # the key outlives the process as well
    second = console.start()
    console.until("SETTLING")
    console.close()  # what SIGTERM does
    store = Store(bench.folder / "inertrim.db")
    ended = store.run(second)
    store.close()
    assert ended is not None
    assert (ended.state, ended.reason) == ("ABORTED", "service_stopped")


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
    # The kill may have come before the recording was written: then it is made of the capture, in its own time.
    samples = f"/runs/{run_id}/samples"
    wait_for(lambda: service.client.get(samples).status_code == 200, lambda: service.client.get(samples).text)
    answer = service.client.get(samples)
    assert len(pq.read_table(io.BytesIO(answer.content))) > 500
    assert service.terminate() == 0
