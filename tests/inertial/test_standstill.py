"""Stillness: real blocks of two grades, slews and knocks in time, no false alarm, the same by chunk."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray

from inertial.documents import ChannelNoise, Noise
from inertial.increments import Increments
from inertial.standstill import Disturbance, StillnessDetector, first_disturbance, learn_noise, still_spans

Array = NDArray[np.float64]
RATE_HZ = 100
INTERVAL = 1.0 / RATE_HZ
ARW = math.radians(0.01) / 60.0
VRW = 20e-6 * 9.80665
DEG_H = math.radians(1.0) / 3600.0
LAB = Noise(
    **{f"accel_{a}": ChannelNoise(white=VRW, quantisation=2.0**-24) for a in "xyz"},
    **{f"gyro_{a}": ChannelNoise(white=ARW, flicker=0.02 * DEG_H, quantisation=2.0**-30) for a in "xyz"},
)


def rest(duration_s: float, seed: int) -> tuple[Array, Array, Array, Array]:
    """Time, dv, dtheta, interval of a good block at rest with shifts of 2.4 deg/h and 0.3 mg."""
    rng = np.random.default_rng(seed)
    count = round(duration_s * RATE_HZ)
    dv = rng.normal(size=(count, 3)) * VRW * math.sqrt(INTERVAL) + np.array([3e-3, -3e-3, 9.8]) * INTERVAL
    dtheta = rng.normal(size=(count, 3)) * ARW * math.sqrt(INTERVAL) + np.array([1.0, 12.0, -8.0]) * DEG_H * INTERVAL
    dv, dtheta = (
        np.diff(np.rint(np.cumsum(x, 0) / q) * q, axis=0, prepend=0) for x, q in ((dv, 2.0**-24), (dtheta, 2.0**-30))
    )
    return np.arange(1, count + 1) * INTERVAL, dv, dtheta, np.full(count, INTERVAL)


def ring_laser(shared_data: Path, name: str) -> tuple[Array, Array, Array, Array]:
    table = pq.read_table(shared_data / "recordings" / f"rlg_vehicle_{name}.parquet")
    time = table["time_s"].to_numpy()
    dv, dtheta = (
        np.column_stack([table[f"{kind}_{axis}_{unit}"].to_numpy() for axis in "xyz"])
        for kind, unit in (("dv", "mps"), ("dtheta", "rad"))
    )
    return time, dv, dtheta, np.full(len(time), INTERVAL)


def watch(rows: tuple[Array, Array, Array, Array], noise: Noise = LAB) -> list[Disturbance]:
    return StillnessDetector(noise).feed(*rows)


def test_two_hours_of_rest_with_warm_up_raise_no_alarm() -> None:
    rows = rest(7200.0, 1)
    rows[2][:, 0] += 5.0 * DEG_H * np.exp(-rows[0] / 300.0) * INTERVAL
    rows[1][:, 2] += 0.01 * np.exp(-rows[0] / 300.0) * INTERVAL
    detector = StillnessDetector(LAB)
    assert detector.feed(*rows) == []
    assert detector.still_for_s == pytest.approx(7200.0, abs=0.2)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("standing_s", [5.0, 60.0])
def test_slew_of_the_launcher_is_noticed_within_about_a_second(axis: int, standing_s: float) -> None:
    rows = rest(standing_s + 10.0, 2 + axis)
    rows[2][round(standing_s * RATE_HZ) :, axis] += math.radians(0.05) * INTERVAL
    found = watch(rows)
    assert standing_s < found[0].time_s < standing_s + 1.3
    assert found[0].channel == f"gyro_{'xyz'[axis]}"
    assert found[-1].time_s > standing_s + 9.0, "a steady slew must not come to count as rest"


def test_slew_under_way_from_the_first_sample_is_not_rest() -> None:
    rows = rest(30.0, 5)
    rows[2][:, 2] += math.radians(0.05) * INTERVAL
    detector = StillnessDetector(LAB)
    assert len(detector.feed(*rows)) > 20
    assert detector.still_for_s < 1.5


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_knock_is_noticed_at_once(axis: int) -> None:
    rows = rest(30.0, 8)
    rows[1][2000:2003, axis] += 0.02  # there
    rows[1][2003:2006, axis] -= 0.02  # and back again
    found = watch(rows)
    assert 20.0 < found[0].time_s < 20.3
    assert found[0].channel == f"accel_{'xyz'[axis]}"


def test_still_again_after_the_slew() -> None:
    rows = rest(60.0, 9)
    rows[2][2000:3000, 1] += math.radians(0.2) * INTERVAL
    detector = StillnessDetector(LAB)
    detector.feed(*rows)
    assert detector.still_for_s == pytest.approx(30.0, abs=0.3)
    spans = still_spans(*rows, LAB)
    assert spans[0][0] == pytest.approx(0.0, abs=1e-9)
    assert spans[0][1] < 20.0
    assert 30.0 < spans[-1][0] < 33.0
    assert spans[-1][1] == pytest.approx(60.0)


def test_chunks_change_nothing() -> None:
    rows = rest(60.0, 10)
    rows[2][3000:3200, 1] += math.radians(0.3) * INTERVAL
    whole, detector = watch(rows), StillnessDetector(LAB)
    cuts = np.sort(np.random.default_rng(1).integers(0, 6000, 40))
    pieces = [detector.feed(*part) for part in zip(*(np.split(column, cuts) for column in rows), strict=True)]
    assert [d for piece in pieces for d in piece] == whole
    assert whole


def test_quiet_ring_laser_block_stands(shared_data: Path) -> None:
    rows = ring_laser(shared_data, "quiet")
    noise = learn_noise(*rows[1:])
    assert watch(rows, noise) == []
    assert still_spans(*rows, noise) == [(pytest.approx(0.0, abs=1e-9), pytest.approx(430.0))]


def test_disturbed_ring_laser_block_does_not(shared_data: Path) -> None:
    rows = ring_laser(shared_data, "disturbed")
    noise = learn_noise(*rows[1:])
    assert max(end - begin for begin, end in still_spans(*rows, noise)) < 90.0, "too short for a run of 210 s"
    for start in range(0, 240, 30):  # no stage of a run would be taken for rest
        part = slice(start * RATE_HZ, (start + 60) * RATE_HZ)
        window = Increments(rows[0][part][0] - INTERVAL, rows[1][part], rows[2][part], rows[3][part])
        assert first_disturbance(window, noise) is not None, start


def test_mems_block_set_down_by_hand_stands_between_the_moves(shared_data: Path) -> None:
    table = pq.read_table(shared_data / "recordings" / "xsens_multiposition.parquet")
    time = table["time_s"].to_numpy()
    interval = np.diff(time, prepend=2 * time[0] - time[1])
    dv, dtheta = (
        (np.column_stack([table[f"{kind}_{a}_counts"].to_numpy() for a in "xyz"]) - 32768.0) * scale * interval[:, None]
        for kind, scale in (("accel", 0.0024), ("gyro", 0.00015979546))
    )
    noise = learn_noise(dv, dtheta, interval)
    spans = [s for s in still_spans(time, dv, dtheta, interval, noise, margin_s=0.5) if s[1] - s[0] > 2.0]
    assert spans[0][0] < 0.1
    assert 45.0 < spans[0][1] < 55.0, "the README's 50 s of rest"
    assert len(spans) >= 30, "and 30 positions after it"


def test_noise_is_learnt_from_the_quiet_parts() -> None:
    rows = rest(120.0, 12)
    rows[2][5000:8000, 0] += 0.01 * np.sin(np.arange(3000) / 30.0) * INTERVAL
    noise = learn_noise(*rows[1:])
    # A quartile of about 58 differences: σ of its relative error is about 0.2.
    for channel in (noise.gyro_x, noise.gyro_y, noise.gyro_z):
        assert channel.white == pytest.approx(ARW, rel=0.7)
    assert noise.accel_z.white == pytest.approx(VRW, rel=0.7)
    with pytest.raises(ValueError, match="10 s"):
        learn_noise(*rest(5.0, 1)[1:])


def test_sentence_names_sensor_value_and_limit() -> None:
    text = str(Disturbance(12.34, "gyro_y", math.radians(0.1), math.radians(0.05)))
    assert text == "moved at 12.3 s: 360 arcsec on gyro_y, limit 180"
