"""Detection: names what is on a line, at which bit rate, how surely, and nothing where nothing is."""

from __future__ import annotations

import contextlib
import random
import threading
from collections.abc import Iterator

import pytest
from driver_bench import Cable
from protocol_bench import CASES, Case, frames_of, moving_samples

from drivers.detect import Candidate, common_bit_rates, detect, judge
from drivers.messages import Configuration, Identity
from drivers.protocols import get_protocol, protocol_names
from drivers.protocols.base import ProtocolError

EVERY = [get_protocol(name) for name in protocol_names()]
every_case = pytest.mark.parametrize("case", CASES, ids=str)


def best(data: bytes) -> list[Candidate]:
    """Return all candidates for bytes, the surest first."""
    found = [one for protocol in EVERY if (one := judge(data, protocol)) is not None]
    return sorted(found, key=lambda one: -one.confidence)


@every_case
def test_a_stream_cut_anywhere_is_told_surely_and_as_one_thing(case: Case) -> None:
    stream = b"".join(frames_of(case, moving_samples(150, case.rate_hz)))
    rng = random.Random(str(case))
    for _ in range(3):
        first, last = rng.randrange(200), len(stream) - rng.randrange(200)
        (candidate,) = best(stream[first:last])
        assert candidate.protocol == case.name
        assert candidate.confidence > 0.95
        assert "frames with a good checksum" in candidate.evidence


@every_case
def test_damage_lowers_the_confidence_and_not_the_answer(case: Case) -> None:
    rng = random.Random(1)
    frames = frames_of(case, moving_samples(200, case.rate_hz))
    spoiled = [frame if rng.random() < 0.7 else rng.randbytes(len(frame)) for frame in frames]
    candidate = best(b"".join(spoiled))[0]
    assert candidate.protocol == case.name
    assert 0.5 < candidate.confidence < 0.9


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_nothing(seed: int) -> None:
    assert best(random.Random(seed).randbytes(20_000)) == []
    assert best(b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n" * 200) == []
    assert best(bytes(10_000)) == []
    assert best(b"") == []


def test_a_few_frames_with_a_weak_checksum_are_no_evidence() -> None:
    frame = frames_of(Case("hg4930", {"message": "control"}, 600.0, b""), moving_samples(1, 600.0))[0]
    noise = random.Random(1).randbytes(8000)
    assert judge(noise + frame + noise, get_protocol("hg4930")) is None
    stim = frames_of(Case("stim300", {}, 2000.0, b""), moving_samples(2, 2000.0))
    found = judge(noise + b"".join(stim) + noise, get_protocol("stim300"))
    assert found is not None
    assert found.confidence < 0.05


class Wire:
    """A port that says something at one bit rate and garbage at all others."""

    def __init__(self, data: bytes, bit_rate: int) -> None:
        self.data, self.bit_rate, self.opened = data, bit_rate, list[int]()

    def open(self, url: str, bit_rate: int) -> Wire._Port:
        assert url == "port"
        if bit_rate == 374400:
            raise ValueError("this adapter has no such bit rate")
        self.opened.append(bit_rate)
        return self._Port(self.data if bit_rate == self.bit_rate else random.Random(bit_rate).randbytes(9000))

    class _Port:
        def __init__(self, data: bytes) -> None:
            self._data = data

        def read(self, size: int) -> bytes:
            part, self._data = self._data[:size], self._data[size:]
            return part

        def close(self) -> None:
            pass


@pytest.mark.parametrize("bit_rate", [921600, 460800, 1843200])
def test_the_bit_rate_is_found_by_trying(bit_rate: int) -> None:
    case = Case("stim300", {}, 2000.0, b"")
    wire = Wire(b"".join(frames_of(case, moving_samples(200, 2000.0))), bit_rate)
    (found,) = detect("port", listen_s=0.01, open_port=wire.open)
    assert (found.protocol, found.bit_rate) == ("stim300", bit_rate)
    assert wire.opened[-1] == bit_rate  # and no further one is tried
    assert wire.opened[0] == 921600


def test_a_line_that_says_nothing_known_gives_nothing_at_any_bit_rate() -> None:
    wire = Wire(b"", 0)
    assert detect("port", listen_s=0.01, open_port=wire.open) == []
    assert len(wire.opened) == len(common_bit_rates(EVERY)) - 1


def test_a_port_that_cannot_be_opened_is_an_error() -> None:
    with pytest.raises(OSError, match="/dev/nothing-here: cannot be opened"):
        detect("/dev/nothing-here", bit_rates=[921600, 115200])
    with pytest.raises(ProtocolError, match="wings"):
        detect("/dev/nothing-here", protocols=["wings"])


@contextlib.contextmanager
def talking(cable: Cable, data: bytes) -> Iterator[None]:
    """Let the far end of a cable say something over and over."""
    done = threading.Event()

    def talk() -> None:
        while not done.wait(0.01):
            with contextlib.suppress(OSError):
                cable.write(data)

    thread = threading.Thread(target=talk, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join(5)


def test_a_real_port_is_told_apart(cable: Cable) -> None:
    case = Case("mip", {}, 500.0, b"")
    data = b"".join(frames_of(case, moving_samples(20, 500.0)))
    with talking(cable, data):
        (found,) = detect(str(cable.path), listen_s=5.0)
    assert found.protocol == "mip"
    assert found.confidence > 0.9


def test_an_idle_block_of_ours_is_told_by_its_announcements(cable: Cable) -> None:
    native = get_protocol("native")
    said = native.encode_message(Identity("block", "1", "1")) + native.encode_message(
        Configuration(100.0, 921600, 294.0, 7.0, False)
    )
    with talking(cable, said):
        (found,) = detect(str(cable.path), listen_s=0.3)
    assert (found.protocol, found.confidence) == ("native", 1.0)
