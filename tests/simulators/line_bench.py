"""A host at the other end of a simulated block's line, as plain as can be: it reads everything and keeps it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import serial

from drivers.framing import Splitter
from drivers.messages import Command, Message
from drivers.protocols.native import Native
from drivers.samples import SampleArray
from drivers.timebase import Timebase
from inertial.documents import BlockModel
from simulators.scenarios import Scenario, demo_model, demo_scenario
from simulators.simulate import LineSimulator
from simulators.wire import Line, PtyLine

SPEED = 20.0


class Host:
    """Reads the line at ``url`` while :meth:`until` or :meth:`drain` runs; opens it again when it was pulled."""

    def __init__(self, url: str) -> None:
        self.url = url
        self.sequences: list[int] = []
        self.samples: list[SampleArray] = []
        self.messages: list[Message] = []
        self.bytes_read = 0
        self._protocol = Native()
        self._splitter = Splitter(self._protocol)
        self._decoder = self._protocol.decoder()
        self._port: serial.SerialBase | None = None
        self._number = 0

    def send(self, command: Command) -> None:
        """Send one command."""
        self._number += 1
        self._open().write(self._protocol.encode_message(command, self._number))

    def ask(self, command: Command, kind: type) -> Message:
        """Send a command and return the next message of a kind. A block that has not spoken yet may not hear yet."""
        self.until(lambda: self.bytes_read > 0)
        known = sum(isinstance(message, kind) for message in self.messages)
        self.send(command)
        self.until(lambda: sum(isinstance(message, kind) for message in self.messages) > known)
        return [message for message in self.messages if isinstance(message, kind)][-1]

    def until(self, condition: Callable[[], bool], timeout_s: float = 20.0) -> None:
        """Read until a condition holds."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline, f"waited {timeout_s} s in vain; last: {self.messages[-3:]}"
            self._read()

    def drain(self, while_running: threading.Thread) -> None:
        """Read on until the simulator has ended, then take what is held back behind a false header."""
        while while_running.is_alive():
            self._read()
        for frame in self._splitter.restart(time.monotonic()):
            self._keep([frame])

    def close(self) -> None:
        """Let go of the line."""
        if self._port is not None:
            self._port.close()
        self._port = None

    def _open(self) -> serial.SerialBase:
        if self._port is None:
            self._port = serial.serial_for_url(self.url, 921600, timeout=0.005)
        return self._port

    def _read(self) -> None:
        try:
            port = self._open()
            # A socket does not say how much waits; its reads end with their short time-out.
            data = port.read(600 if self.url.startswith("socket:") else max(1, port.in_waiting))
        except (OSError, serial.SerialException):
            self.close()
            time.sleep(0.002)
            return
        self.bytes_read += len(data)
        self._keep(self._splitter.feed(data, time.monotonic()))

    def _keep(self, frames: list) -> None:  # type: ignore[type-arg]
        decoded = self._decoder.decode(frames)
        self.samples += [decoded.samples]
        self.sequences += decoded.samples["sequence"].tolist()
        self.messages += [received.message for received in decoded.messages]


class Bench:
    """A simulated block that runs, and the host on its line."""

    def __init__(self, simulator: LineSimulator, host: Host) -> None:
        self.simulator, self.host = simulator, host
        self._stop = threading.Event()
        self.thread = threading.Thread(target=simulator.run, args=(self._stop,))

    def stop(self) -> None:
        """End the simulator; the host reads to the last."""
        self._stop.set()
        self.host.drain(self.thread)
        self.thread.join()

    def stop_unread(self) -> None:
        """End the simulator while the host sleeps."""
        self._stop.set()
        self.thread.join()


@contextmanager
def bench(
    folder: Path,
    scenario: Scenario | None = None,
    model: BlockModel | None = None,
    *,
    speed: float = SPEED,
    line: Line | None = None,
    url: Callable[[], str] | None = None,
    memory: Path | None = None,
) -> Iterator[Bench]:
    """Run a block on a pseudo-terminal, or on ``line``, with a host that has not opened it yet."""
    path = folder / "ttyINS"
    simulator = LineSimulator(
        scenario or demo_scenario(1),
        model or demo_model(1),
        line or PtyLine(path),
        timebase=Timebase(speed),
        memory=memory,
    )
    made = Bench(simulator, Host(str(path)))
    made.thread.start()
    deadline = time.monotonic() + 10.0
    while not (path.is_symlink() if url is None else simulator.plugged) and time.monotonic() < deadline:
        time.sleep(0.002)
    if url is not None:
        made.host.url = url()
    try:
        yield made
    finally:
        made.stop_unread()
        with suppress(OSError):
            made.host.close()
