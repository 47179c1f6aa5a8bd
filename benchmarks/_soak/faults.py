"""What may befall the plant: each fault begins, and where it lasts it is undone some simulated seconds later."""

from __future__ import annotations

import signal
import socket
from collections.abc import Callable
from dataclasses import dataclass
from random import Random

from benchmarks._soak.plant import Plant

Undo = tuple[float, Callable[[], object]]
"""Simulated seconds after which something is done, and what."""


@dataclass(frozen=True)
class Fault:
    """One kind of trouble.

    ``begin`` does it and returns what is to be done later; ``possible`` says whether this system can do it at all.
    """

    name: str
    text: str
    begin: Callable[[Plant, Random], list[Undo]]
    possible: Callable[[Plant], bool] = lambda _: True
    needs_line: bool = False
    """Whether the block must be streaming for it to happen, and to be undone."""
    ends: bool = False
    """Whether the service's process ends by it."""
    turns: bool = False
    """Whether it turns the block and later back; of two such at once neither finds the way back."""


def _unplug(low_s: float, high_s: float) -> Callable[[Plant, Random], list[Undo]]:
    def begin(plant: Plant, random: Random) -> list[Undo]:
        plant.inject("unplug", duration_s=round(random.uniform(low_s, high_s), 1))
        return []

    return begin


def _noise(plant: Plant, random: Random) -> list[Undo]:
    kind = random.choice(["bit_flips", "cuts", "garbage", "false_headers"])
    plant.inject(kind, probability=round(random.uniform(0.01, 0.4), 3), duration_s=round(random.uniform(5, 60), 1))
    return []


def _restart(plant: Plant, random: Random) -> list[Undo]:
    del random
    plant.inject("restart")
    return []


def _stuck(plant: Plant, random: Random) -> list[Undo]:
    channel = random.choice(["accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z"])
    plant.inject("stuck_sensor", channel=channel, duration_s=round(random.uniform(3, 60), 1))
    return []


def _move(low_deg: float, high_deg: float) -> Callable[[Plant, Random], list[Undo]]:
    """Turn the block there, and back a while later: the stated attitude is true again."""

    def begin(plant: Plant, random: Random) -> list[Undo]:
        axis = [random.uniform(-1, 1) for _ in range(3)]
        duration_s, angle_deg = round(random.uniform(1, 5), 1), random.uniform(low_deg, high_deg)

        def turn(sign: float) -> None:
            plant.inject("move", duration_s=duration_s, rate_dps=sign * angle_deg / duration_s, axis=axis)

        def back() -> None:
            if plant.displaced:  # a block that was switched off and on stands as it was first put
                turn(-1.0)
                plant.displaced = False

        turn(1.0)
        plant.displaced = True
        return [(random.uniform(10, 120), back)]

    return begin


def _heat(plant: Plant, random: Random) -> list[Undo]:
    change_c = random.choice([-1, 1]) * random.uniform(2.5, 8.0)
    plant.inject("heat", change_c=round(change_c, 2), time_constant_s=round(random.uniform(30, 120), 1))
    return []


def _kill(plant: Plant, random: Random) -> list[Undo]:
    plant.stop_service(signal.SIGKILL)
    return [(random.uniform(1, 60), plant.start_service)]


def _terminate(plant: Plant, random: Random) -> list[Undo]:
    plant.terminate_service()
    return [(random.uniform(1, 60), plant.start_service)]


def _power(plant: Plant, random: Random) -> list[Undo]:
    plant.stop_simulator()
    return [(random.uniform(2, 120), plant.start_simulator)]


def _everything(plant: Plant, random: Random) -> list[Undo]:
    plant.stop_simulator()
    plant.stop_service(signal.SIGKILL)
    back_s = random.uniform(2, 60)
    return [(back_s, plant.start_simulator), (back_s, plant.start_service)]


def _freeze(plant: Plant, random: Random) -> list[Undo]:
    plant.freeze_service(True)
    return [(random.uniform(0.2, 3.0) * plant.speed, lambda: plant.freeze_service(False))]


def _disk(plant: Plant, random: Random) -> list[Undo]:
    plant.fill_disk(True)
    return [(random.uniform(60, 600), lambda: plant.fill_disk(False))]


def _clock(plant: Plant, random: Random) -> list[Undo]:
    plant.set_clock(random.choice([-86_400, -3_600, 3_600, 86_400]) + random.uniform(-60, 60))
    return [(random.uniform(100, 600), lambda: plant.set_clock(0))]


def _deaf_clients(plant: Plant, random: Random) -> list[Undo]:
    """Open event streams and read nothing of them."""
    clients = []
    for _ in range(20):
        client = socket.create_connection(("127.0.0.1", plant.port), timeout=5)
        client.sendall(b"GET /api/v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        clients.append(client)
    return [(random.uniform(100, 600), lambda: [client.close() for client in clients])]


FAULTS = (
    Fault("unplug_short", "the line is pulled for 0.5 to 5 s", _unplug(0.5, 5.0)),
    Fault("unplug_long", "the line is pulled for 20 to 300 s", _unplug(20.0, 300.0)),
    Fault(
        "noise",
        "1 to 40 % of frames spoilt (bits, cuts, garbage, false headers) for 5 to 60 s",
        _noise,
        needs_line=True,
    ),
    Fault("block_restart", "the block's supply fails for a moment", _restart, needs_line=True),
    Fault("block_power", "the block and its line are gone for 2 to 120 s", _power),
    Fault("stuck_sensor", "a channel repeats its value for 3 to 60 s", _stuck, needs_line=True),
    Fault("nudge", "the block is turned by 0.01° to 2° and later back", _move(0.01, 2.0), needs_line=True, turns=True),
    Fault("turn", "the block is turned by 10° to 60° and later back", _move(10.0, 60.0), needs_line=True, turns=True),
    Fault("heat", "the block warms or cools by 2.5 to 8 °C", _heat, needs_line=True),
    Fault("kill", "SIGKILL of the service; started again 1 to 60 s later", _kill, ends=True),
    Fault("terminate", "SIGTERM of the service; started again 1 to 60 s later", _terminate, ends=True),
    Fault("blackout", "SIGKILL of the service and loss of the block at once", _everything, ends=True),
    Fault("frozen_host", "the service's process gets no time for 0.2 to 3 real s", _freeze),
    Fault("disk_full", "the disk takes nothing for 60 to 600 s", _disk, lambda plant: plant.own_disk),
    Fault(
        "clock_jump",
        "the wall clock is an hour or a day off for 100 to 600 s",
        _clock,
    ),
    Fault("deaf_clients", "20 event streams that nobody reads, for 100 to 600 s", _deaf_clients),
)
