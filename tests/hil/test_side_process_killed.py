"""The process that estimates is killed at work, and the service with it: the run goes on, and nobody is left over."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from line_service import Bench, ServiceProcess, wait_for

from drivers.recording import read_recording
from inertial.documents import Result, parse_document
from service.compensate import compensate
from service.processes import free_port


@pytest.fixture
def service(bench: Bench) -> Iterator[ServiceProcess]:
    made = ServiceProcess(bench, free_port())
    yield made
    made.kill()


def children(pid: int, module: str) -> list[int]:
    """Return the processes of a module that a process has started."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == pid and module.encode() in (folder / "cmdline").read_bytes().split(b"\0"):
                found.append(int(folder.name))
        except (FileNotFoundError, ProcessLookupError):
            continue
    return found


def is_gone(pid: int) -> bool:
    """Whether a process has ended; it may wait for whoever inherited it to take note."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def test_killed_at_its_last_estimate_the_run_ends_as_it_would_have(bench: Bench, service: ServiceProcess) -> None:
    run_id = service.client.post("/runs", json={}).json()["run_id"]
    service.until("VERIFYING")
    wait_for(lambda: len(service.get(f"/runs/{run_id}")["terms"]) == 3, lambda: service.get(f"/runs/{run_id}"))
    (working,) = children(service.process.pid, "service.side_process")
    os.kill(working, signal.SIGSTOP)  # so that it is at work when it dies, however quick it is
    wait_for(lambda: service.get("/status")["progress"] == 1.0, lambda: service.get("/status"))
    time.sleep(0.3)
    assert service.get("/status")["state"] == "VERIFYING"
    os.kill(working, signal.SIGKILL)
    assert service.until("READY")["fit"]

    assert children(service.process.pid, "service.side_process") != [working]
    found = parse_document(Result, service.client.get(f"/runs/{run_id}/result").content, "result")
    again = compensate(read_recording(bench.folder / "inertrim-runs" / run_id / "recording.parquet"))
    assert (again.terms, again.covariance) == (found.terms, found.covariance)  # bit for bit
    assert "side process" in (bench.folder / "service.log").read_text()


def test_killed_at_each_try_the_run_is_a_fault_that_says_so(service: ServiceProcess) -> None:
    service.client.post("/runs", json={}).raise_for_status()
    service.until("VERIFYING")
    killed: set[int] = set()
    end_s = time.monotonic() + 120.0
    while (status := service.get("/status"))["state"] == "VERIFYING":
        for pid in children(service.process.pid, "service.side_process"):
            os.kill(pid, signal.SIGKILL)
            killed.add(pid)
        assert time.monotonic() < end_s, status
        time.sleep(0.05)
    assert (status["state"], status["reason"]) == ("FAULT", "estimation_failed")
    assert "SIGKILL" in status["detail"]
    assert len(killed) >= 2


def test_a_killed_service_leaves_nobody(service: ServiceProcess) -> None:
    service.client.post("/runs", json={}).raise_for_status()
    service.until("STAGE_2")
    left = children(service.process.pid, "service.side_process")
    assert len(left) == 1
    service.process.kill()
    wait_for(lambda: all(map(is_gone, left)), lambda: left)


def test_a_stopped_service_leaves_nobody(service: ServiceProcess) -> None:
    left = children(service.process.pid, "service.side_process")
    assert len(left) == 1
    assert service.terminate() == 0
    assert all(map(is_gone, left))
