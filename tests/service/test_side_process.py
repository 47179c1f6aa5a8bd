"""The process for long work: what goes over and comes back, how it is replaced when it dies, and how it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import side_work

from drivers.samples import empty_samples
from service.side_process import NICENESS, ProcessDied, SideProcess, WorkFailed, WorkRefused

LIMIT_S = 60.0


@pytest.fixture
def side(monkeypatch: pytest.MonkeyPatch) -> Iterator[SideProcess]:
    monkeypatch.setenv("PYTHONPATH", str(Path(side_work.__file__).parent))  # the process imports it by its name
    made = SideProcess(partial(side_work.prepare, "ready"))
    made.start()
    yield made
    made.stop()


def wait_for(condition: Callable[[], object]) -> None:
    end_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.01)


def is_alive(pid: int) -> bool:
    """Whether a process runs; one that has ended, and that only nobody has waited for yet, does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        return state != "Z" or len(os.listdir(f"/proc/{pid}/task")) > 1  # the other threads end after the first
    except FileNotFoundError:
        return False


def test_work_is_done_in_one_other_process_of_lower_priority_that_was_prepared(side: SideProcess) -> None:
    first, second = side.call(side_work.about_process), side.call(side_work.about_process)
    assert first == second
    assert first["pid"] != os.getpid()
    assert first["niceness"] == min(os.getpriority(os.PRIO_PROCESS, 0) + NICENESS, 19)
    assert first["prepared"] == ["ready"]


def test_samples_arrive_as_they_were(side: SideProcess) -> None:
    samples = empty_samples(300_000, 2)  # far more than a socket holds
    samples["time"] = np.random.default_rng(1).normal(size=len(samples))
    view = samples[1000:]
    count, total, writeable, last = side.call(side_work.about_samples, view)
    assert (count, total, writeable) == (len(view), float(view["time"].sum()), False)
    assert last.tobytes() == view[-2:].tobytes()


def test_what_is_refused_and_what_fails_is_told_and_work_goes_on(side: SideProcess) -> None:
    process = side.call(side_work.about_process)
    with pytest.raises(WorkRefused, match=r"^the disk takes nothing$"):
        side.call(side_work.refuse)
    with pytest.raises(WorkFailed, match=r"side_work.py(.|\n)*ZeroDivisionError: nobody thought of this"):
        side.call(side_work.fail)
    assert side.call(side_work.about_process) == process


def test_work_is_done_also_where_preparing_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(side_work.__file__).parent))
    side = SideProcess(side_work.refuse)
    try:
        for _ in range(2):
            assert side.call(side_work.about_process)["prepared"] == []
    finally:
        side.stop()


def test_killed_at_work_it_is_replaced_and_the_work_done_again_once(side: SideProcess, tmp_path: Path) -> None:
    before = side.call(side_work.about_process)
    assert side.call(side_work.die, tmp_path / "once", 1) == "done"
    assert (tmp_path / "once").read_text() == "xx"
    with pytest.raises(ProcessDied, match="SIGKILL"):
        side.call(side_work.die, tmp_path / "always", 1000)
    assert (tmp_path / "always").read_text() == "xx"  # no third time
    after = side.call(side_work.about_process)  # and the next piece finds a process again
    assert after["pid"] != before["pid"]
    assert after["prepared"] == ["ready"]


def test_killed_while_idle_it_costs_the_next_work_no_try(side: SideProcess, tmp_path: Path) -> None:
    idle = side.call(side_work.about_process)["pid"]
    os.kill(idle, signal.SIGKILL)
    wait_for(lambda: not is_alive(idle))
    assert side.call(side_work.die, tmp_path / "once", 1) == "done"


def test_signals_that_mean_the_service_do_not_end_it(side: SideProcess) -> None:
    process = side.call(side_work.about_process)
    for number in (signal.SIGINT, signal.SIGTERM):
        os.kill(process["pid"], number)
    assert side.call(side_work.about_process) == process


def test_stop_ends_it_at_work(side: SideProcess, tmp_path: Path) -> None:
    refused: list[str] = []

    def call() -> None:
        try:
            side.call(side_work.stay_busy, tmp_path / "pid")
        except ProcessDied as error:
            refused.append(str(error))

    caller = threading.Thread(target=call)
    caller.start()
    wait_for(lambda: (tmp_path / "pid").exists() and (tmp_path / "pid").read_text())
    began_s = time.monotonic()
    side.stop()
    caller.join(LIMIT_S)
    assert time.monotonic() - began_s < 5.0
    assert refused == ["the service is ending"]
    assert not is_alive(int((tmp_path / "pid").read_text()))


@pytest.mark.parametrize("busy", [True, False])
def test_it_does_not_outlive_a_killed_owner(tmp_path: Path, busy: bool) -> None:
    note = tmp_path / "pid"
    work = (
        f"side.call(side_work.stay_busy, Path({str(note)!r}))"
        if busy
        else f"Path({str(note)!r}).write_text(str(side.call(side_work.about_process)['pid'])); time.sleep(300)"
    )
    program = (
        "import time, side_work; from functools import partial; from pathlib import Path\n"
        "from service.side_process import SideProcess\n"
        f"side = SideProcess(partial(side_work.prepare, 'ready')); side.start(); {work}"
    )
    folder = str(Path(side_work.__file__).parent)
    owner = subprocess.Popen([sys.executable, "-c", program], env={**os.environ, "PYTHONPATH": folder})
    try:
        wait_for(lambda: note.exists() and note.read_text())
        pid = int(note.read_text())
        assert is_alive(pid)
        owner.kill()
        owner.wait()
        wait_for(lambda: not is_alive(pid))
    finally:
        owner.kill()
