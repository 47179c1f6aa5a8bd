"""A capture played onto a pty by ``inertrim replay`` and read by a service over HTTP, at another speed than it was."""

from __future__ import annotations

import time
from pathlib import Path

import httpx
import numpy as np
from forked import Program
from http_bench import serving, settings_for

from drivers.capture import CaptureWriter
from drivers.protocols import get_protocol
from drivers.samples import empty_samples

RATE_HZ, COUNT, SPEED = 500.0, 3000, 4.0


def test_every_sample_of_a_replay_reaches_the_service(tmp_path: Path) -> None:
    samples, native = empty_samples(COUNT, 3), get_protocol("native")
    samples["sequence"] = np.arange(COUNT)
    samples["time"] = (samples["sequence"] + 1) / RATE_HZ
    data, writer = native.encode_samples(samples), CaptureWriter(tmp_path / "line.cap")
    for row in range(0, COUNT, 5):
        writer.write(data[row * 60 : row * 60 + 300], 100.0 + float(samples["time"][row + 4]))
    writer.close()
    link, epoch_s = {"url": str(tmp_path / "tty")}, time.monotonic()
    with serving(settings_for(tmp_path, link=link, time={"speed": SPEED, "epoch_s": epoch_s})) as (_, client):
        player = Program("replay", "line.cap", "--pty", "tty", "--speed", str(SPEED), folder=tmp_path)
        try:
            end = time.monotonic() + 60
            while counted(client, "samples") < COUNT:
                assert time.monotonic() < end
                time.sleep(0.05)
        finally:
            assert player.wait(20) == 0
        assert (counted(client, "frames_lost"), counted(client, "crc_failures")) == (0, 0)


def counted(client: httpx.Client, name: str) -> int:
    """Return a counter of the line."""
    lines = [line.split() for line in client.get("/metrics").text.splitlines()]
    (found,) = [float(line[1]) for line in lines if line[0] == f"inertrim_line_{name}_total"]
    return int(found)
