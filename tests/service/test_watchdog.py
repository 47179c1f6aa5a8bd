"""systemd's view: a real socket that hears READY, signs of life while the block is read, none while that hangs."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from forked import Program
from http_bench import settings_for

from service.controller import Controller
from service.watchdog import Notifier

ALLOWED_S = 0.4


@pytest.fixture
def systemd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """The socket that systemd gives a service of Type=notify, with WatchdogSec."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        heard.bind(str(tmp_path / "notify"))
        heard.settimeout(60.0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", str(int(ALLOWED_S * 1e6)))
        yield heard


def beats(heard: socket.socket, seconds: float) -> int:
    """Count the signs of life that come within a time."""
    count, end_s = 0, time.monotonic() + seconds
    while (left_s := end_s - time.monotonic()) > 0:
        heard.settimeout(left_s)
        try:
            count += heard.recv(100) == b"WATCHDOG=1"
        except TimeoutError:
            break
    return count


def test_a_hanging_acquisition_thread_gives_no_sign_of_life(systemd: socket.socket, tmp_path: Path) -> None:
    controller = Controller(settings_for(tmp_path), Notifier().beat)
    controller.start()
    try:
        assert systemd.recv(100) == b"WATCHDOG=1"
        assert beats(systemd, 2.0) >= 2  # four in ALLOWED_S where the host has time
        with controller._lock:  # as a deadlock would
            beats(systemd, 0.3)  # the turn in hand
            assert beats(systemd, 3 * ALLOWED_S) == 0
        assert beats(systemd, 2.0) >= 1
    finally:
        controller.stop()


def test_a_turn_that_fails_each_time_gives_no_sign_of_life(systemd: socket.socket, tmp_path: Path) -> None:
    controller = Controller(settings_for(tmp_path), Notifier().beat)
    controller.start()
    try:
        assert systemd.recv(100) == b"WATCHDOG=1"
        controller._acquisition._on_tick = None  # type: ignore[assignment]  # a fault of the program
        beats(systemd, 0.3)
        assert beats(systemd, 3 * ALLOWED_S) == 0
    finally:
        controller.stop()


def test_the_service_says_ready_once_it_listens_and_stopping_when_told_to(
    systemd: socket.socket, tmp_path: Path
) -> None:
    told = {name: value for name, value in os.environ.items() if name in ("NOTIFY_SOCKET", "WATCHDOG_USEC")}
    service = Program("serve", "--port", "0", folder=tmp_path, variables=told)
    try:
        heard = [systemd.recv(100)]
        while heard[-1] != b"READY=1":
            heard.append(systemd.recv(100))
        service.terminate()
        while heard[-1] != b"STOPPING=1":
            heard.append(systemd.recv(100))
    finally:
        service.terminate()
    assert service.wait(30) == 0
    assert set(heard) == {b"WATCHDOG=1", b"READY=1", b"STOPPING=1"}


def test_without_systemd_nothing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    monkeypatch.setenv("WATCHDOG_USEC", "1000")
    notifier = Notifier()
    notifier.ready()
    notifier.beat()
