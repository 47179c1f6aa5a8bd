"""The line and the thread that reads it: batches to the sequencer, bytes to the capture of the run in hand."""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import structlog

from drivers.capture import CaptureError, CaptureWriter, RecordKind, describe_line
from drivers.commands import CommandChannel, CommandError
from drivers.link import SerialLink
from drivers.messages import (
    Command,
    Compensation,
    Configuration,
    Identity,
    Message,
    ReadCompensation,
    ReadIdentity,
    Received,
    SelfTest,
    SelfTestResult,
    Start,
    WriteCompensation,
)
from drivers.protocols import get_protocol
from drivers.protocols.base import Protocol
from drivers.samples import SampleArray
from drivers.timebase import Timebase
from inertial.documents import StageTerms
from service.config import LinkSettings
from service.orders import Question
from service.sequencer import LineView

log = structlog.get_logger()

READ_WAIT_S = 0.05
"""Real seconds that one look at the line may take; also how often time is told."""
SELF_TEST_WAIT_S = 5.0
"""Simulated seconds that a block may take for its self-test."""
SELF_TEST_HOST_S = 2.0
"""Real seconds that it is given at least, however fast simulated time runs."""


class RunCapture(CaptureWriter):
    """Raw capture that changes its file from run to run, and writes nothing between runs.

    A disk that fails ends the capture of that run and is counted; the line and later runs go on.
    """

    def __init__(self, protocol: Protocol, bit_rate: float) -> None:
        self._protocol, self._bit_rate = protocol, bit_rate
        self._writer: CaptureWriter | None = None
        self.failures = 0

    def begin(self, path: Path, about: bytes, host_time_s: float) -> None:
        """Write to ``path`` from now on."""
        self.close()
        try:
            self._writer = CaptureWriter(path, protocol=self._protocol, bit_rate=self._bit_rate, packed=True)
        except CaptureError as error:
            self.failures += 1
            log.error("capture", error=str(error))
            return
        self.write(about, host_time_s, RecordKind.OPENED)

    def write(self, data: bytes, host_time_s: float, kind: RecordKind = RecordKind.RECEIVED) -> None:
        """Append a record to the capture in hand."""
        writer = self._writer
        if writer is None:
            return
        try:
            writer.write(data, host_time_s, kind)
        except OSError as error:
            self.failures += 1
            self._writer = None
            log.error("capture", path=str(writer.path), error=str(error))

    def close(self) -> None:
        """End the capture in hand."""
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.close()


class Line:
    """One block's line: link, commands and capture.

    Raises
    ------
    LinkError, ProtocolError
        The URL or the protocol is none.
    """

    def __init__(self, settings: LinkSettings, timebase: Timebase) -> None:
        if settings.url is None:
            raise ValueError("a line needs a URL")
        self._settings, self._timebase = settings, timebase
        protocol = get_protocol(settings.protocol, **settings.options)
        self._capture = RunCapture(protocol, settings.bit_rate)
        self.link = SerialLink(
            settings.url,
            protocol,
            bit_rate=settings.bit_rate,
            timebase=timebase,
            stale_after_s=settings.stale_after_s,
            capture=self._capture,
        )
        self._channel = CommandChannel(self.link)
        self._self_tests: queue.SimpleQueue[SelfTestResult] = queue.SimpleQueue()
        self.link.on_message.append(self._note_self_test)

    def view(self) -> LineView:
        """Return what can be said of the line now."""
        age_s = self.link.age_s()
        return LineView(self.link.state.value, None if math.isinf(age_s) else age_s)

    def counters(self) -> dict[str, int]:
        """Return every count of the line."""
        counts = self.link.counters.as_dict()
        return {**counts, "capture_failures": counts["capture_failures"] + self._capture.failures}

    def capture_to(self, path: Path) -> None:
        """Keep raw bytes in ``path`` until :meth:`capture_end`."""
        settings = self._settings
        about = describe_line(url=settings.url, protocol=settings.protocol, bit_rate=settings.bit_rate)
        self._capture.begin(path, about, self._timebase.now_s())

    def capture_end(self) -> None:
        """Put the capture on disk and close it."""
        self._capture.close()

    def ask(self, what: Question, terms: StageTerms | None) -> object:
        """Ask the block and return its answer in the sequencer's terms; another thread must be reading the line.

        Raises
        ------
        CommandError
            No answer, a refusal, or a line that is down.
        ProtocolError
            The block's protocol has no such question.
        """
        command = _command(what, terms)
        self.link.protocol.encode_message(command)
        if isinstance(command, SelfTest):
            return self._self_test(command)
        return _meaning(self._channel.execute(command))

    def _self_test(self, command: Command) -> str:
        """Return the conditions that the self-test found, in words; empty when it passed."""
        while not self._self_tests.empty():
            self._self_tests.get()
        self._channel.execute(command)
        try:
            found = self._self_tests.get(timeout=max(self._timebase.real_s(SELF_TEST_WAIT_S), SELF_TEST_HOST_S))
        except queue.Empty:
            remedy = "Check the line, or have the block serviced"
            raise CommandError("SelfTest", self.link.url, "acknowledged, but no result came", remedy) from None
        return "" if found.passed else ", ".join(str(flag.name) for flag in type(found.status) if flag & found.status)

    def _note_self_test(self, received: Received) -> None:
        if isinstance(received.message, SelfTestResult):
            self._self_tests.put(received.message)


_COMMANDS: dict[Question, Command] = {
    "identity": ReadIdentity(),
    "read": ReadCompensation(),
    "read_back": ReadCompensation(),
    "start": Start(),
    "self_test": SelfTest(),
}


def _command(what: Question, terms: StageTerms | None) -> Command:
    if what == "write":
        assert terms is not None
        f, g = terms.f_mps2, terms.g_radps
        return WriteCompensation((f[0], f[1], f[2]), (g[0], g[1], g[2]))
    return _COMMANDS[what]


def _meaning(answer: Message) -> object:
    if isinstance(answer, Compensation):
        if not answer.intact:
            return None
        return StageTerms(f_mps2=list(answer.f_mps2), g_radps=list(answer.g_radps))
    if isinstance(answer, Identity):
        names = ("model", "serial", "firmware", "gyro_kind")
        return {name: getattr(answer, name) for name in names}
    return None


def is_idle_notice(received: Received) -> bool:
    """Whether a message, unasked for, says that the block has just woken and sends no samples."""
    message = received.message
    idle = isinstance(message, Configuration) and not message.streaming
    return idle and received.sequence == 0


class Acquisition:
    """Thread that reads the line and tells the time, and never waits for anything else.

    Parameters
    ----------
    line
        None: there is only time to tell.
    on_batch
        Takes samples in order, and whether the block restarted before the first.
    on_idle
        Told when the block says that it has woken and sends nothing.
    on_tick
        Told the state of the line, some twenty times a second.
    beat
        Called after every turn that went well: a thread that hangs, or fails each time, is silent.
    """

    def __init__(
        self,
        line: Line | None,
        on_batch: Callable[[SampleArray, bool], None],
        on_idle: Callable[[], None],
        on_tick: Callable[[LineView], None],
        beat: Callable[[], None],
    ) -> None:
        self._line, self._on_batch, self._on_idle, self._on_tick = line, on_batch, on_idle, on_tick
        self._beat = beat
        self.beat_s = time.monotonic()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="acquisition", daemon=True)

    def start(self) -> None:
        """Open the line and begin."""
        self.beat_s = time.monotonic()
        if self._line is not None:
            self._line.link.prepare()
            self._line.link.start()
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close line and capture."""
        self._stopping.set()
        self._thread.join(5.0)
        if self._line is not None:
            self._line.link.stop()
            self._line.capture_end()

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._turn()
                self.beat_s = time.monotonic()
                self._beat()
            except Exception:  # whatever it was, the line must go on being read
                log.exception("acquisition")
                self._stopping.wait(READ_WAIT_S)

    def _turn(self) -> None:
        if self._line is None:
            self._stopping.wait(READ_WAIT_S)
            self._on_tick(LineView())
            return
        batch = self._line.link.read(READ_WAIT_S)
        if batch is not None:
            if any(is_idle_notice(received) for received in batch.messages):
                self._on_idle()
            edges = [0, *batch.restarts, len(batch.samples)]
            for number, (first, last) in enumerate(pairwise(edges)):
                self._on_batch(batch.samples[first:last], number > 0)
        self._on_tick(self._line.view())
