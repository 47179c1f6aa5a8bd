"""Anything a line can say, much of it: no crash, no hang, no swelling. A bounded share is here, the rest is long."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from fuzz_target import CORPUS, NAMES, PROTOCOLS, lines_of, one_input, seeds, storm
from hypothesis import given, settings
from hypothesis import strategies as st
from protocol_bench import bare_of, split

every_protocol = pytest.mark.parametrize("which", range(len(NAMES)), ids=NAMES)
STORM = 300
LONG_SHARES = {"coverage": 100_000, "storm": 10_000_000}


@every_protocol
@pytest.mark.parametrize("seed", range(3))
def test_every_frame_of_the_corpus_is_found_among_its_neighbours(which: int, seed: int) -> None:
    protocol, lines = PROTOCOLS[which], lines_of(CORPUS / f"{NAMES[which]}.hex")
    found, _ = split(b"".join(data for _, data in lines), protocol, seed)
    wanted = bare_of(protocol, [data for what, data in lines if what == "frame"])
    assert len(wanted) >= 1
    rest = iter(bare_of(protocol, found))
    assert all(frame in rest for frame in wanted)  # in this order


def test_the_corpus_is_all_of_the_protocols_and_small() -> None:
    assert sorted(path.stem for path in CORPUS.iterdir()) == sorted(NAMES)
    assert sum(path.stat().st_size for path in CORPUS.iterdir()) < 50_000
    for seed in seeds():
        one_input(seed)


@settings(deadline=None, max_examples=300)
@given(which=st.integers(0, len(NAMES) - 1), how=st.integers(0, 255), data=st.data())
def test_single_inputs_do_no_harm(which: int, how: int, data: st.DataObject) -> None:
    sync = st.sampled_from(PROTOCOLS[which].sync)
    pieces = data.draw(st.lists(st.one_of(st.binary(max_size=40), sync), max_size=6))
    one_input(bytes([which, how]) + b"".join(pieces))


@every_protocol
@pytest.mark.parametrize("seed", range(4))
def test_streams_of_mutated_pieces_do_no_harm(which: int, seed: int) -> None:
    storm(which, seed, STORM)


@pytest.mark.long
@pytest.mark.timeout(0)
@pytest.mark.parametrize("engine", LONG_SHARES)
def test_ten_million_inputs_do_no_harm(engine: str, tmp_path: Path) -> None:
    if engine == "coverage":
        pytest.importorskip("atheris", reason="needs the extra `fuzz`, which `make long` installs")
    script, facts = Path(__file__).with_name("fuzz_run.py"), tmp_path / "facts.json"
    command = [sys.executable, str(script), engine, "--inputs", str(LONG_SHARES[engine]), "--json", str(facts)]
    done = subprocess.run(command, cwd=tmp_path, env=os.environ, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(facts.read_text())
    assert found["inputs"] >= LONG_SHARES[engine]
    assert found["peak_mb"] < 600
    print(found)
