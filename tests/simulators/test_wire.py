"""The line: paced as by a UART, losing what is not taken, and booking every loss to its frame."""

from __future__ import annotations

import json
import math
import os
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from line_bench import Bench, bench

from drivers.messages import Acknowledgement, Start
from drivers.timebase import Timebase
from simulators.device import LOOK_AHEAD_S, Outgoing
from simulators.scenarios import (
    Fault,
    Move,
    NoisyLine,
    Scenario,
    StuckSensor,
    Unplug,
    demo_model,
    demo_scenario,
)
from simulators.simulate import run_on_line
from simulators.wire import Ledger, Noise, PtyLine, TcpLine, Uart

SPOILED = [
    NoisyLine(kind="bit_flips", probability=0.01),
    NoisyLine(kind="cuts", probability=0.01),
    NoisyLine(kind="garbage", probability=0.01),
    NoisyLine(kind="false_headers", probability=0.01),
]


def scenario(*faults: Fault) -> Scenario:
    return demo_scenario(1).model_copy(update={"fault": list(faults)})


def assert_nothing_untouched_is_lost(b: Bench, cycle: int = 0) -> None:
    """What arrived is what was sent and not touched, each once; a frame touched by chance may still be whole."""
    b.stop()
    ledger = b.simulator.ledger
    received = b.host.sequences
    assert len(received) == len(set(received))
    assert ledger.untouched(cycle) <= set(received)
    assert ledger.frames_sent == ledger.frames_touched + len(ledger.untouched(cycle))


def started(b: Bench) -> Bench:
    assert isinstance(b.host.ask(Start(), Acknowledgement), Acknowledgement)
    return b


def test_every_frame_arrives_when_the_reader_keeps_up(tmp_path: Path) -> None:
    with bench(tmp_path, speed=10.0) as b:
        started(b).host.until(lambda: len(b.host.sequences) >= 600)
        b.stop()
        assert b.host.sequences == list(range(len(b.host.sequences)))
        assert b.simulator.ledger.overrun_bytes == b.simulator.ledger.unread_bytes == 0


def test_what_a_sleeping_reader_does_not_take_is_lost_and_counted_to_the_byte(tmp_path: Path) -> None:
    with bench(tmp_path) as b:
        started(b).host.until(lambda: len(b.host.sequences) >= 100)
        time.sleep(0.4)  # 8 s of simulated time: 48 kB, more than twice what a pseudo-terminal holds
        b.host.until(lambda: b.host.sequences[-1] > 1200)
        b.stop()
        ledger = b.simulator.ledger
        assert ledger.overrun_bytes > 10_000
        assert ledger.bytes_sent == b.host.bytes_read + ledger.unread_bytes
        assert set(b.host.sequences) == ledger.untouched(0)
        lost = [s for s, how in ledger.cycles[0]["touched"].items() if how == "overrun"]
        assert len(lost) == pytest.approx(ledger.overrun_bytes / 60, abs=60)


def test_a_reader_that_sleeps_never_holds_the_block_up(tmp_path: Path) -> None:
    with bench(tmp_path) as b:
        started(b)
        began = b.simulator.ledger.frames_sent
        time.sleep(0.6)
        b.stop_unread()
        # 0.6 s at speed 20 and 100 Hz are 1200 frames; a loaded machine is allowed half of them.
        assert b.simulator.ledger.frames_sent - began > 600


def test_no_untouched_frame_is_lost_on_a_noisy_line(tmp_path: Path) -> None:
    with bench(tmp_path, scenario(*SPOILED)) as b:
        started(b).host.until(lambda: len(b.host.sequences) >= 2500)
        assert_nothing_untouched_is_lost(b)
        touched = list(b.simulator.ledger.cycles[0]["touched"].values())
        assert touched.count("bit_flips") > 5
        assert touched.count("cuts") > 5
        assert b.simulator.ledger.garbage_bytes > 200


def test_unplugged_the_line_disappears_and_comes_back_as_a_new_one(tmp_path: Path) -> None:
    with bench(tmp_path, scenario(Unplug(kind="unplug", at_s=5.0, duration_s=6.0))) as b:
        started(b)
        first = os.readlink(b.host.url)
        b.host.until(lambda: not Path(b.host.url).is_symlink())
        b.host.until(lambda: Path(b.host.url).is_symlink())
        b.host.until(lambda: b.host.sequences[-1] > 1500)
        assert_nothing_untouched_is_lost(b)
        ledger = b.simulator.ledger
        unplugged = [s for s, how in ledger.cycles[0]["touched"].items() if how == "unplugged"]
        # 6 s are 600 frames; both ends wait for a turn of the simulator, which stands for up to 1.6 s of this time.
        assert len(unplugged) == pytest.approx(600, abs=200)
        assert [fault["event"] for fault in ledger.faults] == ["fault", "fault over"]
        assert ledger.faults[0]["happened_s"] == pytest.approx(5.0, abs=2.0)
        assert first.startswith("/dev/")


def test_faults_at_run_time_come_by_a_control_file(tmp_path: Path) -> None:
    read_end, write_end = os.pipe()
    stop, events = threading.Event(), []
    ledger_path = tmp_path / "ledger.json"

    def run() -> None:
        run_on_line(
            scenario(),
            demo_model(1),
            path=tmp_path / "ttyINS",
            timebase=Timebase(20.0),
            stop=stop,
            ledger=ledger_path,
            control=read_end,
            report=events.append,
        )

    thread = threading.Thread(target=run)
    thread.start()
    os.write(write_end, b'{"fault": "restart"}\n{"fault": "unplug", "duration')
    os.write(
        write_end, b'_s": 0.5}\nnonsense\n{"fault": "unplug"}\n{"fault": "move", "duration_s": 1, "rate_dps": 2}\n'
    )
    deadline = time.monotonic() + 10.0
    while not any(event["event"] == "fault over" for event in events) and time.monotonic() < deadline:
        time.sleep(0.005)
    os.close(write_end)
    time.sleep(0.05)  # the end of orders must not end or spin the run
    stop.set()
    thread.join()
    os.close(read_end)
    assert [(event["event"], event.get("kind")) for event in events] == [
        ("ready", None),
        ("refused", None),
        ("refused", None),
        ("fault", "restart"),
        ("fault", "unplug"),
        ("fault", "move"),
        ("fault over", "unplug"),
    ]
    assert json.loads(ledger_path.read_text())["faults"][0]["kind"] == "restart"


def test_stuck_sensor_and_move_befall_the_running_block(tmp_path: Path) -> None:
    with bench(tmp_path) as b:
        started(b).host.until(lambda: len(b.host.sequences) >= 200)
        b.simulator.inject(StuckSensor(kind="stuck_sensor", channel="accel_x", duration_s=5.0))
        b.simulator.inject(Move(kind="move", duration_s=2.0, rate_dps=3.0, axis=[0.0, 0.0, 1.0]))
        b.host.until(lambda: len(b.simulator.ledger.faults) == 2)
        stuck_s, happened_s = (fault["happened_s"] for fault in b.simulator.ledger.faults)
        b.host.until(lambda: b.host.sequences[-1] > 100 * (happened_s + 8))
        samples = np.concatenate(b.host.samples)
    turning = samples["time"][samples["dtheta"][:, 2] > math.radians(0.02)]
    assert turning.size == 200
    assert 0 <= turning[0] - happened_s < LOOK_AHEAD_S + 0.2
    # Free readings repeat by chance now and then; only a stuck one does it on and on.
    last_free = np.flatnonzero(np.diff(samples["dv"][:, 0])) + 1
    longest = int(np.argmax(np.diff(last_free)))
    assert last_free[longest + 1] - last_free[longest] == pytest.approx(500, abs=2)
    # The reading a register repeats is its last free one, which may have been sent before it stuck.
    first_repeated = last_free[longest] + 1
    assert 0 <= samples["time"][first_repeated] - stuck_s < LOOK_AHEAD_S + 0.2


def test_the_same_block_is_served_over_tcp(tmp_path: Path) -> None:
    line = TcpLine(0)
    with bench(tmp_path, line=line, url=lambda: f"socket://{line.address[0]}:{line.address[1]}") as b:
        started(b).host.until(lambda: len(b.host.sequences) >= 300)
        assert b.host.sequences[:300] == list(range(300))


class SlowLine:
    """A line that notes when it was given how much, and takes it all."""

    def __init__(self, room: int = 1 << 30) -> None:
        self.carried, self.room = b"", room

    def plug(self) -> None: ...
    def unplug(self) -> None: ...

    def listening(self) -> bool:
        return True

    def settled(self) -> bool:
        return True

    def unread(self) -> int:
        return 0

    def write(self, data: bytes) -> int:
        taken = data[: self.room - len(self.carried)]
        self.carried += taken
        return len(taken)

    def read(self) -> bytes:
        return b""

    def wait(self, seconds: float, also: int | None = None) -> None: ...


def frames(count: int, length: int = 60) -> list[Outgoing]:
    return [Outgoing(bytes([k % 256]) * length, 0, k) for k in range(count)]


def put(uart: Uart, noise: Noise, made: Sequence[Outgoing]) -> None:
    for frame in made:
        uart.send(noise.spoil(frame))


def test_bytes_go_no_faster_than_the_bit_rate() -> None:
    line, ledger = SlowLine(), Ledger()
    uart = Uart(line, bit_rate=9600, speed=10.0, ledger=ledger)
    uart.plug()
    uart.turn()
    put(uart, Noise(1, ledger), frames(200))
    began = time.monotonic()
    while time.monotonic() - began < 0.2:
        uart.turn()
        time.sleep(0.0005)
    # 9600 bit/s at 10 bits a byte and speed 10 are 9600 bytes a second.
    assert 0.3 * 1920 < len(line.carried) <= 9600 * (time.monotonic() - began) + 100
    assert line.carried == b"".join(f.data for f in frames(200))[: len(line.carried)]


def test_a_full_buffer_touches_exactly_the_frames_whose_bytes_are_lost() -> None:
    line, ledger = SlowLine(room=150), Ledger()
    uart = Uart(line, bit_rate=10**9, speed=1.0, ledger=ledger)
    uart.plug()
    put(uart, Noise(1, ledger), frames(5))
    while not uart.idle:
        uart.turn()
    assert ledger.bytes_sent == 150
    assert ledger.overrun_bytes == 150
    assert ledger.cycles[0] == {"sent": [[0, 4]], "touched": dict.fromkeys([2, 3, 4], "overrun")}
    assert ledger.untouched(0) == {0, 1}


def test_what_was_never_sent_is_booked_at_the_end() -> None:
    ledger = Ledger()
    uart = Uart(SlowLine(), bit_rate=10, speed=1.0, ledger=ledger)
    uart.plug()
    put(uart, Noise(1, ledger), frames(3))
    uart.close()
    assert ledger.cycles[0]["touched"] == dict.fromkeys(range(3), "unsent")


@pytest.mark.parametrize("kind", ["bit_flips", "cuts", "garbage", "false_headers"])
def test_noise_does_what_it_says_to_the_share_it_says(kind: str) -> None:
    ledger = Ledger()
    noise = Noise(3, ledger)
    noise.active.append(NoisyLine(kind=kind, probability=0.2))  # type: ignore[arg-type]
    made = frames(5000)
    spoiled = 0
    for frame in made:
        pieces = noise.spoil(frame)
        body = pieces[-1].data
        if kind == "bit_flips":
            flipped = np.unpackbits(np.frombuffer(frame.data, np.uint8) ^ np.frombuffer(body, np.uint8)).sum()
            assert flipped in (0, 1)
            spoiled += int(flipped)
        elif kind == "cuts":
            assert frame.data.startswith(body)
            assert body
            spoiled += body != frame.data
        else:
            assert body == frame.data
            spoiled += len(pieces) == 2
            assert all(piece.frame is None for piece in pieces[:-1])
    assert spoiled == pytest.approx(1000, abs=5 * (5000 * 0.2 * 0.8) ** 0.5)
    assert ledger.frames_touched == (spoiled if kind in ("bit_flips", "cuts") else 0)


def test_a_line_nobody_has_opened_carries_nothing(tmp_path: Path) -> None:
    line = PtyLine(tmp_path / "ttyINS")
    line.plug()
    assert not line.listening()
    reader = os.open(tmp_path / "ttyINS", os.O_RDWR | os.O_NOCTTY)
    assert line.listening()
    assert not line.settled()
    assert line.write(b"\x03\r\n\x11") == 4
    assert os.read(reader, 10) == b"\x03\r\n\x11"  # raw: no byte means anything to the terminal
    os.close(reader)
    assert not line.listening()
    line.unplug()
    assert not (tmp_path / "ttyINS").is_symlink()
