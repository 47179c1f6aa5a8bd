"""What every protocol promises alike: names, options, the same samples out as went in, gaps, restarts, conditions."""

from __future__ import annotations

import numpy as np
import pytest
from protocol_bench import CASES, Case, decode, frames_of, moving_samples

from drivers.protocols import get_protocol, option_names
from drivers.protocols.base import ProtocolError
from drivers.samples import Status, intervals_s

every_case = pytest.mark.parametrize("case", CASES, ids=str)
others = pytest.mark.parametrize("case", [case for case in CASES if case.name != "native"], ids=str)

STEPS = {
    "native": (2.0**-24, 2.0**-30),
    "kvh1750": (1e-6, 1e-7),
    "vectornav": (1e-6, 1e-7),
    "mip": (1e-6, 1e-7),
    "xsens": (1e-6, 1e-7),
    "hg4930": (2.0**-27 * 0.3048, 2.0**-33),
}


def steps_of(case: Case) -> tuple[float, float]:
    """Return the steps of velocity [m/s] and angle [rad] that a case's frames are rounded to."""
    if case.name == "stim300":
        rates = "gyro_output" not in case.options
        accel = 2.0**-19 * 9.80665 / case.rate_hz if rates else 2.0**-22
        gyro = np.deg2rad(2.0**-14) / case.rate_hz if rates else np.deg2rad(2.0**-21)
        return accel, float(gyro)
    if case.options.get("message") == "control":
        return 600 * 2.0**-14 * 0.3048 / 600, 600 * 2.0**-20 / 600
    return STEPS[case.name]


@every_case
def test_samples_arrive_as_sent_to_the_step_of_the_frame(case: Case) -> None:
    sent = moving_samples(500, case.rate_hz)
    batch, decoder = decode(case, frames_of(case, sent), lambda index: 1.0 + index / case.rate_hz)
    lost = len(sent) - len(batch.samples)  # an integrating output has no increment before its second frame
    assert lost == (1 if "integrated" in case.options.values() else 0)
    steps = dict(zip(("dv", "dtheta"), steps_of(case), strict=True))
    for column, step in steps.items():
        rounding = 1.01 * step if "integrated" in case.options.values() else 0.51 * step
        assert np.abs(batch.samples[column] - sent[column][lost:]).max() <= rounding
    assert np.abs(intervals_s(batch.samples) * case.rate_hz - 1).max() < 1e-6
    assert np.all(np.diff(batch.samples["sequence"].astype(np.int64)) == 1)
    assert (batch.gaps, batch.restarts, decoder.counters.decode_rejects) == ([], [], 0)


@every_case
@pytest.mark.parametrize("together", [1, 7, 500])
def test_samples_do_not_depend_on_how_frames_are_gathered(case: Case, together: int) -> None:
    frames = frames_of(case, moving_samples(200, case.rate_hz))
    one = decode(case, frames, lambda index: 1.0 + index / case.rate_hz, together=together)[0].samples
    other = decode(case, frames, lambda index: 1.0 + index / case.rate_hz)[0].samples
    assert len(one) == len(other)
    for column in ("time", "dv", "dtheta"):
        assert np.allclose(one[column], other[column], rtol=1e-6, atol=1e-12)


@every_case
def test_a_lost_frame_is_a_gap_and_spoils_no_sample_beside_it(case: Case) -> None:
    sent = moving_samples(300, case.rate_hz)
    frames = frames_of(case, sent)
    kept = [index for index in range(300) if index != 100]
    batch, _ = decode(case, [frames[index] for index in kept], lambda place: 1.0 + kept[place] / case.rate_hz)
    assert [gap.frames for gap in batch.gaps] == [1]
    rows = np.array(kept)[len(kept) - len(batch.samples) :]
    beside = rows != 101 if "integrated" in case.options.values() else rows >= 0  # there a gap's gain is shared
    assert np.abs(batch.samples["dtheta"] - sent["dtheta"][rows])[beside].max() <= 1.01 * steps_of(case)[1]
    assert np.allclose(np.diff(batch.samples["time"]), np.diff(sent["time"][rows]), rtol=1e-6)


@others
def test_a_frame_that_comes_twice_counts_once(case: Case) -> None:
    frames = frames_of(case, moving_samples(50, case.rate_hz))
    doubled = [*frames[:20], frames[19], *frames[20:]]
    batch, decoder = decode(case, doubled, lambda index: 1.0 + index / case.rate_hz)
    assert decoder.counters.duplicates == 1
    assert batch.gaps == []
    assert batch.restarts == []


@others
def test_a_long_loss_is_noticed_though_counters_wrap(case: Case) -> None:
    lost = round(3.0 * case.rate_hz) + 1  # three seconds, many times around the small counters
    sent = moving_samples(lost + 1200, case.rate_hz)
    frames = frames_of(case, sent)
    kept = [index for index in range(len(sent)) if not 600 <= index < 600 + lost]
    batch, _ = decode(case, [frames[index] for index in kept], lambda place: 1.0 + kept[place] / case.rate_hz)
    assert sum(gap.frames for gap in batch.gaps) == pytest.approx(lost, abs=1)
    assert batch.samples["time"][-1] - batch.samples["time"][0] == pytest.approx(len(sent) / case.rate_hz, rel=2e-3)


@others
def test_a_host_that_stalls_makes_no_gap(case: Case) -> None:
    frames = frames_of(case, moving_samples(2000, case.rate_hz))
    stalled = range(800, 800 + round(0.4 * case.rate_hz))  # read at once when the host is back

    def host_s(index: int) -> float:
        return 1.0 + (stalled.stop if index in stalled else index) / case.rate_hz

    batch, _ = decode(case, frames, host_s, together=1000)
    assert (batch.gaps, batch.restarts) == ([], [])


CLOCKED = [case for case in CASES if case.name in ("vectornav", "mip", "xsens") or case.options.get("format") == "B"]


@pytest.mark.parametrize("case", CLOCKED, ids=str)
def test_a_clock_that_begins_anew_is_a_restart(case: Case) -> None:
    frames = frames_of(case, moving_samples(2000, case.rate_hz))
    again = frames[1000:] + frames[:300]
    batch, _ = decode(case, again, lambda index: 1.0 + (index + 50 * (index >= 1000)) / case.rate_hz)
    assert batch.restarts == [1000]
    assert batch.samples["time"][1000] == pytest.approx(1 / case.rate_hz, abs=1e-4)


CLOCKS = {"vectornav": (2**64, 1e-9), "mip": (2**64, 1e-9), "xsens": (2**32, 1e-4), "kvh1750": (2**32, 1e-6)}


@pytest.mark.parametrize("case", [case for case in CLOCKED if CLOCKS[case.name][0] == 2**32], ids=str)
@pytest.mark.parametrize("lost", [0, 3000])
def test_a_clock_that_wraps_is_no_restart(case: Case, lost: int) -> None:
    """Microseconds of 32 bits wrap every 71 minutes; frames lost around the wrap change nothing."""
    modulus, tick_s = CLOCKS[case.name]
    sent = moving_samples(2000 + lost, case.rate_hz)
    sent["time"] += modulus * tick_s - 1000 / case.rate_hz
    kept = [index for index in range(len(sent)) if not 990 <= index < 990 + lost]
    frames = frames_of(case, sent)
    batch, _ = decode(case, [frames[index] for index in kept], lambda place: 1.0 + kept[place] / case.rate_hz)
    assert batch.restarts == []
    assert sum(gap.frames for gap in batch.gaps) == lost
    assert np.allclose(np.diff(batch.samples["time"]), np.diff(sent["time"][kept]), atol=2 * tick_s)


CARRIED = {
    "stim300": Status.START_UP | Status.OVERLOAD | Status.OUT_OF_RANGE | Status.INTEGRITY | Status.INVALID_GYRO_Y,
    "kvh1750": Status.INVALID_GYRO_X | Status.INVALID_ACCEL_Y | Status.INVALID_ACCEL_Z,
    "vectornav": Status.OVERLOAD,
    "xsens": Status.OVERLOAD | Status.SELF_TEST_FAILED,
    "hg4930": Status.START_UP | Status.SELF_TEST_FAILED | Status.INVALID_GYRO_Z,
}


@pytest.mark.parametrize("case", [case for case in CASES if case.name in CARRIED], ids=str)
def test_named_conditions_survive_every_device(case: Case) -> None:
    for flag in CARRIED[case.name]:
        sent = moving_samples(100, case.rate_hz)
        sent["status"] = flag
        batch, _ = decode(case, frames_of(case, sent), lambda index: 1.0 + index / case.rate_hz)
        told = batch.samples["status"] & ~np.uint32(Status.START_UP if flag != Status.START_UP else 0)
        assert np.all(told == flag)


def test_options_are_refused_by_name_with_those_that_there_are() -> None:
    with pytest.raises(ProtocolError, match=r"stim300 has no option wings; it knows accel_range_g, .*rate_hz"):
        get_protocol("stim300", wings=2)
    with pytest.raises(ProtocolError, match=r"accel_range_g=7 is not one of 5, 10, 30, 80"):
        get_protocol("stim300", accel_range_g=7)
    with pytest.raises(ProtocolError, match=r"native has no option wings; it has none"):
        get_protocol("native", wings=2)
    with pytest.raises(ProtocolError, match="rate_hz=fast is not a number above 0"):
        get_protocol("kvh1750", rate_hz="fast")
    with pytest.raises(ProtocolError, match="self_test_bit=maybe"):
        get_protocol("xsens", self_test_bit="maybe")


def test_options_may_come_as_text_from_a_command_line() -> None:
    assert get_protocol("stim300", accel_range_g="30", crlf="TRUE", rate_hz="2000").setting.accel_range_g == 30.0  # type: ignore[attr-defined]
    assert get_protocol("xsens", self_test_bit="no").self_test_bit is False  # type: ignore[attr-defined]
    assert option_names("novatel") == []
