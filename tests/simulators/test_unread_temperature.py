"""A thermometer that was not read for a while."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_form import RATE_HZ, Truth, model, recording

from drivers.recording import Recording
from simulators.discrepancy.report import discrepancy

COEFFICIENT = 3e-7


def warmth(true: Truth, readings: np.ndarray) -> None:
    true["temperature"][:] = 25.0 + 5.0 * np.sin(2.0 * np.pi * true["t"] / 160.0)
    readings[:, 3] += COEFFICIENT * (true["temperature"] - 20.0)


def unread(field: str, from_s: float, to_s: float) -> Recording:
    """Return a recording that warms and cools without some of the values of a column."""
    case = recording(warmth, 73)
    samples = case.samples.copy()
    samples[field][round(from_s * RATE_HZ) : round(to_s * RATE_HZ)] = np.nan
    return replace(case, samples=samples)


@pytest.mark.parametrize("from_s", [0.0, 40.0])
def test_a_short_while_is_bridged_and_said(from_s: float) -> None:
    report = discrepancy([unread("temperature", from_s, from_s + 6.0)], model())
    (found,) = report.findings
    assert (found["effect"], found["channel"]) == ("bias_temperature", "gyro_x")
    coefficient = found["parameters"]["coefficient"]
    assert abs(coefficient["value"] - COEFFICIENT) < 3.3 * coefficient["sigma"]
    assert report.document["remarks"] == [
        "The temperature is missing from 2.5 % of the samples of blind-73.parquet; straight lines stand for it."
    ]


@pytest.mark.parametrize(("field", "what"), [("temperature", "temperature"), ("supply", "supply voltage")])
def test_a_long_while_is_not_and_what_follows_is_said(field: str, what: str) -> None:
    report = discrepancy([unread(field, 40.0, 100.0)], model())
    assert f"nothing that depends on the {what} was looked for" in report.document["text"]
    names = {one["effect"] for f in report.findings for one in (f, *f["alternatives"])}
    assert not names & {"temperature": {"bias_temperature", "thermal_lag"}, "supply": {"supply_sensitivity"}}[field]


def test_a_block_without_a_thermometer_has_lost_nothing() -> None:
    assert discrepancy([unread("temperature", 0.0, 1e6)], model()).document["remarks"] == []


def test_a_lag_shows_in_a_record_that_hardly_warms() -> None:
    """By a quarter of a degree: a coefficient of such would pass for a constant, a lag's course for nothing else."""
    time_constant_s = 30.0

    def lagging(true: Truth, readings: np.ndarray) -> None:
        warmth_s = 60.0
        risen, lag = np.exp(-true["t"] / warmth_s), np.exp(-true["t"] / time_constant_s)
        true["temperature"][:] = 21.0 + 0.25 * (1.0 - risen)
        # Of a first-order lag behind an exponential, in closed form: what it has not yet followed.
        behind = 0.25 * time_constant_s / (warmth_s - time_constant_s) * (risen - lag)
        readings[:, 3] += 1e-4 * behind

    report = discrepancy([recording(lagging, 74)], model())
    (found,) = report.findings
    assert (found["effect"], found["channel"], found["alternatives"]) == ("thermal_lag", "gyro_x", [])
    constant = found["parameters"]["time_constant"]
    assert abs(constant["value"] - time_constant_s) < 3.3 * constant["sigma"]
