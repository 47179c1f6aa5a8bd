"""The plant under test: a simulated block on a line and the real service, each a process that may die and come back."""

from __future__ import annotations

import ctypes
import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import httpx
import tomli_w

from service.processes import free_port
from simulators.scenarios import demo_model, demo_scenario
from simulators.simulate import write_calibration

RATE_HZ = 25.0
"""A pseudo-terminal holds 20 kB: at this rate and 40 times real time a reader may be held up for a third of a second.
"""
STALE_REAL_S = 0.5
DISK_MB = 1024
SMALL_DISK = "size={}m"


class Plant:
    """One folder with settings, a block, a service and a disk of its own where the system allows one.

    Parameters
    ----------
    folder : everything goes here.
    seed : of the block.
    speed : simulated seconds per real second, for both processes.
    """

    def __init__(self, folder: Path, seed: int, speed: float) -> None:
        self.folder, self.speed, self.epoch_s = folder, speed, time.monotonic()
        self.line, self.disk = folder / "line", folder / "disk"
        self.disk.mkdir(parents=True)
        self.own_disk = _mount(self.disk)
        self.port = free_port()
        self.clock = folder / "clock"
        self.set_clock(0)
        self._write(seed)
        self._log = (folder / "service.log").open("ab")
        self._simulator: subprocess.Popen[bytes] | None = None
        self._service: subprocess.Popen[bytes] | None = None
        self.displaced = self.full = False
        self.bad_ends: list[int] = []
        self.client = httpx.Client(base_url=f"http://127.0.0.1:{self.port}/api/v1", timeout=20.0)

    @property
    def store(self) -> Path:
        """File of the store."""
        return self.disk / "inertrim.db"

    def now_s(self) -> float:
        """Return simulated seconds since the plant was made."""
        return self.speed * (time.monotonic() - self.epoch_s)

    # ------------------------------------------------------------------ processes

    def start_simulator(self) -> None:
        """Switch the block on; it stands as it was first put."""
        self.displaced = False
        files = {"--pty": self.line, "--scenario": self.folder / "scenario.toml", "--model": self.folder / "block.json"}
        timing = {"--speed": self.speed, "--epoch": self.epoch_s}
        arguments = [str(part) for pair in {**files, **timing}.items() for part in pair]
        command = [sys.executable, "-m", "service.cli", "simulate", *arguments, "--control"]
        if self._simulator is not None:
            return
        with (self.folder / "simulator.log").open("ab") as log:
            self._simulator = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=log, stderr=log, preexec_fn=die_with_parent
            )

    def start_service(self) -> None:
        """Start the service where it does not run; it answers some seconds later."""
        if self._service is not None:
            return
        serve = ["serve", "--config", str(self.folder / "inertrim.toml")]
        command = [sys.executable, "-m", "benchmarks._soak.shifted", str(self.clock), *serve]
        self._service = subprocess.Popen(command, stdout=self._log, stderr=self._log, preexec_fn=die_with_parent)

    def ended(self) -> int | None:
        """Return the exit code of a service that has ended by itself, None while it runs or is meant to be down."""
        return self._service.poll() if self._service is not None else None

    def service_pid(self) -> int | None:
        """Return the service's process id while it runs."""
        return self._service.pid if self._service is not None and self._service.poll() is None else None

    def stop_service(self, number: signal.Signals) -> int:
        """End the service by a signal and return its exit code; 0 where it does not run."""
        if self._service is None:
            return 0
        self._service.send_signal(signal.SIGCONT)
        self._service.send_signal(number)
        code = self._service.wait(60)
        self._service = None
        return code

    def terminate_service(self) -> None:
        """End the service as an operator does, and note an end that is not clean."""
        answered = self.answers()
        code = self.stop_service(signal.SIGTERM)
        if code != 0 and (answered or code != -signal.SIGTERM):  # while it starts, the signal's own end is clean
            self.bad_ends.append(code)

    def answers(self) -> bool:
        """Whether the service answers."""
        try:
            return self.client.get("/healthz", timeout=2.0).status_code == 200
        except httpx.TransportError:
            return False

    def ask_threads(self) -> None:
        """Have the service write to its log where each of its threads is."""
        if self.service_pid() is not None and self._service is not None:
            self._service.send_signal(signal.SIGUSR1)
            time.sleep(1.0)

    def kill_service(self) -> None:
        """End the service at once, whether it runs or has ended by itself."""
        if self._service is not None:
            self._service.kill()
            self._service.wait(60)
            self._service = None

    def freeze_service(self, frozen: bool) -> None:
        """Hold the service's process up, as a starved host does, or let it go on."""
        if self._service is not None:
            self._service.send_signal(signal.SIGSTOP if frozen else signal.SIGCONT)

    def stop_simulator(self) -> None:
        """Take the block's supply and line away at once."""
        if self._simulator is None:
            return
        self._simulator.kill()
        self._simulator.wait(20)
        self._simulator = None
        self.line.unlink(missing_ok=True)

    def inject(self, fault: str, **facts: Any) -> None:
        """Let something happen to the block or its line now."""
        if self._simulator is not None and self._simulator.stdin is not None:
            self._simulator.stdin.write((json.dumps({"fault": fault, **facts}) + "\n").encode())
            self._simulator.stdin.flush()

    # ------------------------------------------------------------------ host

    def set_clock(self, offset_s: float) -> None:
        """Set the service's wall clock so much off."""
        part = self.clock.with_suffix(".part")
        part.write_text(f"{offset_s:.0f}\n")
        part.replace(self.clock)

    def fill_disk(self, full: bool) -> None:
        """Leave the service's disk no room, or give it back."""
        ballast, self.full = self.disk / "ballast", full
        if not full:
            ballast.unlink(missing_ok=True)
            return
        with ballast.open("wb", buffering=0) as file:
            for size in (1 << 20, 1 << 12):
                try:
                    while file.write(b"\0" * size):
                        pass
                except OSError:
                    continue

    def close(self) -> None:
        """End everything."""
        if self.service_pid() is not None:
            self.terminate_service()
        if self._simulator is not None:
            self.stop_simulator()
        self.client.close()
        self._log.close()

    def unmount(self) -> None:
        """Give the disk back; what was on it is gone."""
        if self.own_disk:
            subprocess.run(["umount", str(self.disk)], check=True)

    def _write(self, seed: int) -> None:
        scenario, model = demo_scenario(seed).warmed_up(), demo_model(seed)
        block = scenario.block.model_copy(update={"sample_rate_hz": RATE_HZ})
        scenario = scenario.model_copy(update={"block": block})
        write_calibration(model, self.folder / "calibration.json")
        (self.folder / "block.json").write_text(model.canonical_json())
        written = scenario.model_dump(mode="json", exclude_none=True, by_alias=True, exclude_defaults=True)
        (self.folder / "scenario.toml").write_text(tomli_w.dumps(written))
        settings = {
            "link": {"url": str(self.line), "stale_after_s": STALE_REAL_S * self.speed},
            "site": {"latitude_deg": 35.7, "height_m": 1200.0},
            "reference": scenario.reference.model_dump(exclude_none=True),
            "block": {"calibration": "calibration.json", "gyro_kind": "dtg"},
            "store": {"path": "disk/inertrim.db"},
            "http": {"port": self.port},
            "time": {"speed": self.speed, "epoch_s": self.epoch_s},
        }
        (self.folder / "inertrim.toml").write_text(tomli_w.dumps(settings))


def die_with_parent() -> None:
    """Have the kernel end this child when the soak itself is killed (prctl PR_SET_PDEATHSIG)."""
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)


def memory_mb(pid: int) -> tuple[float, float] | None:
    """Return the memory that a process holds [MB], whole and its own, None when it is gone.

    Its own is without the pages of files, mostly of shared code: these the kernel takes away and gives back as it
    likes, megabytes at once, which would hide what the process itself gains.
    """
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return None
    lines = (line.split() for line in status.splitlines())
    kilobytes = {words[0]: int(words[1]) for words in lines if words[0] in ("VmRSS:", "RssFile:")}
    if len(kilobytes) < 2:
        return None
    return kilobytes["VmRSS:"] / 1024.0, (kilobytes["VmRSS:"] - kilobytes["RssFile:"]) / 1024.0


def open_files(pid: int) -> int:
    """Return how many files a process has open."""
    try:
        return len(list(Path(f"/proc/{pid}/fd").iterdir()))
    except OSError:
        return 0


def _mount(folder: Path) -> bool:
    """Give the folder a disk of its own that can be filled; False where the system does not allow it."""
    command = ["mount", "-t", "tmpfs", "-o", SMALL_DISK.format(DISK_MB), "inertrim-soak", str(folder)]
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        return False
