"""Two blocks at 2 kHz, two services reading them, and consoles asking: nothing may be lost, and answers stay quick.

At speed 1, each block on a pty of its own, paced at 2 Mbit/s by a UART that drops what is not taken in time and books
it. 200 clients poll ``/status`` twice a second and 20 hold ``/events``, half of each on either service. In alternate
slices of the same run the 200 poll an empty FastAPI route in a process of its own instead.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import tomli_w

BIT_RATE = 2_000_000
RATE_HZ = 2000.0
CLIENTS, LISTENERS, EVERY_S = 200, 20, 0.5
SLICE_S = 10.0
PORTS = (8791, 8792)
EMPTY_PORT = 8793


def simulate(path: Path, ledger: Path, seed: int) -> None:
    """Be a block: stream until SIGTERM, then write the ledger."""
    from drivers.timebase import Timebase
    from simulators.scenarios import demo_model, demo_scenario
    from simulators.simulate import run_on_line

    scenario = demo_scenario(seed)
    block = scenario.block.model_copy(update={"sample_rate_hz": RATE_HZ})
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    run_on_line(
        scenario.model_copy(update={"block": block}),
        demo_model(seed),
        path=path,
        timebase=Timebase(),
        stop=stop,
        bit_rate=BIT_RATE,
        ledger=ledger,
    )


def serve_empty() -> None:
    """Be a FastAPI application with one route that does nothing."""
    import uvicorn
    from fastapi import FastAPI

    app = FastAPI()

    @app.get("/empty")
    async def empty() -> dict[str, str]:
        return {}

    uvicorn.run(app, host="127.0.0.1", port=EMPTY_PORT, log_level="warning", access_log=False)


def settings(folder: Path, number: int) -> Path:
    """Write the settings of one service."""
    table = {
        "link": {"url": str(folder / f"line{number}"), "bit_rate": BIT_RATE},
        "site": {"latitude_deg": 35.7, "height_m": 1200.0},
        "reference": {"azimuth_deg": 0.0, "azimuth_sigma_deg": 0.01},
        "block": {"gyro_kind": "dtg"},
        "store": {"path": str(folder / f"store{number}.db")},
        "http": {"port": PORTS[number]},
    }
    path = folder / f"settings{number}.toml"
    path.write_text(tomli_w.dumps(table))
    return path


class Clients:
    """Connections kept alive, each asking in its own rhythm; answers' times by what was asked."""

    def __init__(self) -> None:
        self.times_s: dict[str, list[float]] = {"status": [], "empty": []}
        self.events = 0
        self.asked = "status"

    async def poll(self, number: int, end: float) -> None:
        """Ask twice a second until ``end``."""
        ports = {"status": PORTS[number % 2], "empty": EMPTY_PORT}
        paths = {"status": "/api/v1/status", "empty": "/empty"}
        lines = {what: await asyncio.open_connection("127.0.0.1", port) for what, port in ports.items()}
        due = time.monotonic() + EVERY_S * number / CLIENTS
        while due < end:
            await asyncio.sleep(max(0.0, due - time.monotonic()))
            what = self.asked
            if lines[what][0].at_eof():  # the server has closed it for having been idle for a slice
                lines[what] = await asyncio.open_connection("127.0.0.1", ports[what])
            reader, writer = lines[what]
            began = time.perf_counter()
            writer.write(f"GET {paths[what]} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
            head = await reader.readuntil(b"\r\n\r\n")
            await reader.readexactly(int(head.lower().split(b"content-length:")[1].split(b"\r\n")[0]))
            self.times_s[what].append(time.perf_counter() - began)
            if not head.startswith(b"HTTP/1.1 200"):
                raise RuntimeError(head.decode())
            due += EVERY_S
        for _, writer in lines.values():
            writer.close()

    async def listen(self, number: int, end: float) -> None:
        """Hold ``/events`` until ``end``."""
        reader, writer = await asyncio.open_connection("127.0.0.1", PORTS[number % 2], limit=2**22)
        writer.write(b"GET /api/v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        while (left := end - time.monotonic()) > 0:
            try:
                line = await asyncio.wait_for(reader.readline(), left)
            except TimeoutError:
                break
            self.events += line.startswith(b"event:")
        writer.close()

    async def alternate(self, end: float, slice_s: float) -> None:
        """Let the polls go to the empty route in every second slice."""
        while time.monotonic() < end:
            await asyncio.sleep(slice_s)
            self.asked = "empty" if self.asked == "status" else "status"

    async def run(self, seconds: float) -> None:
        """Do all this for a while."""
        end = time.monotonic() + seconds
        await asyncio.gather(
            self.alternate(end, min(SLICE_S, seconds / 4)),
            *(self.poll(number, end) for number in range(CLIENTS)),
            *(self.listen(number, end) for number in range(LISTENERS)),
        )


def measure(minutes: float, folder: Path) -> dict[str, Any]:
    """Start everything, load it, end it, and return what was found."""
    module = [sys.executable, "-m", "benchmarks.live"]
    started: list[subprocess.Popen[bytes]] = []
    ledgers = [folder / f"ledger{number}.json" for number in range(2)]
    try:
        blocks = [
            subprocess.Popen([*module, "--block", str(folder / f"line{number}"), str(ledgers[number]), str(number + 1)])
            for number in range(2)
        ]
        started += blocks
        started.append(subprocess.Popen([*module, "--empty"]))
        for number in range(2):
            config = str(settings(folder, number))
            started.append(subprocess.Popen([sys.executable, "-m", "service.cli", "serve", "--config", config]))
        wait_until_heard()
        before = cpu_s(started)
        clients, began = Clients(), time.monotonic()
        asyncio.run(clients.run(60 * minutes))
        elapsed_s = time.monotonic() - began
        busy = [(after - first) / elapsed_s for first, after in zip(before, cpu_s(started), strict=True)]
        counts = [line_counters(port) for port in PORTS]
        for block in blocks:
            block.terminate()
            block.wait(30)
    finally:
        for process in started:
            process.terminate()
        for process in started:
            process.wait(30)
    kept = [json.loads(path.read_text()) for path in ledgers]
    quantiles = {what: np.percentile(times, [50, 99]) * 1e3 for what, times in clients.times_s.items()}
    return {
        "minutes": minutes,
        "frames_sent": [ledger["frames_sent"] for ledger in kept],
        "overrun_bytes": [ledger["overrun_bytes"] for ledger in kept],
        "samples_read": [count["samples"] for count in counts],
        "frames_lost": [count["frames_lost"] for count in counts],
        "queue_drops": [count["queue_drops"] for count in counts],
        "requests": {what: len(times) for what, times in clients.times_s.items()},
        "events": clients.events,
        "status_ms": quantiles["status"].tolist(),
        "empty_ms": quantiles["empty"].tolist(),
        "p99_ratio": float(quantiles["status"][1] / quantiles["empty"][1]),
        "cores": dict(zip(("block 1", "block 2", "empty route", "service 1", "service 2"), busy, strict=True)),
    }


def wait_until_heard() -> None:
    """Start the blocks' streams and wait until both are read and the empty route answers."""
    end = time.monotonic() + 180
    asked = set()
    while True:
        try:
            for port in PORTS:
                state = httpx.get(f"http://127.0.0.1:{port}/api/v1/status").json()
                if port not in asked and state["link"] != "DISCONNECTED":
                    httpx.post(f"http://127.0.0.1:{port}/api/v1/runs", json={"method": "optimal"}).raise_for_status()
                    asked.add(port)
            if all(line_counters(port)["samples"] > RATE_HZ for port in PORTS):
                httpx.get(f"http://127.0.0.1:{EMPTY_PORT}/empty").raise_for_status()
                return
        except httpx.TransportError:
            pass
        if time.monotonic() > end:
            raise RuntimeError("the services did not come up")
        time.sleep(0.2)


def line_counters(port: int) -> dict[str, int]:
    """Return the counters of a service's line from its metrics."""
    text = httpx.get(f"http://127.0.0.1:{port}/api/v1/metrics").text
    pairs = [line.split() for line in text.splitlines() if line.startswith("inertrim_line_") and "{" not in line]
    return {name.removeprefix("inertrim_line_").removesuffix("_total"): int(float(value)) for name, value in pairs}


def cpu_s(processes: list[subprocess.Popen[bytes]]) -> list[float]:
    """Return the processor time [s] that each process has used."""
    tick_s, found = 1.0 / os.sysconf("SC_CLK_TCK"), []
    for process in processes:
        columns = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
        found.append((int(columns[11]) + int(columns[12])) * tick_s)
    return found


def table(found: dict[str, Any]) -> dict[str, Any]:
    """Return the README's table."""
    rows = [
        ["minutes, blocks × rate", f"{found['minutes']:g}, 2 × {RATE_HZ:g} Hz"],
        ["samples sent", f"{sum(found['frames_sent']):,}"],
        ["bytes lost to overrun", f"{sum(found['overrun_bytes'])}"],
        ["samples lost", f"{sum(found['frames_lost'])}"],
        ["/status, median and p99", f"{found['status_ms'][0]:.2f} ms, {found['status_ms'][1]:.2f} ms"],
        ["empty route, median and p99", f"{found['empty_ms'][0]:.2f} ms, {found['empty_ms'][1]:.2f} ms"],
        ["ratio of p99", f"{found['p99_ratio']:.2f}"],
        ["processor of a service", f"{max(found['cores']['service 1'], found['cores']['service 2']):.0%} of a core"],
    ]
    return {"header": [f"{CLIENTS} clients on /status twice a second, {LISTENERS} on /events", ""], "rows": rows}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.live", description=__doc__)
    parser.add_argument("--minutes", type=float, default=0.5, help="10 for the published figure")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--block", nargs=3, metavar=("PTY", "LEDGER", "SEED"), help=argparse.SUPPRESS)
    parser.add_argument("--empty", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.block:
        simulate(Path(arguments.block[0]), Path(arguments.block[1]), int(arguments.block[2]))
    elif arguments.empty:
        serve_empty()
    else:
        with tempfile.TemporaryDirectory() as folder:
            found = measure(arguments.minutes, Path(folder))
        print(json.dumps(found, indent=2))
        if arguments.json:
            arguments.json.write_text(json.dumps({**found, "table": table(found)}, indent=2) + "\n")


if __name__ == "__main__":
    main()
