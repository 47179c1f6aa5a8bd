"""What no effect of the library is like has no name, but a place and a curve that says what drives it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_form import GRAVITY_MPS2, RATE_HZ, WHITE, Truth, model, recording
from scipy.signal import lfilter

from simulators.discrepancy.report import Report, discrepancy

ACCEL_SIGMA, GYRO_SIGMA = (WHITE[kind] * np.sqrt(RATE_HZ) for kind in ("accel", "gyro"))


def is_unknown_by(report: Report, channel: str, curve: str) -> bool:
    """Whether a report names nothing and tells of a curve on a channel."""
    told = {(one["channel"], one["term"]) for one in report.document["remaining"]["empirical"]}
    return report.verdict == "unknown" and not report.findings and (channel, curve) in told


def test_a_scale_that_follows_the_supply_is_no_walk_of_the_bias() -> None:
    supply_v = 28.0 + 2.0 * np.sin(2.0 * np.pi * np.arange(4800) / RATE_HZ / 37.0)

    def change(true: Truth, readings: np.ndarray) -> None:
        readings[:, 2] += 2.0 * ACCEL_SIGMA * true["accel"][:, 2] / GRAVITY_MPS2 * (supply_v - 28.0) / 2.0

    case = recording(change, 51)
    samples = case.samples.copy()
    samples["supply"] = supply_v
    report = discrepancy([replace(case, samples=samples)], model())
    assert is_unknown_by(report, "accel_z", "input x supply"), report.document["text"]


def test_a_bias_by_the_square_of_how_fast_it_warms_is_neither_steps_nor_a_transient() -> None:
    """Warming and cooling shift it alike, by a heater that goes on and off."""
    time_s = np.arange(4800) / RATE_HZ
    slope = np.where((time_s > 40.0) & (time_s < 110.0), 1.0, np.where((time_s > 130.0) & (time_s < 180.0), -1.4, 0.0))
    temperature_c = 20.0 + 0.1 * np.cumsum(slope) / RATE_HZ

    def change(_: Truth, readings: np.ndarray) -> None:
        readings[:, 5] += 2.0 * GYRO_SIGMA * slope**2

    case = recording(change, 52)
    samples = case.samples.copy()
    samples["temperature"][:, 0] = temperature_c + 0.002 * np.random.default_rng(52).standard_normal(4800)
    report = discrepancy([replace(case, samples=samples)], model())
    assert is_unknown_by(report, "gyro_z", "temperature slope^2"), report.document["text"]


@pytest.mark.parametrize("share", [0.005, 1.0])
@pytest.mark.parametrize("lasting_s", [0.15, 0.5])
def test_a_gyro_that_is_filtered_is_no_delay_of_all_and_no_lever_arm(lasting_s: float, share: float) -> None:
    """Of one sensor's input a share, or all, comes through a low-pass that the others do not have."""

    def change(true: Truth, readings: np.ndarray) -> None:
        kept, rate = np.exp(-1.0 / RATE_HZ / lasting_s), true["gyro"][:, 1]
        filtered = lfilter([1.0 - kept], [1.0, -kept], rate, zi=[kept * rate[0]])[0]
        readings[:, 4] += share * (filtered - rate)

    report = discrepancy([recording(change, 53)], model())
    assert is_unknown_by(report, "gyro_y", f"memory of input, {lasting_s:g} s"), report.document["text"]
