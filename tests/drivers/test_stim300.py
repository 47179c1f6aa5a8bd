"""STIM300: every datagram, the device's own configuration, its outputs, and a real power-up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from protocol_bench import Case, decode, moving_samples, split

from drivers.capture import CaptureWriter, replay
from drivers.framing import Splitter
from drivers.messages import Configuration, Identity, SelfTestResult
from drivers.protocols import get_protocol
from drivers.protocols.base import ProtocolError
from drivers.protocols.checksums import crc32_mpeg2
from drivers.protocols.stim300 import CONTENTS, IDENTIFIERS, RANGES, SPECIALS
from drivers.samples import Status, intervals_s
from drivers.stream import StreamDecoder

TABLE = {  # the data sheet's, as docs/protocols.md repeats it: identifiers, length without CR LF, dummies
    (0x90,): (18, 2),
    (0x91,): (28, 0),
    (0x92,): (28, 0),
    (0x93,): (38, 2),
    (0x94,): (25, 3),
    (0xA5,): (42, 2),
    (0xA6,): (42, 2),
    (0xA7, 0x97): (59, 1),
    (0xF0, 0x98): (22, 2),
    (0xF1, 0x99): (32, 0),
    (0xF2, 0x9A): (32, 0),
    (0xF3, 0x9B): (42, 2),
    (0xF4, 0x9C): (29, 3),
    (0xF5, 0xAD): (46, 2),
    (0xF6, 0xAE): (46, 2),
    (0xF7, 0xAF): (63, 1),
    (0xB1, 0xB3): (20, 0),
    (0xB5, 0xB7): (20, 0),
    (0xBC, 0xBD): (26, 2),
    (0xD1, 0xD2): (40, 0),
    (0xBE, 0xBF): (21, 3),
}


def sealed(body: bytes, dummies: int, crlf: bool = False) -> bytes:
    """Return a datagram; the CRC is worked out bit by bit, apart from the code under test."""
    crc = 0xFFFFFFFF
    for byte in body + bytes(dummies):
        crc ^= byte << 24
        for _ in range(8):
            crc = (crc << 1 ^ 0x04C11DB7) & 0xFFFFFFFF if crc >> 31 else crc << 1
    return body + crc.to_bytes(4, "big") + b"\r\n" * crlf


def capture_bytes(path: Path) -> bytes:
    """Return the bytes of a hex capture with # lines."""
    return bytes.fromhex("".join(line for line in path.read_text().splitlines() if not line.startswith("#")))


def test_crc_has_the_published_check_value() -> None:
    assert crc32_mpeg2(b"123456789") == bytes.fromhex("0376e6e7")
    assert crc32_mpeg2(b"12345", 3) == crc32_mpeg2(b"12345\0\0\0")


@pytest.mark.parametrize("identifiers", TABLE)
@pytest.mark.parametrize("crlf", [False, True])
def test_every_datagram_of_the_table_is_told_with_and_without_crlf(identifiers: tuple[int, ...], crlf: bool) -> None:
    length, dummies = TABLE[identifiers]
    for identifier in identifiers:
        terminated = [special.terminated for special in SPECIALS]
        special = identifier in terminated or identifier in [special.plain for special in SPECIALS]
        if special and (identifier in terminated) != crlf:
            continue
        datagrams = [sealed(bytes([identifier, *[seed] * (length - 5)]), dummies, crlf) for seed in range(1, 6)]
        stream = b"junk" + b"".join(datagrams)
        for options in ({}, {"crlf": crlf}):
            found, counters = split(stream, get_protocol("stim300", **options))
            assert [frame.removeprefix(b"\r\n").removesuffix(b"\r\n") for frame in found] == [
                datagram[:length] for datagram in datagrams
            ]
            assert counters.bytes_discarded == len(b"junk") + 2 * (crlf and not options)


def test_the_table_and_nothing_else_is_known() -> None:
    known = {identifier for identifiers in TABLE for identifier in identifiers}
    assert set(CONTENTS) | {one for special in SPECIALS for one in special[:2]} == known
    assert set(IDENTIFIERS.values()) <= set(CONTENTS)


@pytest.mark.parametrize("datagram", IDENTIFIERS)
def test_what_a_datagram_does_not_hold_is_not_invented(datagram: str) -> None:
    case = Case("stim300", {"datagram": datagram}, 500.0, b"")
    sent = moving_samples(50, 500.0)
    data = case.protocol.encode_samples(sent)
    size = len(data) // 50
    batch, _ = decode(case, [data[place : place + size] for place in range(0, len(data), size)])
    samples = batch.samples
    assert np.abs(samples["dtheta"] - sent["dtheta"]).max() < 1e-8
    accel = Status.INVALID_ACCEL_X | Status.INVALID_ACCEL_Y | Status.INVALID_ACCEL_Z
    if "acc" in datagram:
        assert np.abs(samples["dv"] - sent["dv"]).max() < 1e-7
        assert not samples["status"].any()
    else:
        assert not samples["dv"].any()
        assert np.all(samples["status"] == accel)
    known = np.isfinite(samples["temperature"]).all(axis=0)
    expected = [("temp" in datagram)] * 3 + [("temp" in datagram and "acc" in datagram)] * 3
    assert known.tolist() == expected


@pytest.mark.parametrize("range_g", RANGES)
@pytest.mark.parametrize("output", ["rate", "incremental", "average", "integrated"])
def test_a_configuration_datagram_is_believed_over_the_options(range_g: float, output: str) -> None:
    sender = get_protocol(
        "stim300", accel_range_g=range_g, gyro_output=output, accel_output=output, rate_hz=250, datagram="rate+acc+temp"
    )
    sent = moving_samples(100, 250.0)
    told = Configuration(250.0, 460800, 0.0, 0.0, True)
    data = sender.encode_message(told) + sender.encode_samples(sent)
    decoder = StreamDecoder(get_protocol("stim300", accel_range_g=80 if range_g != 80 else 5))
    decoder.feed(data, 0.0)
    decoder.finish()
    batch = decoder.take()
    lost = 100 - len(batch.samples)
    assert lost == (output == "integrated")
    assert np.abs(batch.samples["dv"] - sent["dv"][lost:]).max() < 2e-5
    assert np.abs(batch.samples["dtheta"] - sent["dtheta"][lost:]).max() < 1e-6
    (message,) = [received.message for received in batch.messages]
    assert message == Configuration(
        250.0, 460800, pytest.approx(range_g * 9.80665), pytest.approx(6.98, abs=0.01), True
    )


def test_an_axis_that_is_switched_off_is_invalid() -> None:
    sender = get_protocol("stim300", rate_hz=500, crlf=False)
    configuration = bytearray(sender.encode_message(Configuration(500.0, 921600, 0.0, 0.0, True))[:22])
    configuration[5] = 0x60  # gyros X and Y
    data = sealed(bytes(configuration), 2) + sender.encode_samples(moving_samples(10, 500.0))
    decoder = StreamDecoder(get_protocol("stim300"))
    decoder.feed(data, 0.0)
    assert set(decoder.take().samples["status"].tolist()) == {int(Status.INVALID_GYRO_Z)}


def test_a_configuration_that_the_data_sheet_has_not_is_rejected() -> None:
    body = bytes([0xBC, 0x44, 1, 0xE0]) + bytes(18)
    decoder = StreamDecoder(get_protocol("stim300"))
    decoder.feed(sealed(body, 2), 0.0)
    batch = decoder.take()
    assert (batch.messages, decoder.counters.decode_rejects) == ([], 1)


def test_special_datagrams_are_messages() -> None:
    protocol = get_protocol("stim300")
    sent = [
        Identity("STIM300", "N25581234567890", ""),
        SelfTestResult(Status(0)),
        SelfTestResult(Status.SELF_TEST_FAILED),
    ]
    decoder = StreamDecoder(protocol)
    decoder.feed(b"".join(protocol.encode_message(message) for message in sent), 1.0)
    decoder.feed(sealed(bytes([0xD1]) + bytes(35), 0), 1.0)
    identity, *tests = [received.message for received in decoder.take().messages]
    assert isinstance(identity, Identity)
    assert (identity.model, identity.serial) == ("STIM300", "N25581234567890")
    assert tests == sent[1:]
    assert decoder.counters.decode_rejects == 0


@pytest.mark.parametrize("rate_hz", [125.0, 250.0, 500.0, 1000.0, 2000.0])
def test_counter_steps_tell_the_rate_of_a_bare_stream(rate_hz: float) -> None:
    case = Case("stim300", {}, rate_hz, b"")
    sent = moving_samples(600, rate_hz)
    data = get_protocol("stim300").encode_samples(sent)
    batch, _ = decode(case, [data[place : place + 61] for place in range(0, len(data), 61)], together=1)
    assert len(batch.samples) == 600
    assert batch.gaps == []
    assert np.allclose(intervals_s(batch.samples), 1 / rate_hz)
    assert np.abs(batch.samples["dv"] - sent["dv"]).max() < 3e-7


def test_a_rate_that_changes_is_followed() -> None:
    protocol = get_protocol("stim300")
    fast = protocol.encode_samples(moving_samples(64, 1000.0))
    slow = protocol.encode_samples(moving_samples(64, 250.0, first=16))
    data = fast + slow + fast
    batch, _ = decode(protocol, [data[place : place + 61] for place in range(0, len(data), 61)])
    interval_s = intervals_s(batch.samples)
    assert np.allclose(interval_s[20:60], 0.001)
    assert np.allclose(interval_s[90:120], 0.004)
    assert np.allclose(interval_s[140:190], 0.001)


def test_integrated_outputs_are_unwrapped() -> None:
    options = {"gyro_output": "integrated", "accel_output": "integrated", "accel_range_g": 5}
    case = Case("stim300", options, 2000.0, b"")
    sent = moving_samples(2000, 2000.0)
    sent["dtheta"][:, 0] = np.deg2rad(300.0) / 2000  # past ±4° 37 times in a second
    sent["dv"][:, 2] = 20.0 / 2000  # past ±1 m/s ten times
    data = case.protocol.encode_samples(sent)
    size = len(data) // 2000
    batch, _ = decode(case, [data[place : place + size] for place in range(0, len(data), size)])
    assert np.abs(batch.samples["dtheta"] - sent["dtheta"][1:]).max() < 2e-8
    assert np.abs(batch.samples["dv"] - sent["dv"][1:]).max() < 2e-7


def test_a_start_up_bit_set_anew_is_a_restart() -> None:
    case = Case("stim300", {}, 2000.0, b"")
    sent = moving_samples(600, 2000.0)
    sent["status"][300:350] = Status.START_UP
    data = case.protocol.encode_samples(sent)
    batch, _ = decode(case, [data[place : place + 61] for place in range(0, len(data), 61)])
    assert batch.restarts == [300]
    assert batch.samples["time"][300] == 0.0
    assert len(batch.samples) == 600


def test_a_channel_error_of_no_named_axis_is_one_of_all() -> None:
    body = bytearray(get_protocol("stim300", crlf=False, datagram="rate+acc").encode_samples(moving_samples(2, 2000.0)))
    frames = [bytes(body[:28]), bytes(body[28:])]
    spoiled = [sealed(frame[:10] + bytes([0x08]) + frame[11:24], 0) for frame in frames]
    batch, _ = decode(get_protocol("stim300"), spoiled)
    gyros = Status.INVALID_GYRO_X | Status.INVALID_GYRO_Y | Status.INVALID_GYRO_Z
    assert batch.samples["status"].tolist() == [gyros, gyros]


def test_a_rate_that_the_device_has_not_is_refused() -> None:
    with pytest.raises(ProtocolError, match=r"125, 250, 500, 1000 or 2000 Hz, not at 200 Hz"):
        get_protocol("stim300").encode_samples(moving_samples(10, 200.0))


def test_a_real_power_up_decodes_to_what_its_readme_says(shared_data: Path, tmp_path: Path) -> None:
    data = capture_bytes(shared_data / "captures" / "stim300_0x93_powerup_2000Hz_30g.hex")
    with_time = CaptureWriter(tmp_path / "a.cap")
    for place in range(0, len(data), 400):
        with_time.write(data[place : place + 400], 5.0 + (place + 400) / 80_000)
    with_time.close()
    decoder = StreamDecoder(get_protocol("stim300", accel_range_g=30))
    decoder.feed(data, 0.0)
    decoder.finish()
    timed = list(replay(tmp_path / "a.cap", get_protocol("stim300", accel_range_g="30")))
    for batches in ([decoder.take()], timed):
        samples = np.concatenate([batch.samples for batch in batches])
        assert len(samples) == 8392
        assert not any(batch.gaps or batch.restarts or batch.conditions for batch in batches)
        starting = np.flatnonzero(samples["status"] & Status.START_UP)
        assert starting.tolist() == list(range(562))
        assert samples["time"][562] == pytest.approx(0.281)
        unwell = samples["status"] & (Status.INTEGRITY | Status.OUT_OF_RANGE)
        assert np.flatnonzero(unwell).tolist() == list(range(39))
        assert samples["time"][39] == pytest.approx(0.0195)
        at_rest = np.linalg.norm(samples["dv"][3000:].mean(axis=0)) * 2000 / 9.80665  # moved by hand before
        assert at_rest == pytest.approx(1.00, abs=0.01)
    assert decoder.counters.frames == 8392
    assert decoder.counters.bytes_discarded == 28 + 2  # the cut datagram, and CR LF of the last whole one
    assert decoder.counters.crc_failures == 0


def test_the_edited_datagram_fails(shared_data: Path) -> None:
    data = capture_bytes(shared_data / "captures" / "stim300_0x93_bad_crc.hex")
    found, counters = split(data, get_protocol("stim300"))
    assert (found, counters.crc_failures) == ([], 1)


@pytest.mark.parametrize("crlf", ["auto", "true", "false"])
def test_a_replay_in_one_stretch_says_the_same_as_a_live_line(crlf: str) -> None:
    protocol = get_protocol("stim300", crlf=crlf)
    data = protocol.encode_samples(moving_samples(400, 2000.0)) + protocol.encode_message(SelfTestResult(Status(0)))
    data = data[:5000] + b"\r\n\r\n\x93" + data[5003:]
    live, whole = Splitter(protocol).feed(data, 1.0), Splitter(protocol)
    run = whole.feed_stretch(np.frombuffer(data, np.uint8), np.array([len(data)]), np.array([1.0]))
    one, other = protocol.decoder().decode(live), protocol.decoder().decode(run)
    assert len(one.samples) == 399
    assert one.samples.tobytes() == other.samples.tobytes()
    assert one.messages == other.messages
    assert len(one.messages) == 1
