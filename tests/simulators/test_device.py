"""The block as its host knows it, over a real pseudo-terminal: what it sends by itself and how it obeys."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from line_bench import bench

from drivers.messages import (
    Acknowledgement,
    Compensation,
    Configuration,
    Identity,
    Outcome,
    ReadCompensation,
    ReadConfiguration,
    ReadIdentity,
    SelfTest,
    SelfTestResult,
    SetRate,
    Start,
    Stop,
    WriteCompensation,
)
from drivers.protocols import get_protocol
from drivers.protocols.base import Frame
from drivers.samples import Status
from simulators.device import Device, DeviceError, TermMemory
from simulators.scenarios import Move, Restart, Scenario, StuckSensor, demo_model, demo_scenario

TERMS = WriteCompensation((1e-3, -2e-3, 3e-3), (1e-6, -2e-6, 3e-6))


class Desk:
    """A device without a line, in a time that goes as told."""

    def __init__(self, scenario: Scenario | None = None, bit_rate: int = 921600, memory: Path | None = None) -> None:
        self.protocol = get_protocol("native")
        self.device = Device(
            scenario or demo_scenario(1),
            demo_model(1),
            self.protocol,
            bit_rate=bit_rate,
            memory=TermMemory(memory),
            now_s=0.0,
        )
        self.samples: list[tuple[int, int]] = []
        self.last_dv: np.ndarray | None = None
        self.now_s = 0.0

    def at(self, now_s: float, command: object = None) -> list[object]:
        """Return the messages sent by ``now_s``, which a command may have reached first."""
        if command is not None:
            self.device.receive(self.protocol.encode_message(command, 9), now_s)  # type: ignore[arg-type]
        outgoing = self.device.advance(now_s)
        self.samples += [(o.cycle, o.sequence) for o in outgoing if o.sequence is not None]
        data = [Frame(o.data, 0.0) for o in outgoing if o.sequence is not None]
        if data:
            self.last_dv = self.protocol.decoder().decode(data).samples["dv"].mean(axis=0)
        decoded = self.protocol.decoder().decode([Frame(o.data, 0.0) for o in outgoing if o.sequence is None])
        return [received.message for received in decoded.messages]


def test_an_idle_block_says_who_it_is_at_power_up_and_each_second_and_sends_no_data() -> None:
    desk = Desk()
    assert desk.at(0.2) == []
    assert [type(m) for m in desk.at(0.31)] == [Identity, Configuration]
    assert desk.at(1.2) == []
    assert [type(m) for m in desk.at(1.4)] == [Identity, Configuration]
    assert desk.samples == []


def test_after_start_every_frame_comes_when_its_time_has() -> None:
    desk = Desk()
    assert Acknowledgement("Start", Outcome.DONE) in desk.at(5.0, Start())
    desk.at(5.0099)
    assert desk.samples == []
    desk.at(5.0101)
    assert desk.samples == [(0, 0)]
    desk.at(8.0051)
    assert desk.samples == [(0, k) for k in range(300)]


def test_stop_silences_the_sensors_but_their_time_goes_on() -> None:
    desk = Desk()
    desk.at(1.0, Start())
    desk.at(2.005)
    assert Acknowledgement("Stop", Outcome.DONE) in desk.at(2.006, Stop())
    desk.at(4.006, Start())
    desk.at(5.005)
    assert [s for _, s in desk.samples] == [*range(100), *range(300, 400)]


@pytest.mark.parametrize("off_s", [0.0, 0.1])
def test_a_block_that_is_turned_as_it_restarts_stands_turned(off_s: float) -> None:
    """Whether its sensors are on or not: who later turns it back finds it as it stood at first."""
    desk = Desk()

    def stands() -> np.ndarray:
        desk.at(desk.now_s + 0.5, Start())
        desk.now_s += 2.5
        desk.at(desk.now_s)
        assert desk.last_dv is not None
        return desk.last_dv / np.linalg.norm(desk.last_dv)

    desk.now_s = 1.0
    at_first = stands()
    desk.device.restart(desk.now_s)
    desk.device.move(Move(kind="move", duration_s=0.1, rate_dps=300.0, axis=[1.0, 1.0, 0.0]), desk.now_s + off_s)
    turned = stands()
    assert math.degrees(math.acos(at_first @ turned)) == pytest.approx(30.0, abs=0.5)
    desk.device.move(Move(kind="move", duration_s=0.1, rate_dps=-300.0, axis=[1.0, 1.0, 0.0]), desk.now_s)
    desk.at(desk.now_s + 0.5)
    desk.at(desk.now_s + 1.0)
    assert math.degrees(math.acos(min(1.0, at_first @ (desk.last_dv / np.linalg.norm(desk.last_dv))))) < 0.5


def test_the_rate_changes_only_while_silent_and_only_to_what_the_line_carries() -> None:
    desk = Desk(bit_rate=115200)
    assert Acknowledgement("SetRate", Outcome.BAD_ARGUMENT) in desk.at(1.0, SetRate(200.0))  # 60 bytes × 200 × 10 bit
    assert Acknowledgement("SetRate", Outcome.BAD_ARGUMENT) in desk.at(1.1, SetRate(0.0))
    assert Acknowledgement("SetRate", Outcome.DONE) in desk.at(1.2, SetRate(50.0))
    desk.at(2.0, Start())
    assert Acknowledgement("SetRate", Outcome.NOT_NOW) in desk.at(2.1, SetRate(100.0))
    desk.at(3.001)
    assert len(desk.samples) == 50
    configuration = next(m for m in desk.at(3.1, ReadConfiguration()) if isinstance(m, Configuration))
    assert (configuration.sample_rate_hz, configuration.streaming) == (50.0, True)


def test_more_frames_than_the_line_can_carry_are_refused() -> None:
    with pytest.raises(DeviceError, match="do not fit 57600 bit/s"):
        Desk(bit_rate=57600)


def test_a_self_test_finds_a_sensor_that_is_stuck() -> None:
    desk = Desk()
    desk.at(1.0, Start())
    desk.at(3.0)
    desk.at(3.1, SelfTest())
    assert desk.at(4.0) == []
    assert desk.at(4.2) == [SelfTestResult(Status(0))]
    desk.device.stick(StuckSensor(kind="stuck_sensor", channel="gyro_y", duration_s=20.0), 5.0)
    desk.at(6.0, SelfTest())
    assert desk.at(7.1) == [SelfTestResult(Status.SELF_TEST_FAILED | Status.INVALID_GYRO_Y)]
    desk.at(26.0, SelfTest())
    assert desk.at(27.1) == [SelfTestResult(Status(0))]


def test_a_restarted_block_is_deaf_for_a_moment_then_idle_and_keeps_its_terms() -> None:
    desk = Desk()
    desk.at(1.0, Start())
    desk.at(2.0, TERMS)
    desk.at(3.0)
    desk.device.restart(3.0)
    assert desk.at(3.1, Start()) == []
    assert [type(m) for m in desk.at(3.4)] == [Identity, Configuration]
    count = len(desk.samples)
    kept = next(m for m in desk.at(3.5, ReadCompensation()) if isinstance(m, Compensation))
    assert (kept.f_mps2, kept.g_radps, kept.writes) == (TERMS.f_mps2, TERMS.g_radps, 1)
    desk.at(4.0, Start())
    desk.at(4.1001)
    assert desk.samples[count:] == [(1, k) for k in range(10)]


def test_terms_that_are_no_numbers_are_refused_and_the_old_ones_kept() -> None:
    desk = Desk()
    desk.at(1.0, TERMS)
    bad = WriteCompensation((float("nan"), 0.0, 0.0), (0.0, 0.0, 0.0))
    assert Acknowledgement("WriteCompensation", Outcome.BAD_ARGUMENT) in desk.at(1.1, bad)
    kept = next(m for m in desk.at(1.2, ReadCompensation()) if isinstance(m, Compensation))
    assert kept.f_mps2 == TERMS.f_mps2


def test_written_terms_come_back_over_the_line_and_outlive_the_process(tmp_path: Path) -> None:
    memory = tmp_path / "terms.json"
    with bench(tmp_path, memory=memory) as b:
        assert b.host.ask(ReadCompensation(), Compensation).writes == 0  # type: ignore[attr-defined]
        assert b.host.ask(TERMS, Acknowledgement) == Acknowledgement("WriteCompensation", Outcome.DONE)
        assert b.host.ask(TERMS, Acknowledgement) == Acknowledgement("WriteCompensation", Outcome.DONE)
    with bench(tmp_path, memory=memory) as b:
        kept = b.host.ask(ReadCompensation(), Compensation)
        assert isinstance(kept, Compensation)
        assert (kept.f_mps2, kept.g_radps, kept.writes, kept.intact) == (TERMS.f_mps2, TERMS.g_radps, 2, True)


def test_the_whole_conversation_works_over_a_pseudo_terminal(tmp_path: Path) -> None:
    with bench(tmp_path) as b:
        identity = b.host.ask(ReadIdentity(), Identity)
        assert isinstance(identity, Identity)
        assert (identity.serial, identity.gyro_kind) == ("demo-1", "dtg")
        assert b.host.ask(SetRate(200.0), Acknowledgement) == Acknowledgement("SetRate", Outcome.DONE)
        assert b.host.ask(Start(), Acknowledgement) == Acknowledgement("Start", Outcome.DONE)
        assert b.host.ask(SelfTest(), SelfTestResult) == SelfTestResult(Status(0))
        b.host.until(lambda: len(b.host.sequences) >= 600)
        assert b.host.sequences[:600] == list(range(600))
        b.simulator.inject(Restart(kind="restart"))
        b.host.until(lambda: isinstance(b.host.messages[-1], Configuration))
        assert b.host.ask(Start(), Acknowledgement) == Acknowledgement("Start", Outcome.DONE)
        b.host.until(lambda: 0 in b.host.sequences[600:])


def test_a_damaged_memory_file_is_refused_by_name(tmp_path: Path) -> None:
    memory = tmp_path / "terms.json"
    memory.write_text(json.dumps({"f_mps2": [0, 0], "writes": 1}))
    with pytest.raises(DeviceError, match=r"terms\.json: is not a block's memory"):
        TermMemory(memory)


def test_a_memory_that_cannot_be_written_is_a_storage_fault(tmp_path: Path) -> None:
    desk = Desk(memory=tmp_path / "no such folder" / "terms.json")
    assert Acknowledgement("WriteCompensation", Outcome.STORAGE_FAULT) in desk.at(1.0, TERMS)
    kept = next(m for m in desk.at(1.1, ReadCompensation()) if isinstance(m, Compensation))
    assert (kept.f_mps2, kept.writes) == ((0.0, 0.0, 0.0), 0)
