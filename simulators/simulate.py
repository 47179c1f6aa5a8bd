"""Run a scenario: onto a line, in simulated time, or into a recording at once."""

from __future__ import annotations

import json
import os
import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from drivers.protocols.base import Protocol
from drivers.protocols.native import DEFAULT_BIT_RATE, Native
from drivers.recording import write_recording
from drivers.timebase import Timebase
from inertial.documents import BlockModel, Calibration
from simulators.device import Device, TermMemory
from simulators.errors import ScenarioError
from simulators.model_store import load_model
from simulators.scenarios import (
    FAULT,
    Fault,
    Heat,
    Move,
    NoisyLine,
    Restart,
    Scenario,
    StuckSensor,
    Unplug,
    make_block,
)
from simulators.wire import MAX_TICK_S, Ledger, Line, Noise, PtyLine, TcpLine, Uart

LONGEST_WAIT_S = 0.008
"""Real time [s] after which the simulator looks round even when nothing is due."""
SHORTEST_WAIT_S = 0.001
CATCH_UP = 2.0

Report = Callable[[dict[str, Any]], None]


def simulate_recording(
    scenario: Scenario, out: Path, *, model: BlockModel | None = None, seed: int | None = None
) -> Path:
    """Write the recording that the scenario's block would make, and its laboratory calibration beside it.

    Parameters
    ----------
    out : NAME, as for ``write_recording``. ``calibration.json`` goes into the same folder, under the name that the
        scenario's ``[block] calibration`` gives.
    model : the block; default is the one that ``[block] model`` names, relative to ``out``'s folder.
    seed : of the noise, in place of the scenario's.

    Returns
    -------
    The data file.

    Raises
    ------
    ScenarioError
        The scenario or the model cannot be simulated.
    """
    if seed is not None:
        scenario = scenario.with_seed(seed)
    out = Path(out)
    model = model or model_of(scenario, out.parent)
    block = make_block(scenario, model)
    samples = block.generate(round(scenario.duration_s * block.rate_hz))
    name = scenario.block.calibration or "calibration.json"
    meta = scenario.recording_meta()
    meta = meta.model_copy(
        update={"block": meta.block.model_copy(update={"calibration": name, "gyro_kind": model.gyro_kind})}
    )
    out.parent.mkdir(parents=True, exist_ok=True)
    write_calibration(model, out.parent / name)
    return write_recording(out, samples, meta)


def write_calibration(model: BlockModel, path: Path) -> Path:
    """Write what the laboratory knows of a simulated block: its coefficients."""
    calibration = Calibration(
        block=model.block, method="simulated: the model's own coefficients", coefficients=model.calibration
    )
    partial = path.with_name(path.name + ".part")
    partial.write_text(calibration.canonical_json())
    os.replace(partial, path)
    return path


def model_of(scenario: Scenario, folder: Path) -> BlockModel:
    """Return the model that the scenario names, a path relative to ``folder``.

    Raises
    ------
    ScenarioError
        It names none.
    DocumentError
        The model is damaged or newer.
    """
    if scenario.block.model is None:
        raise ScenarioError("no block model: the scenario's [block] names none; give one with --model")
    return load_model(folder / scenario.block.model)


def _unheard(event: dict[str, Any]) -> None:
    """Report to nobody."""


class LineSimulator:
    """A scenario's block on one end of a line.

    Faults come from the scenario at their time and from :meth:`inject` at any time, from any thread.
    """

    def __init__(
        self,
        scenario: Scenario,
        model: BlockModel,
        line: Line,
        *,
        timebase: Timebase,
        protocol: Protocol | None = None,
        bit_rate: int = DEFAULT_BIT_RATE,
        memory: Path | None = None,
        report: Report | None = None,
    ) -> None:
        self.ledger = Ledger()
        self._timebase = timebase
        self._report = report or _unheard
        self._device = Device(
            scenario,
            model,
            protocol or Native(),
            bit_rate=bit_rate,
            memory=TermMemory(memory),
            now_s=timebase.now_s(),
        )
        self._uart = Uart(line, bit_rate, timebase.speed, self.ledger)
        self._noise = Noise(scenario.scenario.seed, self.ledger)
        self._line = line
        self._planned = sorted((f for f in scenario.fault if f.at_s is not None), key=lambda f: f.at_s or 0.0)
        self._asked: queue.SimpleQueue[Fault] = queue.SimpleQueue()
        for fault in scenario.fault:
            if fault.at_s is None:
                self._asked.put(fault)
        self._ends: list[tuple[float, NoisyLine | Unplug]] = []
        self._rate_hz = scenario.block.sample_rate_hz
        self._now_s = timebase.now_s()
        self._turned_at = time.monotonic()

    @property
    def plugged(self) -> bool:
        """Whether the line is there."""
        return self._uart.plugged

    def inject(self, fault: Fault) -> None:
        """Let a fault happen now; its ``at_s`` does not matter."""
        self._asked.put(fault)

    def run(self, stop: threading.Event, control: int | None = None) -> Ledger:
        """Stream until ``stop`` is set. ``control`` is a file descriptor of which lines of JSON are read as faults.

        A line is ``{"fault": KIND, …}`` with the keys of a ``[[fault]]``, for example
        ``{"fault": "unplug", "duration_s": 3}``.
        """
        orders = _Orders(control, self.inject, self._report)
        self._uart.plug()
        self._report({"event": "ready"})
        try:
            while not stop.is_set():
                self._turn()
                self._line.wait(self._pause_s(), orders.file)
                orders.read()
        finally:
            self._uart.close()
        return self.ledger

    def _turn(self) -> None:
        now_s = self._now_s = self._tick()
        if self._uart.plugged:
            self._device.receive(self._line.read(), now_s)
        for frame in self._device.advance(now_s):
            self._uart.send(self._noise.spoil(frame))
        self._uart.turn()
        self._faults(now_s)  # last: what was due before a fault, also of a block that lags, is untouched by it

    def _tick(self) -> float:
        """Return the block's time: simulated time, or behind it for a while when the host has held this process up.

        It then catches up at twice the speed. All at once would flood a reader that is not to blame.
        """
        turned_at, self._turned_at = self._turned_at, time.monotonic()
        elapsed_s = min(self._turned_at - turned_at, MAX_TICK_S)
        return min(self._timebase.now_s(), self._now_s + CATCH_UP * elapsed_s * self._timebase.speed)

    def _pause_s(self) -> float:
        """Return how long to sleep [real s]: less when frames come fast, least while bytes wait."""
        if not self._uart.idle:
            return SHORTEST_WAIT_S
        frame_s = self._timebase.real_s(1.0 / self._rate_hz)
        return min(max(frame_s / 2, SHORTEST_WAIT_S), LONGEST_WAIT_S)

    def _faults(self, now_s: float) -> None:
        for end in [end for end in self._ends if end[0] <= now_s]:
            self._ends.remove(end)
            self._end(end[1])
        began_s = self._device.streaming_since_s
        while self._planned and began_s is not None and now_s - began_s >= (self._planned[0].at_s or 0.0):
            fault = self._planned.pop(0)
            self._begin(fault, now_s, planned=True)
        while not self._asked.empty():
            self._begin(self._asked.get(), now_s, planned=False)

    def _begin(self, fault: Fault, now_s: float, *, planned: bool) -> None:
        match fault:
            case NoisyLine():
                self._noise.active.append(fault)
                if fault.duration_s is not None:
                    self._ends.append((now_s + fault.duration_s, fault))
            case Unplug():
                self._uart.unplug()
                self._ends.append((now_s + fault.duration_s, fault))
            case Restart():
                self._device.restart(now_s)
            case Move() if not planned:  # planned ones are in the block's motion from the start, to the sample
                self._device.move(fault, now_s)
            case StuckSensor() if not planned:
                self._device.stick(fault, now_s)
            case Heat() if not planned:
                self._device.heat(fault)
        self._book("fault", fault, now_s)

    def _end(self, fault: NoisyLine | Unplug) -> None:
        if isinstance(fault, NoisyLine):
            self._noise.active.remove(fault)
        elif not self._uart.plugged:
            self._uart.plug()
        self._book("fault over", fault, self._now_s)

    def _book(self, event: str, fault: Fault, now_s: float) -> None:
        began_s = self._device.streaming_since_s
        since_s = None if began_s is None else now_s - began_s
        booked = {"event": event, **fault.model_dump(exclude_none=True), "happened_s": since_s}
        self.ledger.faults.append(booked)
        self._report(booked)


class _Orders:
    """Lines of JSON from a file descriptor, read without waiting."""

    def __init__(self, file: int | None, inject: Callable[[Fault], None], report: Report) -> None:
        self.file = file
        self._inject, self._report = inject, report
        self._partial = b""
        if file is not None:
            os.set_blocking(file, False)

    def read(self) -> None:
        """Obey the lines that have come; an end of file is the end of orders."""
        if self.file is None:
            return
        try:
            data = os.read(self.file, 65536)
        except BlockingIOError:
            return
        if not data:
            self.file = None
            return
        *lines, self._partial = (self._partial + data).split(b"\n")
        for line in filter(None, map(bytes.strip, lines)):
            self._obey(line)

    def _obey(self, line: bytes) -> None:
        try:
            order = json.loads(line)
            fault = FAULT.validate_python({"kind": order.pop("fault"), **order})
        except (ValueError, KeyError, AttributeError, TypeError, ValidationError) as error:
            reason = error.errors()[0]["msg"] if isinstance(error, ValidationError) else str(error)
            self._report({"event": "refused", "line": line.decode(errors="replace"), "reason": reason})
        else:
            self._inject(fault)


def run_on_line(
    scenario: Scenario,
    model: BlockModel,
    *,
    path: Path | None = None,
    tcp_port: int | None = None,
    timebase: Timebase,
    stop: threading.Event,
    protocol: Protocol | None = None,
    bit_rate: int = DEFAULT_BIT_RATE,
    memory: Path | None = None,
    ledger: Path | None = None,
    control: int | None = None,
    report: Report | None = None,
) -> Ledger:
    """Run a scenario's block on a pseudo-terminal at ``path`` or on a TCP port until ``stop`` is set.

    Parameters
    ----------
    memory : file in which the block keeps its terms beyond this run.
    ledger : file that gets the ledger as JSON at the end.
    control : file descriptor for faults at run time, see :meth:`LineSimulator.run`.
    report : called with events: ``ready``, each ``fault`` and ``fault over``, ``refused`` lines of control.

    Raises
    ------
    ScenarioError, ProtocolError
        The scenario cannot be run.
    """
    if (path is None) == (tcp_port is None):
        raise ScenarioError("give a path for a pseudo-terminal or a TCP port, one of the two")
    line: Line = PtyLine(path) if path is not None else TcpLine(tcp_port or 0)
    simulator = LineSimulator(
        scenario, model, line, timebase=timebase, protocol=protocol, bit_rate=bit_rate, memory=memory, report=report
    )
    try:
        return simulator.run(stop, control)
    finally:
        if ledger is not None:
            ledger.write_text(json.dumps(simulator.ledger.as_json(), indent=1) + "\n")
