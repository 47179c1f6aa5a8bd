"""The native frame: what is sent is what is received, and nothing else passes for a frame."""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from driver_bench import counting_samples
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.framing import Splitter
from drivers.messages import (
    GYRO_KINDS,
    Acknowledgement,
    Command,
    Compensation,
    Configuration,
    Identity,
    Message,
    Outcome,
    ReadCompensation,
    ReadConfiguration,
    ReadIdentity,
    SelfTest,
    SelfTestResult,
    SetRate,
    Start,
    Stop,
    WriteCompensation,
    terms_crc,
)
from drivers.protocols import ProtocolError, get_protocol, protocol_names
from drivers.protocols.base import Frame
from drivers.protocols.native import DATA_LENGTH, DTHETA_LSB_RAD, DV_LSB_MPS, SYNC, Native, encode_message
from drivers.samples import Status, empty_samples

NATIVE = get_protocol("native")
DOC = Path(__file__).resolve().parents[2] / "docs" / "native-protocol.md"

finite = st.floats(allow_nan=False, allow_infinity=False)
vectors = st.tuples(finite, finite, finite)
texts = st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=16)
single = st.floats(0, 1e6, width=32)
rates = st.integers(1, 2**32 - 1).map(lambda mhz: mhz / 1e3)
commands: st.SearchStrategy[Command] = st.one_of(
    st.sampled_from([Start(), Stop(), SelfTest(), ReadCompensation(), ReadIdentity(), ReadConfiguration()]),
    st.builds(SetRate, rates),
    st.builds(WriteCompensation, vectors, vectors),
)
messages: st.SearchStrategy[Message] = st.one_of(
    commands,
    st.builds(Identity, texts, texts, texts, st.sampled_from(GYRO_KINDS)),
    st.builds(Configuration, rates, st.integers(0, 2**32 - 1), single, single, st.booleans()),
    st.builds(SelfTestResult, st.integers(0, 2**14 - 1).map(Status)),
    st.builds(Acknowledgement, commands.map(lambda c: type(c).__name__), st.sampled_from(Outcome)),
    st.builds(Compensation, vectors, vectors, st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1)),
)


def through_the_line(data: bytes) -> list[Frame]:
    """Return the frames that the splitter finds."""
    return Splitter(NATIVE).feed(data, 1.0)


@settings(deadline=None)
@given(messages, st.integers(0, 2**32 - 1), st.integers(0, 2**50))
def test_every_message_arrives_as_sent(message: Message, sequence: int, time_us: int) -> None:
    data = NATIVE.encode_message(message, sequence, time_us / 1e6)
    received = NATIVE.decoder().decode(through_the_line(data)).messages
    assert [(one.message, one.sequence, one.time_s) for one in received] == [(message, sequence, time_us / 1e6)]


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(
            st.integers(0, 2**32 - 1),
            st.integers(0, 2**50),
            st.lists(st.integers(-(2**31), 2**31 - 1), min_size=6, max_size=6),
            st.lists(st.integers(-(2**15) + 1, 2**15 - 1), min_size=3, max_size=3),
            st.integers(0, 65534),
            st.integers(0, 2**32 - 1),
        ),
        max_size=20,
    )
)
def test_every_sample_on_the_frames_steps_arrives_exactly(rows: list[tuple[int, ...]]) -> None:
    samples = empty_samples(len(rows), 3)
    for sample, (sequence, time_us, increments, temperature, supply_mv, status) in zip(samples, rows, strict=True):
        sample["sequence"], sample["time"], sample["status"] = sequence, time_us / 1e6, status
        sample["dv"] = np.array(increments[:3]) * DV_LSB_MPS
        sample["dtheta"] = np.array(increments[3:]) * DTHETA_LSB_RAD
        sample["temperature"], sample["supply"] = np.array(temperature) / 256, supply_mv / 1e3
    decoded = NATIVE.decoder().decode(through_the_line(NATIVE.encode_samples(samples)))
    assert decoded.samples.tobytes() == samples.tobytes()


def test_increments_are_rounded_to_the_nearest_step() -> None:
    samples = counting_samples(1)
    samples["dv"], samples["dtheta"] = 0.4 * DV_LSB_MPS, 0.6 * DTHETA_LSB_RAD
    back = NATIVE.decoder().decode(through_the_line(NATIVE.encode_samples(samples))).samples
    assert np.all(back["dv"] == 0)
    assert np.all(back["dtheta"] == DTHETA_LSB_RAD)


def test_an_increment_beyond_its_field_is_limited_and_flagged() -> None:
    samples = counting_samples(2)
    samples["dv"][1, 2] = -200.0
    back = NATIVE.decoder().decode(through_the_line(NATIVE.encode_samples(samples))).samples
    assert back["dv"][1, 2] == -128.0
    assert back["status"].tolist() == [0, Status.OVERLOAD]


def test_unknown_temperatures_and_supply_stay_unknown() -> None:
    samples = empty_samples(1, 1)
    back = NATIVE.decoder().decode(through_the_line(NATIVE.encode_samples(samples))).samples
    assert np.isnan(back["temperature"]).all()
    assert np.isnan(back["supply"]).all()


@pytest.mark.parametrize("field", ["dv", "dtheta"])
def test_what_is_not_a_number_is_not_sent(field: str) -> None:
    samples = counting_samples(1)
    samples[field][0, 0] = np.nan
    with pytest.raises(ValueError, match="finite"):
        NATIVE.encode_samples(samples)


def test_samples_and_messages_keep_their_places_in_the_stream() -> None:
    samples = counting_samples(4)
    data = NATIVE.encode_samples(samples)
    mixed = data[:DATA_LENGTH] + encode_message(Start(), 7) + data[DATA_LENGTH:] + encode_message(Stop(), 8)
    frames = through_the_line(mixed)
    decoded = NATIVE.decoder().decode(frames)
    assert decoded.frame_of_sample.tolist() == [0, 2, 3, 4]
    assert [received.sequence for received in decoded.messages] == [7, 8]


def test_any_single_wrong_bit_is_noticed() -> None:
    frame = encode_message(SetRate(200.0), 3)
    for bit in range(8 * len(frame)):
        damaged = bytearray(frame)
        damaged[bit // 8] ^= 1 << bit % 8
        assert through_the_line(bytes(damaged)) == []


def test_sync_cannot_be_made_of_small_numbers_or_of_itself() -> None:
    assert not {0x00, 0xFF} & set(SYNC)
    assert not any(SYNC[:length] == SYNC[-length:] for length in range(1, len(SYNC)))


def test_terms_damaged_in_the_block_are_told_by_their_crc() -> None:
    f, g = (1e-3, 2e-3, 3e-3), (1e-6, 2e-6, 3e-6)
    assert Compensation(f, g, 1, terms_crc(f, g)).intact
    assert not Compensation((1e-3, 2e-3, 3.0000001e-3), g, 1, terms_crc(f, g)).intact


def test_whole_frames_with_impossible_content_are_rejected_and_counted() -> None:
    def forged(kind: int, payload: bytes) -> bytes:
        head = struct.pack("<4sBBHIQ", SYNC, 1, kind, 24 + len(payload), 1, 0)
        return head + payload + struct.pack("<I", zlib.crc32(head + payload))

    bad_outcome = forged(0x05, bytes([0x81, 99, 0, 0]))
    bad_gyro = forged(0x02, bytes(48) + bytes([200, 0, 0, 0]))
    bad_text = forged(0x02, b"\xff" * 16 + bytes(36))
    bad_terms_crc = forged(0x85, bytes(52)[:48] + b"\x01\x02\x03\x04")
    frames = through_the_line(bad_outcome + bad_gyro + bad_text + bad_terms_crc)
    decoded = NATIVE.decoder().decode(frames)
    assert (len(frames), decoded.rejects, decoded.messages) == (4, 4, [])


@pytest.mark.parametrize(
    "message",
    [Identity("a name far too long for it", "", ""), Identity("ö", "", ""), SetRate(-1.0), SetRate(1e9)],
)
def test_what_does_not_fit_a_frame_is_refused(message: Message) -> None:
    with pytest.raises(ProtocolError, match="does not fit"):
        encode_message(message)


def test_registry_knows_native_and_names_what_it_does_not_know() -> None:
    assert isinstance(get_protocol("native"), Native)
    assert "native" in protocol_names()
    with pytest.raises(ProtocolError, match=r"known are.*native"):
        get_protocol("stim9000")
    with pytest.raises(ProtocolError, match="wings"):
        get_protocol("native", wings=2)


def test_worked_example_of_the_documentation_decodes_to_what_it_says() -> None:
    text = DOC.read_text(encoding="utf-8")
    block = re.search(r"<!-- example -->\s*```\w*\n(.*?)```", text, re.DOTALL)
    assert block is not None
    frame = bytes.fromhex("".join(line.partition("#")[0] for line in block.group(1).splitlines()))
    (sample,) = NATIVE.decoder().decode(through_the_line(frame)).samples
    said = dict(re.findall(r"^\| (\w+) \| `([^`]*)` \|", text, re.MULTILINE))
    assert sample["sequence"] == int(said["sequence"])
    assert sample["time"] == float(said["time"])
    for name in ("dv", "dtheta", "temperature"):
        assert sample[name].tolist() == [float(number) for number in said[name].split(",")]
    assert sample["supply"] == np.float32(said["supply"])
    assert sample["status"] == int(said["status"])
    assert NATIVE.encode_samples(np.array([sample])) == frame
