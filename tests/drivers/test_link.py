"""A link over real pseudo-terminals and sockets: unplugged, plugged in again, re-pointed, damaged, silent."""

from __future__ import annotations

import random
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from driver_bench import Cable, counting_samples, encoded, until

from drivers.capture import CaptureWriter, replay
from drivers.link import BATCH_S, LinkError, LinkState, SerialLink
from drivers.messages import Configuration, Start
from drivers.protocols import get_protocol
from drivers.protocols.native import encode_message
from drivers.samples import SampleArray
from drivers.stream import Batch
from drivers.timebase import Timebase

NATIVE = get_protocol("native")
SAMPLES = counting_samples(2000)
FRAMES = encoded(SAMPLES)
SPEED = 1.0


@pytest.fixture
def link(cable: Cable) -> Iterator[SerialLink]:
    """A started link on the cable."""
    with SerialLink(str(cable.path), NATIVE, timebase=Timebase(SPEED)) as link:
        until(lambda: link.state is not LinkState.DISCONNECTED and link.state is not LinkState.OPENING)
        yield link


def collect(link: SerialLink, count: int, timeout_s: float = 10.0) -> list[Batch]:
    """Read until ``count`` samples have come."""
    batches: list[Batch] = []
    deadline = time.monotonic() + timeout_s
    while sum(len(batch.samples) for batch in batches) < count and time.monotonic() < deadline:
        if batch := link.read(0.05):
            batches.append(batch)
    return batches


def samples_of(batches: list[Batch]) -> SampleArray:
    """Return all samples of batches."""
    return np.concatenate([batch.samples for batch in batches]) if batches else SAMPLES[:0]


def open_link(link: SerialLink) -> bool:
    """Whether the port is open, going by the state alone."""
    link.read(0.0)
    return link.state in (LinkState.SYNCING, LinkState.STREAMING, LinkState.STALE)


def test_every_sample_arrives(cable: Cable, link: SerialLink) -> None:
    threading.Thread(target=cable.write, args=(b"".join(FRAMES),)).start()
    assert samples_of(collect(link, 2000)).tobytes() == SAMPLES.tobytes()
    assert link.counters.bytes_discarded == link.counters.frames_lost == 0


def test_states_follow_what_the_line_does(cable: Cable, link: SerialLink) -> None:
    assert link.state is LinkState.SYNCING
    assert link.age_s() == float("inf")
    cable.write(b"junk" * 10)
    link.read(0.05)
    assert link.state is LinkState.SYNCING
    cable.write(FRAMES[0])
    collect(link, 1)
    assert link.state is LinkState.STREAMING
    until(lambda: link.state is LinkState.STALE)
    assert link.age_s() >= 0.5
    cable.write(FRAMES[1])
    collect(link, 1)
    assert link.state is LinkState.STREAMING
    cable.unplug()
    until(lambda: link.state is LinkState.DISCONNECTED)
    assert link.reason
    cable.plug()
    until(lambda: link.state is LinkState.SYNCING)  # what came before the re-plug does not make it good
    link.stop()
    assert link.state is LinkState.DISCONNECTED


@pytest.mark.parametrize("before", ["SYNCING", "STREAMING", "STALE", "DISCONNECTED"])
def test_unplugged_and_plugged_in_again_in_each_state(cable: Cable, link: SerialLink, before: str) -> None:
    if before in ("STREAMING", "STALE"):
        cable.write(b"".join(FRAMES[:100]))
        collect(link, 100)
    if before == "DISCONNECTED":
        cable.unplug()
    until(lambda: link.state == before)
    cable.unplug()
    until(lambda: link.state is LinkState.DISCONNECTED)
    cable.plug()
    until(lambda: open_link(link))
    cable.write(b"".join(FRAMES[300:500]))
    batches = collect(link, 200)
    assert samples_of(batches).tobytes() == SAMPLES[300:500].tobytes()
    assert link.state is LinkState.STREAMING
    assert link.counters.openings == 2
    assert [gap.frames for batch in batches for gap in batch.gaps] == (
        [200] if before in ("STREAMING", "STALE") else []
    )
    assert [row for batch in batches for row in batch.reopened] == [0]


@pytest.mark.parametrize("cut", [1, 4, 7, 20, 59])
def test_unplugged_inside_a_frame(cable: Cable, link: SerialLink, cut: int) -> None:
    cable.write(b"".join(FRAMES[:50]) + FRAMES[50][:cut])
    first = collect(link, 50)
    until(lambda: link.counters.bytes_in == 3000 + cut or bool(link.read(0.01)))
    cable.unplug()
    until(lambda: link.state is LinkState.DISCONNECTED)
    cable.plug()
    until(lambda: open_link(link))
    cable.write(FRAMES[50][cut:] + b"".join(FRAMES[51:100]))
    second = collect(link, 49)
    assert samples_of(first + second).tobytes() == SAMPLES[np.r_[0:50, 51:100]].tobytes()
    assert link.counters.frames_lost == 1


def test_a_path_that_leads_elsewhere_is_followed_though_the_old_device_still_stands(
    cable: Cable, link: SerialLink
) -> None:
    other = Cable(cable.path)
    other.plug()
    try:
        until(lambda: link.counters.openings == 2)
        until(lambda: open_link(link))
        other.write(b"".join(FRAMES[:10]))
        assert len(samples_of(collect(link, 10))) == 10
    finally:
        other.unplug()


def test_a_link_waits_for_a_device_that_is_not_there_yet(tmp_path: Path) -> None:
    cable = Cable(tmp_path / "later")
    with SerialLink(str(cable.path), NATIVE, timebase=Timebase(SPEED)) as link:
        until(lambda: link.counters.open_failures >= 3)
        assert link.state in (LinkState.DISCONNECTED, LinkState.OPENING)
        assert "later" in link.reason
        cable.plug()
        until(lambda: open_link(link))
        cable.write(FRAMES[0])
        assert len(samples_of(collect(link, 1))) == 1
    cable.unplug()


def test_attempts_to_open_become_rarer(tmp_path: Path) -> None:
    with SerialLink(str(tmp_path / "never"), NATIVE, timebase=Timebase(10.0)) as link:
        time.sleep(0.6)  # pauses of 10, 20, 40, 80, 160, 200 ms: six attempts in 0.6 s
        assert 3 <= link.counters.open_failures <= 8


def test_no_untouched_frame_is_lost_on_a_damaged_line(cable: Cable, link: SerialLink) -> None:
    rng = random.Random(4)
    stream, untouched = bytearray(), []
    for number, frame in enumerate(FRAMES):
        sent = bytearray(frame)
        if rng.random() < 0.01:
            sent[rng.randrange(len(sent))] ^= 1 << rng.randrange(8)
        if rng.random() < 0.002:
            del sent[rng.randrange(len(sent)) :]
        if rng.random() < 0.002:
            stream += rng.randbytes(rng.randint(1, 300))
        stream += sent
        if sent == frame:
            untouched.append(number)
    threading.Thread(target=cable.write, args=(bytes(stream),)).start()
    batches = collect(link, len(untouched))
    assert samples_of(batches).tobytes() == SAMPLES[untouched].tobytes()
    assert link.counters.frames_lost == untouched[-1] + 1 - len(untouched)
    assert link.counters.crc_failures > 0


def test_a_queue_nobody_reads_drops_its_oldest_and_says_so(cable: Cable) -> None:
    with SerialLink(str(cable.path), NATIVE, timebase=Timebase(SPEED), queue_bytes=12_000) as link:
        until(lambda: open_link(link))
        for start in range(0, 2000, 10):  # small chunks, so that the queue holds some
            cable.write(b"".join(FRAMES[start : start + 10]))
            time.sleep(0.001)
        until(lambda: link.counters.bytes_dropped >= 120_000 - 12_000 - 16_384)
        time.sleep(0.1)
        samples = samples_of([batch for _ in range(3) if (batch := link.read(0.05))])
        assert samples["sequence"][-1] == 1999
        assert len(samples) < 600
        assert link.counters.queue_drops > 0
        assert link.counters.bytes_in + link.counters.bytes_dropped == 120_000


def test_what_was_captured_replays_to_what_was_read(cable: Cable, tmp_path: Path) -> None:
    capture = CaptureWriter(tmp_path / "a.cap")
    with SerialLink(str(cable.path), NATIVE, timebase=Timebase(SPEED), capture=capture) as link:
        until(lambda: open_link(link))
        threading.Thread(
            target=cable.write, args=(b"".join(FRAMES[:1000]) + b"junk" + b"".join(FRAMES[1002:]),)
        ).start()
        live = collect(link, 1998)
        link.send(encode_message(Start(), 1))
    capture.close()
    replayed = list(replay(tmp_path / "a.cap", NATIVE))
    assert samples_of(replayed).tobytes() == samples_of(live).tobytes()
    assert [gap.frames for batch in replayed for gap in batch.gaps] == [2]
    live_s = np.concatenate([batch.host_time_s for batch in live])
    replayed_s = np.concatenate([batch.host_time_s for batch in replayed])
    assert np.array_equal(live_s, replayed_s)


def test_a_full_disk_costs_the_capture_and_not_the_line(cable: Cable) -> None:
    capture = CaptureWriter("/dev/full")
    with SerialLink(str(cable.path), NATIVE, timebase=Timebase(SPEED), capture=capture) as link:
        until(lambda: open_link(link))
        cable.write(b"".join(FRAMES[:10]))
        assert len(samples_of(collect(link, 10))) == 10
        assert link.counters.capture_failures == 1


def test_sending_reaches_the_block_and_fails_by_name_when_it_cannot(cable: Cable, link: SerialLink) -> None:
    frame = encode_message(Start(), 1)
    link.send(frame)
    got = bytearray()
    until(lambda: bool(got.extend(cable.read())) or bytes(got) == frame)
    cable.unplug()
    until(lambda: link.state is LinkState.DISCONNECTED)
    with pytest.raises(LinkError, match="ttyINS: cannot send"):
        link.send(frame)


@pytest.mark.parametrize(("name", "asked"), [("stim300", b"C\rI\r"), ("native", b""), ("kvh1750", b"")])
def test_a_device_is_asked_how_it_is_set_whenever_the_line_is_opened(cable: Cable, name: str, asked: bytes) -> None:
    with SerialLink(str(cable.path), get_protocol(name), timebase=Timebase(SPEED)) as link:
        for openings in (1, 2):
            until(lambda openings=openings: link.counters.openings == openings and open_link(link))  # type: ignore[misc]
            got = bytearray()
            until(lambda got=got: bool(got.extend(cable.read())) or bytes(got) == asked)  # type: ignore[misc]
            time.sleep(0.02)
            assert cable.read() == b""
            cable.unplug()
            cable.plug()


def test_what_the_device_answers_is_believed_over_the_options(cable: Cable) -> None:
    device, samples = get_protocol("stim300", accel_range_g=30, rate_hz=500), counting_samples(20)
    samples["time"], samples["dv"] = (samples["sequence"] + 1) / 500, [0.0, 0.0, 9.81 / 500]
    with SerialLink(str(cable.path), get_protocol("stim300"), timebase=Timebase(SPEED)) as link:
        until(lambda: cable.read() != b"")
        cable.write(
            device.encode_message(Configuration(500.0, 921600, 0.0, 0.0, True)) + device.encode_samples(samples)
        )
        read = samples_of(collect(link, 20))
    assert np.abs(read["dv"] - samples["dv"]).max() < 9.81 / 2**18


def test_a_second_reader_is_kept_off_the_port(cable: Cable, link: SerialLink) -> None:
    with SerialLink(str(cable.path), NATIVE, timebase=Timebase(SPEED)) as second:
        until(lambda: second.counters.open_failures > 0)
        assert "lock" in second.reason
    assert open_link(link)


def test_an_impossible_url_is_refused_at_once() -> None:
    with pytest.raises(LinkError, match="carrier-pigeon"):
        SerialLink("carrier-pigeon://coop", NATIVE)


def test_loop_url_hears_itself() -> None:
    with SerialLink("loop://", NATIVE) as link:
        until(lambda: open_link(link))
        link.send(b"".join(FRAMES[:5]))
        assert samples_of(collect(link, 5)).tobytes() == SAMPLES[:5].tobytes()


class Server:
    """A serial server on the loopback: one client at a time."""

    def __init__(self) -> None:
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.url = f"socket://127.0.0.1:{self._listening.getsockname()[1]}"

    def accept(self) -> socket.socket:
        """Return the next client."""
        self._listening.settimeout(10)
        return self._listening.accept()[0]

    def close(self) -> None:
        """Listen no more."""
        self._listening.close()


@pytest.mark.parametrize("cut", [0, 5, 59])
def test_a_network_line_is_lost_at_any_byte_and_found_again(cut: int) -> None:
    server = Server()
    with SerialLink(server.url, NATIVE, timebase=Timebase(SPEED)) as link:
        with server.accept() as client:
            until(lambda: open_link(link))
            client.sendall(b"".join(FRAMES[:500]) + FRAMES[500][:cut])
            first = collect(link, 500)
        until(lambda: link.counters.disconnections == 1)
        with server.accept() as client:
            until(lambda: link.counters.openings == 2 and open_link(link))
            client.sendall(FRAMES[500][cut:] + b"".join(FRAMES[501:1000]))
            second = collect(link, 500 - (cut > 0))
            link.send(b"ping")
            assert client.recv(4) == b"ping"
    server.close()
    expected = SAMPLES[:1000] if cut == 0 else SAMPLES[np.r_[0:500, 501:1000]]
    assert samples_of(first + second).tobytes() == expected.tobytes()


def test_a_network_line_hands_frames_on_without_waiting_for_more() -> None:
    """What comes later than a batch behind the one before is handed on at once."""
    server = Server()
    with SerialLink(server.url, NATIVE) as link, server.accept() as client:
        until(lambda: open_link(link))
        delays = []
        for frame in FRAMES[:20]:
            time.sleep(1.2 * BATCH_S)
            sent = time.monotonic()
            client.sendall(frame)
            collect(link, 1)
            delays.append(time.monotonic() - sent)
        assert sorted(delays)[10] < BATCH_S
    server.close()


def test_arrival_times_increase_and_lie_between_sending_and_now(cable: Cable, link: SerialLink) -> None:
    sent_s = link.timebase.now_s()
    cable.write(b"".join(FRAMES[:200]))
    times_s = np.concatenate([batch.host_time_s for batch in collect(link, 200)])
    assert np.all(np.diff(times_s) >= 0)
    assert sent_s - 200 * 60 * 10 / 921600 <= times_s[0]
    assert times_s[-1] <= link.timebase.now_s()


def test_two_links_do_not_disturb_one_another(tmp_path: Path) -> None:
    cables = [Cable(tmp_path / "one"), Cable(tmp_path / "two")]
    for cable in cables:
        cable.plug()
    links = [SerialLink(str(cable.path), NATIVE, timebase=Timebase(SPEED)) for cable in cables]
    for link, cable in zip(links, cables, strict=True):
        link.start()
        until(lambda link=link: open_link(link))  # type: ignore[misc]
        threading.Thread(target=cable.write, args=(b"".join(FRAMES),)).start()
    cables_samples = [samples_of(collect(link, 2000)) for link in links]
    for link, cable, samples in zip(links, cables, cables_samples, strict=True):
        assert samples.tobytes() == SAMPLES.tobytes()
        link.stop()
        cable.unplug()


def test_a_block_that_restarts_is_marked(cable: Cable, link: SerialLink) -> None:
    cable.write(b"".join(FRAMES[:100] + FRAMES[:20]))
    batches = collect(link, 120)
    assert link.counters.restarts == 1
    (row,) = [row for batch in batches for row in batch.restarts]
    assert samples_of([batch for batch in batches if batch.restarts])["sequence"][row] == 0


def test_starting_and_stopping_twice_does_no_harm_and_a_stopped_link_starts_again(cable: Cable) -> None:
    link = SerialLink(str(cable.path), NATIVE, timebase=Timebase(SPEED))
    link.stop()
    for number in range(2):
        link.start()
        link.start()
        until(lambda: open_link(link))
        cable.write(FRAMES[number])
        assert len(samples_of(collect(link, 1))) == 1
        link.stop()
        link.stop()
        assert link.state is LinkState.DISCONNECTED
        assert link.read(0.0) is None
