"""What the store's connections keep of its file: no more than their share, however large the file has become."""

from __future__ import annotations

import subprocess
import sys

import pytest

CONNECTIONS, FILE_MB = 5, 8

PROGRAM = f"""
import sys
from pathlib import Path
from threading import Barrier, Thread
from service.native_memory import give_back, trim
from service.store import Store
from service.store import sqlite

def own_mb():
    line = next(line for line in open("/proc/self/status") if line.startswith("RssAnon"))
    return int(line.split()[1]) / 1024

def read_all():
    together.wait()
    for run_id in runs:
        store.result(run_id)

give_back()
sqlite.CACHE_KB = int(sys.argv[2])
store = Store(Path(sys.argv[1]))
runs, document = [], "0" * 16_000
for _ in range({FILE_MB} * 1_000_000 // len(document)):
    record, _ = store.create_run({{}}, "optimal", None)
    store.save_result(record.id, document, "fit")
    runs.append(record.id)
trim()
before = own_mb()
together = Barrier({CONNECTIONS})
readers = [Thread(target=read_all) for _ in range({CONNECTIONS})]
for reader in readers:
    reader.start()
for reader in readers:
    reader.join()
trim()
print(own_mb() - before)
"""


def gained_mb(tmp_path_factory: pytest.TempPathFactory, cache_kb: int) -> float:
    """Return by how much a process grows that reads a whole store over several connections."""
    command = [sys.executable, "-c", PROGRAM, str(tmp_path_factory.mktemp("store") / "store.db"), str(cache_kb)]
    return float(subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout)


def test_connections_keep_little_of_a_large_store(tmp_path_factory: pytest.TempPathFactory) -> None:
    from service.store.sqlite import CACHE_KB

    ours, sqlites_own = gained_mb(tmp_path_factory, CACHE_KB), gained_mb(tmp_path_factory, 2_000)
    assert sqlites_own > 4.0  # or there would be nothing to be told apart
    assert ours < 0.5 * sqlites_own
