"""What is particular to each maker's frames: known answers, layouts, bits, real captures."""

from __future__ import annotations

import struct
from binascii import crc_hqx
from pathlib import Path

import numpy as np
import pytest
from protocol_bench import Case, decode, frames_of, moving_samples, split

from drivers.messages import SelfTestResult
from drivers.protocols import get_protocol
from drivers.protocols.base import NOT_A_FRAME, ProtocolError
from drivers.protocols.checksums import crc32_mpeg2, fletcher16
from drivers.protocols.readings import GYRO_INVALID
from drivers.protocols.vectornav import COMMON_SIZES, IMU_SIZES
from drivers.samples import SampleArray, Status, intervals_s
from drivers.stream import StreamDecoder

G = 9.80665


def captured(folder: Path, name: str) -> list[bytes]:
    """Return the lines of a hex capture."""
    lines = (folder / "captures" / name).read_text().splitlines()
    return [bytes.fromhex(line) for line in lines if line and not line.startswith("#")]


def sampled(frames: list[bytes], name: str, **options: object) -> SampleArray:
    """Return the samples of frames that come 10 ms apart."""
    return decode(get_protocol(name, **options), frames, lambda index: 1.0 + 0.01 * index)[0].samples


# ------------------------------------------------------------------ KVH


def kvh_a(status: int = 0x77, sequence: int = 0, rotation: float = 0.5) -> bytes:
    body = bytes.fromhex("fe81ff55") + struct.pack(">6fBBh", rotation, 0, 0, 0, 0, 1.0, status, sequence, 31)
    return body + crc32_mpeg2(body)


def test_kvh_bits_name_the_axes_that_are_not_valid() -> None:
    samples = sampled([kvh_a(status, number) for number, status in enumerate((0x77, 0x76, 0x37, 0x00))], "kvh1750")
    wanted = [
        Status(0),
        Status.INVALID_GYRO_X,
        Status.INVALID_ACCEL_Z,
        sum(flag for flag in Status if flag.name and flag.name.startswith("INVALID")),
    ]
    assert (samples["status"] & ~np.uint32(Status.START_UP)).tolist() == wanted
    assert np.all(samples["temperature"] == 31)


def test_kvh_units_are_options() -> None:
    frames = [kvh_a(sequence=number) for number in range(10)]
    rates = sampled(frames, "kvh1750", rate_hz=100)
    increments = sampled(frames, "kvh1750", gyro_output="incremental", accel_output="incremental", angle_unit="deg")
    assert rates["dtheta"][5, 0] == pytest.approx(0.005)
    assert rates["dv"][5, 2] == pytest.approx(0.01 * G)
    assert increments["dtheta"][5, 0] == pytest.approx(np.deg2rad(0.5))
    assert increments["dv"][5, 2] == pytest.approx(1.0)


@pytest.mark.parametrize("passed", [True, False])
def test_kvh_self_test_frames_are_results(passed: bool) -> None:
    protocol = get_protocol("kvh1750")
    result = SelfTestResult(Status(0) if passed else Status.SELF_TEST_FAILED)
    decoder = StreamDecoder(protocol)
    decoder.feed(kvh_a() + protocol.encode_message(result), 0.0)
    assert [received.message for received in decoder.take().messages] == [result]


@pytest.mark.parametrize("form", ["A", "B", "C"])
def test_kvh_true_rate_is_measured_where_another_is_nominal(form: str) -> None:
    """Users measured 962.4 Hz where 1000 was nominal."""
    true_hz, count = 962.4, 20_000
    case = Case("kvh1750", {"format": form, "rate_hz": 1000}, true_hz, b"")
    sent = moving_samples(count, true_hz)
    rng = np.random.default_rng(3)
    # Reads every 4 ms, each up to 1 ms late.
    reads = np.ceil((np.arange(count) + 1) / true_hz / 0.004) * 0.004
    late = reads + rng.uniform(0, 0.001, 10**6)[np.rint(reads / 0.004).astype(int)]
    batch, decoder = decode(case, frames_of(case, sent), lambda index: float(late[index]), together=200)
    settled = batch.samples[5000:]
    assert 1 / intervals_s(settled).mean() == pytest.approx(true_hz, rel=5e-4)
    assert batch.conditions == Status.WRONG_RATE
    assert decoder.rate_check.discrepancy == pytest.approx(1000 / true_hz - 1, abs=1e-3)
    assert np.median(np.abs(settled["dtheta"] / sent["dtheta"][5000:] - 1)) < 5e-4
    assert not np.any(settled["status"])


def test_kvh_rate_is_start_up_until_it_is_measured() -> None:
    case = Case("kvh1750", {}, 500.0, b"")
    batch, _ = decode(case, frames_of(case, moving_samples(3000, 500.0)), lambda index: 1.0 + index / 500, together=20)
    starting = np.flatnonzero(batch.samples["status"] & Status.START_UP)
    assert 900 < len(starting) < 1400  # two seconds and a little
    assert starting[-1] + 1 == len(starting)
    assert not batch.conditions


def test_a_bare_stream_without_clock_takes_the_stated_rate() -> None:
    case = Case("kvh1750", {"rate_hz": 250}, 250.0, b"")
    batch, _ = decode(case, frames_of(case, moving_samples(100, 250.0)))
    assert np.allclose(intervals_s(batch.samples), 0.004)
    assert not batch.samples["status"].any()
    assert not batch.conditions


# ------------------------------------------------------------------ VectorNav


def vectornav(masks: dict[int, int], payload: bytes) -> bytes:
    groups = sum(1 << group for group in masks)
    body = bytes([0xFA, groups]) + b"".join(mask.to_bytes(2, "little") for mask in masks.values()) + payload
    return body + crc_hqx(body[1:], 0).to_bytes(2, "big")


@pytest.mark.parametrize(
    ("group", "bit"), [*((0, bit) for bit in range(15)), *((2, bit) for bit in range(13))], ids=str
)
def test_vectornav_length_is_the_sum_of_the_fields_that_masks_name(group: int, bit: int) -> None:
    size = (COMMON_SIZES if group == 0 else IMU_SIZES)[bit]
    frame = vectornav({group: 1 << bit}, bytes(range(size)))
    both = vectornav({0: 0x7FFF, 2: 0x1FFF}, bytes(sum(COMMON_SIZES) + sum(IMU_SIZES)))
    found, counters = split(frame + both + frame, get_protocol("vectornav"))
    assert found == [frame, both, frame]
    assert counters.bytes_discarded == 0


@pytest.mark.parametrize("head", ["fa0201008000", "fa8101010000", "fa0000000000", "fa0400200000", "fa0100000000"])
def test_vectornav_groups_of_unknown_size_are_refused_before_anyone_waits(head: str) -> None:
    assert get_protocol("vectornav").measure(bytes.fromhex(head), 0, 6) == NOT_A_FRAME


def test_vectornav_common_group_increments_are_read() -> None:
    frames = []
    for number in range(5):
        time_ns = 10**9 + number * 10**7
        delta = struct.pack("<7f", 0.01, 0.5, -0.25, 0.125, 0.098, 0.0, -0.01)
        status = struct.pack("<H", 0x10 if number == 3 else 0)
        frames.append(vectornav({0: 1 | 1 << 11 | 1 << 12}, struct.pack("<Q", time_ns) + delta + status))
    samples = sampled(frames, "vectornav")
    assert np.allclose(samples["dtheta"], np.deg2rad([0.5, -0.25, 0.125]))
    assert np.allclose(samples["dv"], [0.098, 0.0, -0.01])
    assert np.allclose(samples["time"], 1 + 0.01 * np.arange(5))
    assert samples["status"].tolist() == [0, 0, 0, int(Status.INTEGRITY), 0]


def test_vectornav_messages_of_other_content_between_are_passed_over() -> None:
    frames = frames_of(Case("vectornav", {}, 100.0, b""), moving_samples(40, 100.0))
    attitude = vectornav({0: 1 << 3}, bytes(12))
    mixed = [one for frame in frames for one in (frame, attitude)]
    batch, decoder = decode(get_protocol("vectornav"), mixed, lambda index: 1.0 + index / 200)
    assert len(batch.samples) == 40
    assert decoder.counters.decode_rejects == 40


def test_vectornav_saturation_is_overload() -> None:
    quiet = struct.pack("<Q", 0) + struct.pack("<6f", *[0.1] * 6)
    masks = {0: 1, 2: 1 << 9 | 1 << 10 | 1 << 11}
    frames = [
        vectornav(masks, struct.pack("<Q", 10**7 * number) + quiet[8:] + struct.pack("<H", bits))
        for number, bits in enumerate((0, 0x0007, 0x0008, 0x0100))
    ]
    overloaded = [0, 0, int(Status.OVERLOAD), int(Status.OVERLOAD)]  # a magnetometer's saturation is none
    assert sampled(frames, "vectornav")["status"].tolist() == overloaded


# ------------------------------------------------------------------ MIP


def test_mip_known_answers(shared_data: Path) -> None:
    ping, imu, accelerations, *commands = captured(shared_data, "mip_known_answers.hex")
    later = bytearray(imu)
    place = later.index(bytes([10, 0xD5])) + 2
    later[place : place + 8] = (23_067_000_000 + 10_000_000).to_bytes(8, "big")
    later[-2:] = fletcher16(later[:-2])
    found, counters = split(b"".join([ping, imu, accelerations, *commands]), get_protocol("mip"))
    assert found == [ping, imu, accelerations, *commands]
    assert counters.bytes_discarded == 0
    samples = sampled([ping, imu, bytes(later), accelerations, *commands], "mip", message="rate")
    assert len(samples) == 2
    assert samples["time"].tolist() == pytest.approx([23.067, 23.077])
    assert np.allclose(samples["dv"] / 0.01 / G, [0.077592, 0.000061, -0.979233], atol=1e-6)
    assert np.allclose(samples["dtheta"] / 0.01, [-0.002138, -0.003283, -0.005192], atol=1e-6)


def test_mip_increments_go_before_rates_where_a_packet_holds_both() -> None:
    packets = []
    for number in range(3):
        fields = struct.pack(">BBQ", 10, 0xD5, 10**7 * number)
        for kind, values in ((4, (9, 9, 9)), (5, (9, 9, 9)), (7, (1e-3, 2e-3, 3e-3)), (8, (0.01, 0.02, 0.03))):
            fields += struct.pack(">BB3f", 14, kind, *values)
        packet = bytes([0x75, 0x65, 0x80, len(fields)]) + fields
        packets.append(packet + fletcher16(packet))
    samples = sampled(packets, "mip")
    assert np.allclose(samples["dtheta"], [1e-3, 2e-3, 3e-3])
    assert np.allclose(samples["dv"], np.array([0.01, 0.02, 0.03]) * G)


def test_mip_headers_whose_fields_do_not_fit_are_refused_at_once() -> None:
    protocol = get_protocol("mip")
    for head in (b"\x75\x65\x80\xff\x01\x04", b"\x75\x65\x80\x0a\x0e\x04", b"\x75\x65\x80\x01", b"\x75\x65\x80\x00"):
        assert protocol.measure(head, 0, len(head)) == NOT_A_FRAME


# ------------------------------------------------------------------ Xsens


def xsens(*fields: tuple[int, bytes]) -> bytes:
    data = b"".join(kind.to_bytes(2, "big") + bytes([len(body)]) + body for kind, body in fields)
    length = bytes([len(data)]) if len(data) < 255 else b"\xff" + len(data).to_bytes(2, "big")
    body = b"\xfa\xff\x36" + length + data
    return body + bytes([-sum(body[1:]) & 0xFF])


def test_xsens_real_capture(shared_data: Path) -> None:
    frames = captured(shared_data, "xsens_mtdata2_set1.hex")
    found, counters = split(b"".join(frames), get_protocol("xsens"))
    assert found == frames
    assert (len(found), counters.crc_failures) == (100, 0)
    batch, decoder = decode(get_protocol("xsens"), frames)
    assert batch.gaps == []  # the four messages of a satellite receiver count too
    assert (len(batch.samples), decoder.counters.decode_rejects) == (96, 4)
    assert np.allclose(intervals_s(batch.samples), 0.01)
    assert np.linalg.norm(batch.samples["dv"][1:].mean(axis=0)) * 100 == pytest.approx(9.8, abs=0.05)
    # The device sends both: its quaternion increments and its rates must agree, as must velocity and acceleration.
    rates, _ = decode(get_protocol("xsens", message="rate"), frames)
    assert np.abs(rates.samples["dtheta"] - batch.samples["dtheta"])[1:].max() < 5e-6
    assert np.abs(rates.samples["dv"] - batch.samples["dv"])[1:].max() < 2e-3


NUMBERS = {
    0: lambda value: struct.pack(">f", value),
    1: lambda value: struct.pack(">i", round(value * 2**20)),
    2: lambda value: struct.pack(">Ih", round(value * 2**32) & 0xFFFFFFFF, round(value * 2**32) >> 32),
    3: lambda value: struct.pack(">d", value),
}


@pytest.mark.parametrize("form", NUMBERS)
@pytest.mark.parametrize("axes", [0x0, 0x4, 0x8])
def test_xsens_numbers_are_read_in_every_format(form: int, axes: int) -> None:
    low, pack = form | axes, NUMBERS[form]
    frames = [
        xsens(
            (0x1020, struct.pack(">H", number % 65536)),
            (0x1060, struct.pack(">I", 100 * number)),
            (0x0810 | low, pack(-12.5)),
            (0x4020 | low, pack(-9.75) + pack(0.0) + pack(3.0625)),
            (0x8020 | low, pack(-0.125) + pack(0.25) + pack(1.0)),
        )
        for number in range(65530, 65546)
    ]
    samples = sampled(frames, "xsens")
    assert np.allclose(samples["dv"][1:5], np.array([-9.75, 0.0, 3.0625]) * 0.01, rtol=1e-6)
    assert np.allclose(samples["dtheta"][1:5], np.array([-0.125, 0.25, 1.0]) * 0.01, rtol=1e-6)
    assert np.all(samples["temperature"] == -12.5)


def test_xsens_status_word_names_conditions() -> None:
    def frame(number: int, word: int) -> bytes:
        inertial = ((0x4010, struct.pack(">3f", 0, 0, 0.1)), (0x8030, struct.pack(">4f", 1, 0, 0, 0)))
        counted = ((0x1020, struct.pack(">H", number)), (0x1060, struct.pack(">I", 100 * number)))
        return xsens(*counted, *inertial, (0xE020, struct.pack(">I", word)))

    frames = [frame(number, word) for number, word in enumerate((1, 0, 1 | 1 << 8, 1 | 1 << 13, 1 | 1 << 14))]
    failed, overload = int(Status.SELF_TEST_FAILED), int(Status.OVERLOAD)
    assert sampled(frames, "xsens")["status"].tolist() == [0, failed, overload, overload, 0]
    assert sampled(frames, "xsens", self_test_bit=False)["status"].tolist() == [0, 0, overload, overload, 0]


def test_xsens_extended_length_and_impossible_fields() -> None:
    long = xsens(*((0x5000 | number << 4, bytes(60)) for number in range(5)))
    twice = xsens((0x1020, b"\0\1"), (0x1020, b"\0\2"))
    wrong_size = xsens((0x4020, bytes(11)))
    found, counters = split(long + twice + wrong_size + long, get_protocol("xsens"))
    assert found == [long, long]
    assert counters.bytes_discarded == len(twice) + len(wrong_size)


# ------------------------------------------------------------------ HG4930


def hg(kind: int, slot: int, status: int = 0, word2: int = 0, fill: int | None = None) -> bytes:
    """Return a message of a healthy unit, but for the bits of ``status`` that are wrong in word 1."""
    sensors = [fill] * 6 if fill is not None else [1000, -2000, 3000, 100, -200, 300]
    body = struct.pack("<BB6hHH", 0x0E, kind, *sensors, status ^ 0x0700 | slot % 4, word2)
    if kind == 2:
        wide = [fill << 16 | fill] * 6 if fill is not None else [2**20, -(2**21), 2**22, 2**16, -(2**17), 2**18]
        body += struct.pack("<6i", *wide)
    words = struct.unpack(f"<{len(body) // 2}H", body)
    return body + struct.pack("<H", sum(words) & 0xFFFF)


def hg_stream(slots: int, **options: int) -> list[bytes]:
    """Return control messages with an inertial one in every sixth slot, as the unit sends them."""
    return [hg(2 if slot % 6 == 5 else 1, slot, **options) for slot in range(slots)]


def test_hg4930_scales() -> None:
    frames = hg_stream(600)
    inertial = sampled(frames, "hg4930")
    assert len(inertial) == 100
    assert np.allclose(inertial["dtheta"], np.array([2**20, -(2**21), 2**22]) * 2.0**-33)
    assert np.allclose(inertial["dv"], np.array([2**16, -(2**17), 2**18]) * 2.0**-27 * 0.3048)
    assert np.allclose(intervals_s(inertial), 0.01)
    control = decode(get_protocol("hg4930", message="control"), frames, lambda index: 1 + index / 600)[0].samples
    assert len(control) == 600
    assert np.allclose(control["dtheta"] * 600, np.array([1000, -2000, 3000]) * 600 * 2.0**-20)
    assert np.allclose(control["dv"] * 600, np.array([100, -200, 300]) * 600 * 2.0**-14 * 0.3048)


@pytest.mark.parametrize("message", ["inertial", "control"])
def test_hg4930_power_up_pattern_is_start_up_and_no_reading(message: str) -> None:
    frames = [hg(2 if slot % 6 == 5 else 1, slot, fill=0x5555 if slot < 240 else None) for slot in range(600)]
    samples = decode(get_protocol("hg4930", message=message), frames, lambda index: 1 + index / 600)[0].samples
    starting = (samples["status"] & Status.START_UP) != 0
    assert starting.sum() == (40 if message == "inertial" else 240)
    assert starting[: starting.sum()].all()
    assert not samples["dv"][starting].any()
    assert samples["dv"][~starting].any(axis=1).all()


def test_hg4930_status_bits_and_temperature() -> None:
    """Bits 8 to 10 of word 1 say which gyros are valid; 4 to 7 and 15, and in word 2 all but 9, what has failed."""
    words = [(0, 0), (0x10, 0), (0x200, 0), (0x8000, 0), (0, 0x4000), (0, 0x0200), (0x700, 0)]
    frames = [hg(2, 6 * number, one, word2=two | 0x80F0) for number, (one, two) in enumerate(words)]
    samples = sampled(frames, "hg4930")
    failed, gyros = int(Status.SELF_TEST_FAILED), int(GYRO_INVALID)
    assert samples["status"].tolist() == [0, failed, int(Status.INVALID_GYRO_Y), failed, failed, 0, gyros]
    assert np.all(samples["temperature"] == -16)


# ------------------------------------------------------------------ NovAtel


def test_novatel_frames_and_the_hardest_public_resynchronisation_case(shared_data: Path) -> None:
    protocol = get_protocol("novatel")
    whole = captured(shared_data, "novatel_rawimusx.hex")
    assert split(b"".join(whole), protocol)[0] == whole
    stream = b"".join(captured(shared_data, "novatel_resync_trick.hex"))
    found, counters = split(stream, protocol)
    (frame,) = found
    start = stream.index(frame)
    unknown = [stream[0:3], stream[3:13], stream[13:start]]
    assert [len(part) for part in unknown] == [3, 10, 1]
    assert unknown[0] == b"\xaa\x44\x13"
    assert unknown[1].startswith(b"\xaa\x44\x13")
    assert unknown[2] == b"\xaa"
    assert len(frame) == 56
    assert set(stream[start + 56 :]) == {0xFF}
    assert counters.bytes_discarded == len(stream) - 56


def test_novatel_only_splits() -> None:
    protocol = get_protocol("novatel")
    with pytest.raises(ProtocolError, match="only splits"):
        protocol.encode_samples(moving_samples(1, 100.0))
