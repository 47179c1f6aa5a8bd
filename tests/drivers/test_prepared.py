"""Nothing is compiled while a line is read: what is made ready beforehand covers whatever may come."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import sys
import numpy as np
from drivers import scan
from drivers.protocols import get_protocol, native_unpack
from drivers.samples import empty_samples
from drivers.stream import STRETCH_BYTES, StreamDecoder

def versions():
    names = [(module, name) for module in (scan, native_unpack) for name in vars(module)]
    found = {name: getattr(module, name) for module, name in names}
    return {name: list(one.overloads) for name, one in found.items() if hasattr(one, "overloads")}

protocol = get_protocol(sys.argv[1])
samples = empty_samples(400, protocol.temperatures)
samples["sequence"] = np.arange(1, 401)
samples["time"] = samples["sequence"] / 125.0
data = protocol.encode_samples(samples)
stream = StreamDecoder(protocol)
stream.prepare()
before = versions()
cuts = [0, 1 + 2 * STRETCH_BYTES, 7 + 3 * STRETCH_BYTES, len(data)]
seen = 0
for number, (start, end) in enumerate(zip(cuts, cuts[1:])):  # one stretch on nothing, then on what waits of the last
    middle = (start + end) // 2
    stream.feed_chunks([(number + 0.5, data[start:middle]), (number + 1.0, data[middle:end])])
    seen += len(stream.take(number + 1.0).samples)
assert seen >= 399, seen
assert any(before.values())
assert versions() == before, f"compiled while reading: {before} became {versions()}"
"""


@pytest.mark.parametrize("protocol", ["native", "stim300"])
def test_reading_compiles_nothing_after_it_was_prepared(protocol: str) -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT, protocol], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
