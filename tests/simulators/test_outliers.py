"""A wild sample is neither two steps nor larger noise; what a turn does from sample to sample is no wild sample."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_form import RATE_HZ, TURNS, WHITE, model, recording

from simulators.discrepancy.compare import compare
from simulators.discrepancy.outliers import find_outliers
from simulators.discrepancy.report import discrepancy

SIGMA = WHITE["gyro"] / np.sqrt(RATE_HZ)


def test_a_wild_sample_is_taken_out_and_said_and_hides_nothing() -> None:
    case = recording(None, 101)
    samples = case.samples.copy()
    samples["dtheta"][2100, 2] += 50.0 * SIGMA
    samples["dtheta"][3600, 1] -= 40.0 * SIGMA
    report = discrepancy([replace(case, samples=samples)], model())
    assert (report.verdict, report.findings) == ("none", [])
    found = [(one["channel"], round(one["time_s"] * RATE_HZ)) for one in report.document["outliers"]]
    assert found == [("gyro_y", 3601), ("gyro_z", 2101)]
    assert report.document["outliers"][1]["sigmas"] == pytest.approx(50.0, abs=5.0)
    assert "gyro_z at 105.05 s" in report.document["text"]


def test_two_samples_in_a_row_and_noise_of_heavy_tails_stay() -> None:
    case = recording(None, 102, moving=False)
    samples = case.samples.copy()
    samples["dtheta"][2100:2102, 2] += 50.0 * SIGMA
    tails = np.random.default_rng(102).standard_t(4, len(samples)) / np.sqrt(2.0)
    samples["dv"][:, 0] += 2.0 * WHITE["accel"] / np.sqrt(RATE_HZ) * np.clip(tails, -6.0, 6.0)
    assert find_outliers(compare(replace(case, samples=samples), model()))[1] == []


def test_a_turn_that_came_late_leaves_no_wild_sample() -> None:
    """A turn a quarter of a sample late: its first sample is some hundred σ off, and tells so."""
    case = recording(None, 103)
    samples = case.samples.copy()
    start_s, _, rate_dps, axis = TURNS[3]
    place = round(start_s * RATE_HZ)
    samples["dtheta"][place, axis] -= 0.25 * np.radians(rate_dps) / RATE_HZ
    assert find_outliers(compare(replace(case, samples=samples), model()))[1] == []


@pytest.mark.parametrize("sigmas", [13.0, -13.0])
def test_a_glitch_where_a_turn_begins_is_no_lever_arm(sigmas: float) -> None:
    """Too tame to be taken out, and just where a sensor off the axis feels the table start."""
    case = recording(None, 104)
    samples = case.samples.copy()
    samples["dv"][round(TURNS[2][0] * RATE_HZ), 0] += sigmas * WHITE["accel"] / np.sqrt(RATE_HZ)
    report = discrepancy([replace(case, samples=samples)], model())
    assert report.findings == [], report.document["text"]
    assert "single sample" in report.document["rejected"][0]["reason"]


def test_a_wild_sample_where_another_sensor_turns_is_taken_out() -> None:
    """The gyros across the turn feel nothing of its end."""
    case = recording(None, 104)
    samples = case.samples.copy()
    _, end_s, _, axis = TURNS[0]
    place, across = round(end_s * RATE_HZ) - 2, (axis + 2) % 3
    samples["dtheta"][place, across] -= 40.0 * SIGMA
    (found,) = find_outliers(compare(replace(case, samples=samples), model()))[1]
    assert (found.channel, round(found.time_s * RATE_HZ)) == (f"gyro_{'xyz'[across]}", place + 1)


def test_two_glitches_a_moment_apart_are_no_two_steps() -> None:
    case = recording(None, 105)
    samples = case.samples.copy()
    samples["dtheta"][[2200, 2202], 1] += 13.0 * SIGMA
    report = discrepancy([replace(case, samples=samples)], model())
    assert report.findings == [], report.document["text"]
    assert [one["effect"] for one in report.document["rejected"]] == ["bias_step", "bias_step"]
    assert "3 samples" in report.document["rejected"][0]["reason"]
