"""The block as its host knows it: it sends frames, obeys commands and keeps the terms it is given.

At power-up it is idle, its sensors off: it sends identity and configuration, once each second, until it is told to
start. Then its sensors are switched on: device time, sequence, warm-up and noise begin at zero, and frames stream.
A block whose protocol has no commands streams from power-up.
After ``Stop`` the sensors run on unheard, so that a later ``Start`` goes on with the time that it is. The terms are
kept with their CRC and a count of writes, and are never applied to the frames.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from drivers.framing import BITS_PER_BYTE, Splitter
from drivers.messages import (
    Acknowledgement,
    Command,
    Compensation,
    Configuration,
    Identity,
    Message,
    Outcome,
    ReadCompensation,
    ReadConfiguration,
    ReadIdentity,
    Received,
    SelfTest,
    SelfTestResult,
    SetRate,
    Start,
    Stop,
    Vector,
    WriteCompensation,
    terms_crc,
)
from drivers.protocols.base import Protocol, ProtocolError
from drivers.samples import Status, empty_samples
from inertial.documents import BlockModel
from inertial.earth import STANDARD_GRAVITY_MPS2
from simulators.block import SimulatedBlock
from simulators.errors import ScenarioError
from simulators.motion import Setup, Turn
from simulators.scenarios import DEG, Heat, Move, Scenario, StuckSensor, effect, make_block, vector

ANNOUNCE_S = 1.0
"""How often an idle block says who it is."""
SELF_TEST_S = 1.0
"""How long a self-test takes."""
POWER_UP_S = 0.3
"""From supply to the first frame."""
LOOK_AHEAD_S = 1.0
"""How far samples are made ahead of their time; what happens unforeseen takes effect so much later at most."""
ACCEL_RANGE_MPS2 = 30.0 * STANDARD_GRAVITY_MPS2
GYRO_RANGE_RADPS = 400.0 * DEG
RATES_HZ = (1.0, 10_000.0)
LONGEST_REQUEST = 64


class Outgoing(NamedTuple):
    """One frame to send: ``cycle`` counts the sensors' switch-ons, ``sequence`` is None for anything but samples."""

    data: bytes
    cycle: int
    sequence: int | None


class DeviceError(ScenarioError):
    """The block cannot be simulated so: its memory file is damaged or its frames do not fit the line."""


class TermMemory:
    """The block's memory for terms; a file when it is to outlive the process."""

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        zero: Vector = (0.0, 0.0, 0.0)
        self.terms = Compensation(zero, zero, 0, terms_crc(zero, zero))
        if path is not None and path.exists():
            self.terms = _read_terms(path)

    def write(self, f_mps2: Vector, g_radps: Vector) -> None:
        """Keep new terms; on ``OSError`` the old ones stay."""
        terms = Compensation(f_mps2, g_radps, self.terms.writes + 1, terms_crc(f_mps2, g_radps))
        if self._path is not None:
            kept = {"f_mps2": f_mps2, "g_radps": g_radps, "writes": terms.writes, "crc": terms.crc}
            partial = self._path.with_name(self._path.name + ".part")
            partial.write_text(json.dumps(kept) + "\n")
            os.replace(partial, self._path)
        self.terms = terms


def _read_terms(path: Path) -> Compensation:
    try:
        kept = json.loads(path.read_text())
        f_mps2, g_radps = vector(kept["f_mps2"]), vector(kept["g_radps"])
        return Compensation(f_mps2, g_radps, int(kept["writes"]), int(kept["crc"]))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DeviceError(f"{path}: is not a block's memory for terms ({error}). Delete it or name another.") from None


@dataclass
class _Reply:
    message: Message
    answers: int
    due_s: float


class Device:
    """One block on one line. All times are simulated seconds of one clock; ``now_s`` never goes back.

    Parameters
    ----------
    scenario, model : what the block is and what becomes of it.
    protocol : its frames; it must have frames for messages.
    bit_rate : of its line.
    memory : where it keeps its terms.
    now_s : when its supply is switched on.

    Raises
    ------
    DeviceError
        Its frames need more than the line can carry.
    ProtocolError
        The protocol has no frames for it: a maker's device has no such sample rate.
    """

    def __init__(
        self,
        scenario: Scenario,
        model: BlockModel,
        protocol: Protocol,
        *,
        bit_rate: int,
        memory: TermMemory,
        now_s: float,
    ) -> None:
        self._scenario, self._model, self._protocol = scenario, model, protocol
        self._bit_rate, self._memory = bit_rate, memory
        self._frame_length = len(protocol.encode_samples(empty_samples(1, protocol.temperatures)))
        if not self._fits_line(scenario.block.sample_rate_hz):
            raise DeviceError(
                f"{scenario.block.sample_rate_hz:g} frames of {self._frame_length} bytes a second do not fit "
                f"{bit_rate} bit/s; lower [block] sample_rate_hz or raise the bit rate"
            )
        # Compiles what is slow the first time, and refuses what cannot be simulated before anyone waits for it.
        protocol.encode_samples(make_block(scenario, model).generate(2))
        self._replies: list[_Reply] = []
        self._heard = b""
        self._asked: list[type] = []
        self._streaming = False
        self._announce_s = now_s
        self._cycle = -1
        self._origin_s: float | None = None
        self._setup: Setup | None = None
        self._stuck = [fault for fault in scenario.fault if isinstance(fault, StuckSensor)]
        self._power_up(now_s)

    @property
    def streaming_since_s(self) -> float | None:
        """When streaming first began, or None; faults are timed from here."""
        return self._origin_s

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes off the line and obey what they say."""
        if now_s < self._awake_s:
            return
        for received in self._decoder.decode(self._splitter.feed(data, now_s)).messages:
            self._obey(received, now_s)
        self._heard += data
        for request, kind in self._protocol.requests.items():
            self._asked += [kind] * self._heard.count(request)
        self._heard = self._heard[self._heard.rfind(b"\r") + 1 :][-LONGEST_REQUEST:]

    def advance(self, now_s: float) -> list[Outgoing]:
        """Return the frames that are due by now, in order."""
        if now_s < self._awake_s:
            return []
        if self._block is None and not self._protocol.commands:
            return self._speak_up(now_s)
        outgoing = [self._message(reply) for reply in self._replies if reply.due_s <= now_s]
        self._replies = [reply for reply in self._replies if reply.due_s > now_s]
        if not self._streaming and now_s >= self._announce_s:
            self._announce_s = now_s + ANNOUNCE_S
            outgoing += [self._message(_Reply(self._identity(), 0, now_s))]
            outgoing += [self._message(_Reply(self._configuration(), 0, now_s))]
        return outgoing + self._answered(self._due_samples(now_s), now_s)

    def _answered(self, samples: list[Outgoing], now_s: float) -> list[Outgoing]:
        """Put what was asked for by :attr:`Protocol.requests` in the place of samples, as devices do."""
        known: dict[type, Callable[[], Message]] = {Identity: self._identity, Configuration: self._configuration}
        for place, kind in zip(range(len(samples)), list(self._asked), strict=False):
            samples[place] = self._message(_Reply(known[kind](), 0, now_s))
            self._asked.remove(kind)
        return samples

    def _speak_up(self, now_s: float) -> list[Outgoing]:
        """Begin to stream as devices do that take no commands, with what their frames can say of themselves first."""
        self._switch_on(now_s)
        self._streaming = True
        outgoing = []
        for message in (self._identity(), self._configuration()):
            with contextlib.suppress(ProtocolError):
                outgoing.append(self._message(_Reply(message, 0, now_s)))
        return outgoing

    def restart(self, now_s: float) -> None:
        """Take the supply away for a moment."""
        if self._block is not None:
            self._setup = self._block.setup
        self._stuck = []
        self._power_up(now_s)

    def move(self, fault: Move, now_s: float) -> None:
        """Turn the block at once, also while its sensors are off, but not before they were first on."""
        rate_radps, axis = fault.rate_dps * DEG, vector(fault.axis)
        if self._block is not None:
            self._block.move(rate_radps, axis, fault.duration_s)
        elif self._setup is not None and self._origin_s is not None:
            start_s = now_s - self._origin_s
            self._setup = self._setup.with_motion(Turn(start_s, start_s + fault.duration_s, rate_radps, axis))

    def heat(self, fault: Heat) -> None:
        """Warm or cool the block at once."""
        if self._block is not None:
            self._block.heat(fault.change_c, fault.time_constant_s)

    def stick(self, fault: StuckSensor, now_s: float) -> None:
        """Let a sensor's register stand still at once."""
        if self._block is None or self._origin_s is None:
            return
        # One sample later than the next: a register repeats what it has sent.
        start_s = self._block.time_s + 1.5 / self._block.rate_hz
        self._block.add_effect(
            effect("stuck_samples", fault.channel, start=(start_s, "s"), duration=(fault.duration_s, "s"))
        )
        self._stuck.append(fault.model_copy(update={"at_s": now_s - self._origin_s}))

    def _power_up(self, now_s: float) -> None:
        self._awake_s = now_s + POWER_UP_S
        self._announce_s = self._awake_s
        self._splitter = Splitter(self._protocol, self._bit_rate)
        self._decoder = self._protocol.decoder()
        self._replies = []
        self._heard, self._asked = b"", []
        self._rate_hz = self._scenario.block.sample_rate_hz
        self._streaming = False
        self._switch_off()

    def _switch_off(self) -> None:
        self._block: SimulatedBlock | None = None
        self._ready: list[Outgoing] = []
        self._taken = 0

    def _switch_on(self, now_s: float) -> None:
        """Begin a life of the sensors; time, sequence, warm-up and noise are new."""
        if self._origin_s is None:
            self._origin_s = now_s
        self._cycle += 1
        self._on_s = now_s
        block = self._scenario.block.model_copy(update={"sample_rate_hz": self._rate_hz})
        self._block = make_block(
            self._scenario.model_copy(update={"block": block}),
            self._model,
            power_cycle=self._cycle,
            epoch_s=now_s - self._origin_s,
            setup=self._setup,
        )

    def _due_samples(self, now_s: float) -> list[Outgoing]:
        block, due = self._block, list[Outgoing]()
        if block is None:
            return due
        since_s = now_s - self._on_s
        while True:
            first = round(block.time_s * block.rate_hz) - len(self._ready) + self._taken
            count = min(math.floor(since_s * block.rate_hz) - first, len(self._ready) - self._taken)
            due += self._ready[self._taken : self._taken + max(count, 0)]
            self._taken += max(count, 0)
            if self._taken < len(self._ready) or since_s < block.time_s + 1.0 / block.rate_hz:
                return due if self._streaming else []
            self._ready, self._taken = self._make(block), 0

    def _make(self, block: SimulatedBlock) -> list[Outgoing]:
        samples = block.generate(max(1, round(LOOK_AHEAD_S * block.rate_hz)))
        data, length = self._protocol.encode_samples(samples), self._frame_length
        return [
            Outgoing(data[start : start + length], self._cycle, int(sequence))
            for start, sequence in zip(range(0, len(data), length), samples["sequence"], strict=True)
        ]

    def _message(self, reply: _Reply) -> Outgoing:
        time_s = max(0.0, reply.due_s - self._awake_s)
        return Outgoing(self._protocol.encode_message(reply.message, reply.answers, time_s), self._cycle, None)

    def _obey(self, received: Received, now_s: float) -> None:
        message, sequence = received.message, received.sequence

        def say(answer: Message, after_s: float = 0.0) -> None:
            self._replies.append(_Reply(answer, sequence, now_s + after_s))

        match message:
            case ReadCompensation():
                say(self._memory.terms)
            case ReadIdentity():
                say(self._identity())
            case ReadConfiguration():
                say(self._configuration())
            case Start() | Stop() | SelfTest() | SetRate() | WriteCompensation():
                say(Acknowledgement(type(message).__name__, self._execute(message, now_s)))
                if isinstance(message, SelfTest):
                    say(SelfTestResult(self._self_test(now_s)), SELF_TEST_S)

    def _execute(self, command: Command, now_s: float) -> Outcome:
        match command:
            case Start():
                if self._block is None:
                    self._switch_on(now_s)
                if not self._streaming:
                    self._due_samples(now_s)  # what was sensed while silent goes unheard
                self._streaming = True
            case Stop():
                self._streaming = False
                self._announce_s = now_s
            case SetRate():
                return self._set_rate(command.rate_hz)
            case WriteCompensation():
                if not all(map(math.isfinite, (*command.f_mps2, *command.g_radps))):
                    return Outcome.BAD_ARGUMENT
                try:
                    self._memory.write(command.f_mps2, command.g_radps)
                except OSError:
                    return Outcome.STORAGE_FAULT
        return Outcome.DONE

    def _set_rate(self, rate_hz: float) -> Outcome:
        if self._streaming:
            return Outcome.NOT_NOW
        if not RATES_HZ[0] <= rate_hz <= RATES_HZ[1] or not self._fits_line(rate_hz):
            return Outcome.BAD_ARGUMENT
        if self._block is not None:
            self._setup = self._block.setup
        self._rate_hz = rate_hz
        self._switch_off()
        return Outcome.DONE

    def _fits_line(self, rate_hz: float) -> bool:
        return rate_hz * self._frame_length * BITS_PER_BYTE <= self._bit_rate

    def _self_test(self, now_s: float) -> Status:
        """Return what the block finds wrong with itself: a sensor that does not answer."""
        found = Status(0)
        for fault in self._stuck:
            if self._origin_s is not None and fault.at_s is not None:
                into_s = now_s - self._origin_s - fault.at_s
                if 0 <= into_s < fault.duration_s:
                    found |= Status.SELF_TEST_FAILED | Status[f"INVALID_{fault.channel.upper()}"]
        return found

    def _identity(self) -> Identity:
        serial = (self._model.block or "simulated")[:16]
        return Identity("inertrim block", serial, "sim 1", self._model.gyro_kind)

    def _configuration(self) -> Configuration:
        return Configuration(self._rate_hz, self._bit_rate, ACCEL_RANGE_MPS2, GYRO_RANGE_RADPS, self._streaming)
