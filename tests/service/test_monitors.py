"""What the sequencer watches in the samples, on made-up samples of known drift, noise and faults."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.samples import SampleArray, Status, empty_samples
from service.buffer import SampleBuffer, frames_lost
from service.monitors import DPH_RADPS, MG_MPS2, FlagMonitor, SettlingMonitor, StuckMonitor
from service.motion_watch import MotionWatch
from service.thinning import Thinner

RATE_HZ = 100.0
RANDOM = np.random.default_rng(7)


def same(found: SampleArray, wanted: SampleArray) -> bool:
    return found.dtype == wanted.dtype and found.tobytes() == wanted.tobytes()


def samples(seconds: float, start_s: float = 0.0, arw: float = 1e-6, vrw: float = 2e-4) -> SampleArray:
    """A block at rest with white noise: ``arw`` [rad/√s], ``vrw`` [m/s/√s]."""
    rows = empty_samples(round(seconds * RATE_HZ))
    rows["sequence"] = np.arange(1, len(rows) + 1) + round(start_s * RATE_HZ)
    rows["time"] = rows["sequence"] / RATE_HZ
    rows["dv"] = RANDOM.normal(0, vrw / np.sqrt(RATE_HZ), (len(rows), 3)) + np.array([0, 0, 9.8]) / RATE_HZ
    rows["dtheta"] = RANDOM.normal(0, arw / np.sqrt(RATE_HZ), (len(rows), 3))
    rows["temperature"] = 30.0
    return rows


def pieces(rows: SampleArray, length: int) -> list[SampleArray]:
    return [rows[start : start + length] for start in range(0, len(rows), length)]


# ------------------------------------------------------------------ settling


def settling() -> SettlingMonitor:
    return SettlingMonitor(60.0, 0.3, 0.05 * MG_MPS2, 0.3 * DPH_RADPS)


def test_a_block_that_does_not_drift_settles_after_one_window() -> None:
    monitor, found = settling(), []
    for piece in pieces(samples(70), 7):
        found.append((piece["time"][-1], monitor.feed(piece).settled))
    assert not any(settled for time_s, settled in found if time_s < 59.9)
    assert all(settled for time_s, settled in found if time_s > 65.1)


@pytest.mark.parametrize(
    ("channel", "per_minute", "named"),
    [
        ("temperature", 0.4, "temperature drifts +0.4 °C/min"),
        ("accel_y", 0.15 * MG_MPS2, "accel_y drifts +0.15 mg/min"),
        ("gyro_z", -1.0 * DPH_RADPS, "gyro_z drifts -1 deg/h/min"),
    ],
)
def test_a_drift_above_its_limit_is_seen_and_named(channel: str, per_minute: float, named: str) -> None:
    rows = samples(66, arw=1e-8, vrw=1e-5)
    minutes = rows["time"] / 60
    if channel == "temperature":
        rows["temperature"] += (per_minute * minutes)[:, None].astype(np.float32)
    elif channel == "accel_y":
        rows["dv"][:, 1] += per_minute * minutes / RATE_HZ
    else:
        rows["dtheta"][:, 2] += per_minute * minutes / RATE_HZ
    found = settling().feed(rows)
    assert not found.settled
    value = float(named.split()[2])
    assert found.text.split(" drifts ")[0] == named.split(" drifts ")[0]
    assert float(found.text.split()[2]) == pytest.approx(value, rel=0.03)


def test_noise_alone_does_not_keep_a_coarse_block_from_settling() -> None:
    """A MEMS gyro of 0.15 deg/√h drifts by 4 deg/h/min (1σ) by its noise alone; 3σ are allowed. 20 blocks, at most 2
    held up: each of seven slopes is t-distributed with 10 degrees of freedom, P(|t| > 3) = 1.3 %."""
    arw = np.radians(0.15) / 60
    settled = sum(settling().feed(samples(66, arw=arw)).settled for _ in range(20))
    assert settled >= 15


def test_how_batches_are_cut_changes_nothing() -> None:
    rows = samples(66)
    rows["temperature"] += (0.2 * rows["time"] / 60)[:, None].astype(np.float32)
    whole = settling().feed(rows)
    monitor = settling()
    for piece in pieces(rows, 13):
        cut = monitor.feed(piece)
    assert cut.settled == whole.settled
    assert cut.text == whole.text


# ------------------------------------------------------------------ stuck, flags


@pytest.mark.parametrize("length", [1, 7, 1000])
@pytest.mark.parametrize("channel", range(6))
def test_a_stuck_channel_is_found_however_batches_are_cut(channel: int, length: int) -> None:
    rows = samples(10)
    target = rows["dv"] if channel < 3 else rows["dtheta"]
    target[500:, channel % 3] = target[499, channel % 3]
    monitor = StuckMonitor(2.0)
    found = [(float(piece["time"][-1]), monitor.feed(piece)) for piece in pieces(rows, length)]
    name = ["accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z"][channel]
    assert found[-1][1] == [name]
    assert all(not stuck for time_s, stuck in found if time_s < 6.99)


def test_a_value_that_repeats_now_and_then_is_not_stuck() -> None:
    rows = samples(20)
    rows["dtheta"] = np.round(rows["dtheta"] / 3e-7) * 3e-7  # coarse steps: most values repeat
    monitor = StuckMonitor(2.0)
    assert not any(monitor.feed(piece) for piece in pieces(rows, 10))


def test_a_flag_counts_only_when_it_lasts() -> None:
    rows = samples(3)
    rows["status"][50:60] = int(Status.INVALID_GYRO_X)
    rows["status"][200:] = int(Status.INVALID_ACCEL_Z | Status.SELF_TEST_FAILED)
    monitor = FlagMonitor(0.5)
    found = [(piece["time"][-1], monitor.feed(piece)) for piece in pieces(rows, 5)]
    assert all(not flags for time_s, flags in found if time_s < 2.49)
    assert found[-1][1] == ["SELF_TEST_FAILED", "INVALID_ACCEL_Z"]


# ------------------------------------------------------------------ motion, buffer, thinning


def test_motion_is_seen_live_and_rest_is_not() -> None:
    watch = MotionWatch()
    still = [watch.feed(piece) for piece in pieces(samples(120), 10)]
    assert all(still)
    moving = samples(3, start_s=120.0)
    moving["dtheta"][:, 1] += np.radians(1.0) / RATE_HZ
    assert not all(watch.feed(piece) for piece in pieces(moving, 10))


def test_a_gap_in_what_noise_is_learnt_from_only_takes_longer() -> None:
    watch = MotionWatch()
    early, late = samples(9), samples(60, start_s=40.0)
    assert all(watch.feed(piece) for piece in pieces(np.concatenate([early, late]), 10))


def test_views_of_the_buffer_stay_as_they_were() -> None:
    buffer, rows = SampleBuffer(), samples(400)
    buffer.append(rows[:100])
    view = buffer.rows()
    for piece in pieces(rows[100:], 999):
        buffer.append(piece)
    assert len(buffer) == len(rows)
    assert same(view, rows[:100])
    assert same(buffer.rows(), rows)
    np.testing.assert_array_equal(buffer.span(1.0, 2.0)["time"], rows["time"][99:199])
    buffer.clear()
    buffer.append(rows[200:300])
    assert same(view, rows[:100])


def test_frames_lost_are_counted_across_the_wrap_of_the_counter() -> None:
    rows = samples(10)
    rows["sequence"] += np.uint32(2**32 - 500)
    assert frames_lost(rows) == 0
    assert frames_lost(np.delete(rows, [3, 4, 498, 501, 700])) == 5


def test_thinned_samples_keep_their_peaks() -> None:
    thinner, rows = Thinner(1.0), samples(1.2)
    rows["dv"][40, 0] = 1.0
    facts = next(found for piece in pieces(rows, 5) if (found := thinner.feed(piece)) is not None)
    assert facts["accel_mps2"]["high"][0] == pytest.approx(100.0)
    assert facts["accel_mps2"]["mean"][2] == pytest.approx(9.8, abs=0.01)
    assert facts["frames"] == pytest.approx(105, abs=5)
