"""What things leave behind when they are freed between others that live long, with and without giving it back."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PROGRAM = """
import sys
from threading import Barrier, Lock, Thread
import numpy as np
from service.native_memory import fill, give_back, trim

def resident_mb():
    # Without pages of files, which the kernel takes away when it likes.
    line = next(line for line in open("/proc/self/status") if line.startswith("RssAnon"))
    return int(line.split()[1]) / 1024

def arrays_come_and_go(lasting):
    arrays = []
    for _ in range(100):
        arrays.append(np.ones(40_000))
        lasting.append(bytes(2_000))

def small_things_come_and_go(lasting):
    small = []
    for _ in range(500):
        small.append(bytes(50_000))
        lasting.append(bytes(600))

def threads_come_and_go(lasting):
    turn, all_done = Lock(), Barrier(8)
    def work():
        with turn:
            small_things_come_and_go(lasting)
        all_done.wait()
    threads = [Thread(target=work) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

def small_arrays_come_and_go(lasting):
    for size in SIZES:
        arrays = [np.empty(size, np.uint8) for _ in range(8)]

SIZES = np.random.default_rng(1).integers(0, 1024, 20_000)
come_and_go, how = globals()[sys.argv[1].replace(" ", "_") + "_come_and_go"], sys.argv[2]
told = give_back() if how != "as it comes" else True
if how == "filled":
    fill()
lasting, before = [], resident_mb()
for _ in range(3):
    come_and_go(lasting)
if how == "trimmed":
    trim()
print(told, resident_mb() - before)
"""


def left_mb(what: str, how: str) -> float:
    """Return by how much a process has grown when all that came has gone, but for what lives on: 9 MB at most."""
    command = [sys.executable, "-c", PROGRAM, what, how]
    # dask's nanny, which other tests start, tells the C library of all processes after it when to trim.
    plain = {name: value for name, value in os.environ.items() if not name.startswith("MALLOC_")}
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True, env=plain)
    told, left = done.stdout.split()
    if told != "True":
        pytest.skip("this C library has no mallopt")
    return float(left)


def test_memory_of_arrays_goes_back_to_the_kernel() -> None:
    assert left_mb("arrays", "as it comes") > 10.0  # or there would be nothing to be told apart
    assert left_mb("arrays", "given back") < 3.0


def test_free_pages_inside_the_heap_go_back_when_it_is_trimmed() -> None:
    assert left_mb("small things", "given back") > 20.0
    assert left_mb("small things", "trimmed") < 12.0  # two pages at most for each of 1500 things that live on


def test_threads_use_what_others_left() -> None:
    assert left_mb("threads", "as it comes") > 8 * 20.0  # each of eight keeps what it once needed
    assert left_mb("threads", "given back") < 4 * 20.0


def test_numpy_keeps_no_more_small_arrays_than_it_was_filled_with() -> None:
    assert left_mb("small arrays", "given back") > 3.0
    assert left_mb("small arrays", "filled") < 1.0
