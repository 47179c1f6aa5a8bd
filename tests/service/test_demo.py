"""The demo as a newcomer runs it: one command, a real line, a real service, and everything gone afterwards."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import httpx
import pytest

from drivers.recording import read_recording
from inertial.documents import Result, parse_document
from service.demo import Console, DemoFailed
from service.processes import Processes, ProcessFailed, free_port
from service.report import render

DEG_H_RADPS = math.pi / 180 / 3600
MG_MPS2 = 9.80665e-3
Facts = dict[str, Any]


def test_a_demo_on_defaults(tmp_path: Path) -> None:
    """One demo, judged in all it says: run once, since it takes a minute."""
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "service.cli",
            "demo",
            "--out",
            str(tmp_path / "out"),
            "--json",
            str(tmp_path / "demo.json"),
        ],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "READY" in done.stdout
    facts: Facts = json.loads((tmp_path / "demo.json").read_text())
    ends_ready_at_twenty_times_real_time(facts)
    finds_what_was_planted(facts)
    improves_navigation(facts)
    leaves_what_it_names(facts)


def ends_ready_at_twenty_times_real_time(facts: Facts) -> None:
    assert facts["state"] == "READY"
    assert facts["verdict"] == "shift compensated"
    assert facts["time"]["speed"] >= 20


def finds_what_was_planted(facts: Facts) -> None:
    assert [abs(value) for value in facts["planted"]["g_radps"]] == pytest.approx([2.4 * DEG_H_RADPS] * 3)
    assert [abs(value) for value in facts["planted"]["f_mps2"]] == pytest.approx([0.3 * MG_MPS2] * 3)
    assert set(facts["terms"]) == {"stage_1", "stage_2", "stage_3", "final"}
    assert max(facts["distance_sigma"][2:]) < 3  # vertical accelerometer and gyros


def improves_navigation(facts: Facts) -> None:
    for trial in ("rest", "turn"):
        error = facts["radial_error_m"][trial]
        assert facts["improvement"][trial] == pytest.approx(error["without"] / error["with"])
        assert facts["improvement"][trial] > 3


def leaves_what_it_names(facts: Facts) -> None:
    assert facts["replay_identical"]
    result = parse_document(Result, Path(facts["paths"]["result"]).read_bytes(), "result.json")
    assert result.fit
    assert result.model_dump(mode="json")["terms"] == facts["terms"]
    assert Path(facts["paths"]["report"]).read_text() == render(result)
    run = read_recording(facts["paths"]["recording"])
    assert [window.kind for window in run.meta.window] == ["align", "stage_1", "stage_2", "stage_3", "verify"]
    for name in ("rest", "turn"):
        assert read_recording(facts["paths"][name]).samples["time"][-1] == pytest.approx(300.0)


def test_children_end_with_their_parent(tmp_path: Path) -> None:
    """SIGTERM to the demo's process ends the processes that it started."""
    code = (
        "import sys, time; from pathlib import Path; from service.processes import Processes\n"
        "with Processes() as children:\n"
        "    children.start('block', ['simulate', '--pty', sys.argv[1]], Path(sys.argv[2]))\n"
        "    print(children.pids()[0], flush=True)\n"
        "    time.sleep(60)\n"
    )
    pty, log = tmp_path / "block.pty", tmp_path / "log"
    parent = subprocess.Popen([sys.executable, "-c", code, str(pty), str(log)], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    end = time.monotonic() + 60
    while not pty.exists() and time.monotonic() < end:
        time.sleep(0.05)
    parent.send_signal(signal.SIGTERM)
    assert parent.wait(timeout=20) == 128 + signal.SIGTERM
    parent.stdout.close()
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)
    assert not pty.exists()


def test_child_that_ends_by_itself_is_reported_with_its_last_words(tmp_path: Path) -> None:
    with Processes() as children:
        children.start("service", ["serve", "--config", str(tmp_path / "none.toml")], tmp_path / "log")
        os.waitid(os.P_PID, children.pids()[0], os.WEXITED | os.WNOWAIT)
        with pytest.raises(ProcessFailed, match=r"the service ended with code 2: inertrim: .*none\.toml"):
            children.check()


def test_service_that_does_not_answer_is_said_in_a_line() -> None:
    url = f"http://127.0.0.1:{free_port()}"
    with (
        Processes() as none,
        httpx.Client(base_url=url) as client,
        pytest.raises(DemoFailed, match=r"GET /api/v1/status got no answer .*service\.log"),
    ):
        Console(client, none).get("/api/v1/status")


def test_service_that_died_is_told_from_one_that_does_not_answer(tmp_path: Path) -> None:
    with Processes() as children, httpx.Client(base_url=f"http://127.0.0.1:{free_port()}") as client:
        children.start("service", ["serve", "--config", str(tmp_path / "none.toml")], tmp_path / "log")
        os.waitid(os.P_PID, children.pids()[0], os.WEXITED | os.WNOWAIT)
        with pytest.raises(ProcessFailed, match="the service ended with code 2"):
            Console(client, children).get("/api/v1/status")


def test_free_port_can_be_listened_on() -> None:
    assert 1024 < free_port() < 65536
