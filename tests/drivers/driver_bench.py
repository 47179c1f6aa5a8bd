"""A cable that can be unplugged, and a block that counts, for the drivers' tests."""

from __future__ import annotations

import os
import time
import tty
from collections.abc import Callable
from pathlib import Path

import numpy as np

from drivers.protocols import get_protocol
from drivers.samples import SampleArray, empty_samples


def counting_samples(count: int, first: int = 0, seed: int = 0) -> SampleArray:
    """Return plausible samples on the native frame's own steps, so that they survive it unchanged."""
    rng = np.random.default_rng(seed)
    samples = empty_samples(count, temperatures=3)
    samples["sequence"] = np.arange(first, first + count)
    samples["time"] = (np.arange(first, first + count) + 1) * 10_000 / 1e6
    samples["dv"] = rng.integers(-(2**18), 2**18, (count, 3)) * 2.0**-24
    samples["dtheta"] = rng.integers(-(2**12), 2**12, (count, 3)) * 2.0**-30
    samples["temperature"] = rng.integers(5000, 9000, (count, 3)) / 256
    samples["supply"] = np.float32(28.0)
    return samples


def encoded(samples: SampleArray) -> list[bytes]:
    """Return the native frames of samples one by one."""
    data = get_protocol("native").encode_samples(samples)
    size = len(data) // max(len(samples), 1)
    return [data[start : start + size] for start in range(0, len(data), size)]


def until(condition: Callable[[], bool], timeout_s: float = 10.0) -> None:
    """Wait until a condition holds; fail after ``timeout_s``."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "the condition did not come true in time"
        time.sleep(0.002)


class Cable:
    """A pseudo-terminal behind a symbolic link, as udev gives a serial adapter; the far end is the block's."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.far = -1
        self._near = -1

    def plug(self) -> None:
        """Make a new device and point the link at it."""
        self.far, self._near = os.openpty()
        tty.setraw(self._near)
        os.set_blocking(self.far, False)
        fresh = self.path.with_suffix(".new")
        fresh.symlink_to(os.ttyname(self._near))
        fresh.replace(self.path)

    def unplug(self) -> None:
        """Take the device away; whoever has it open gets an error."""
        self.path.unlink(missing_ok=True)
        if self.far >= 0:
            os.close(self._near)
            os.close(self.far)
            self.far = self._near = -1

    def write(self, data: bytes) -> None:
        """Send from the block's end, waiting while the pty is full."""
        while data:
            try:
                data = data[os.write(self.far, data) :]
            except BlockingIOError:
                time.sleep(0.001)

    def read(self) -> bytes:
        """Return what the host sent."""
        try:
            return os.read(self.far, 65536)
        except (BlockingIOError, OSError):
            return b""
