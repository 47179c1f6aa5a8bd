"""Readings in another unit, rates for increments above all, or of another sensor, whatever the sensors feel."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import closed_form
import numpy as np
import pytest
from closed_form import Truth, model, recording
from hidden_case import hidden_case

from drivers.recording import Recording
from simulators.discrepancy.report import discrepancy

GRAVITY_MPS2 = 9.80665
DEG = 180 / np.pi

Told = dict[str, float]
"""Factor by channel."""


def multiplied(factors: Told, *, moving: bool, leaning: bool = False) -> Recording:
    """Return a recording with columns in other units, the table level as stated or a little off."""

    def lean(_: Truth, readings: np.ndarray) -> None:
        readings[:, 0] += 2e-3 * leaning

    case = recording(lean, 31, moving=moving)
    samples = case.samples.copy()
    for channel, factor in factors.items():
        triad, _, axis = channel.partition("_")
        columns = ["xyz".index(axis)] if axis else [0, 1, 2]
        samples["dv" if triad == "accel" else "dtheta"][:, columns] *= factor
    return replace(case, samples=samples)


def told(case: Recording) -> Told:
    """Return the factors of units that are found."""
    findings = discrepancy([case], model()).findings
    return {f["channel"]: f["parameters"]["factor"]["value"] for f in findings if f["effect"] == "unit_error"}


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("power", [1, -1])
def test_rates_for_increments_and_increments_for_rates_are_the_sample_rate_off(moving: bool, power: int) -> None:
    factor = closed_form.RATE_HZ**power
    report = discrepancy([multiplied({"accel": factor, "gyro": factor}, moving=moving)], model())
    assert [(f["effect"], f["channel"]) for f in report.findings] == [("unit_error", "accel"), ("unit_error", "gyro")]
    for found in report.findings:
        assert found["parameters"]["factor"]["value"] == pytest.approx(factor, rel=1e-9)
    assert report.verdict == "named"


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize(
    "factors",
    [
        {"accel": 20.0},
        {"gyro": 20.0},
        {"accel": 1.0 / GRAVITY_MPS2},
        {"accel_z": 1.0 / GRAVITY_MPS2},
        {"accel_z": 1.0 / GRAVITY_MPS2, "gyro": 20.0},
        {"accel": 20.0, "gyro": DEG},
        {"accel_z": 20.0, "gyro_x": 20.0, "gyro_y": 1.0 / DEG},
    ],
)
def test_what_is_in_another_unit_is_told_and_nothing_else(factors: Told, moving: bool) -> None:
    assert told(multiplied(factors, moving=moving)) == pytest.approx(factors, rel=1e-9)


def test_a_bias_on_a_sensor_that_feels_little_does_not_keep_it_from_its_triads_unit() -> None:
    report = discrepancy([multiplied({"accel": 20.0}, moving=False, leaning=True)], model())
    names = [(f["effect"], f["channel"]) for f in report.findings]
    assert ("unit_error", "accel") in names
    (shift,) = (f for f in report.findings if f["effect"] != "unit_error")
    assert shift["channel"] == "accel_x"


@pytest.mark.parametrize(
    ("rate_hz", "triad", "factor", "moving"),
    [
        (100.0, "accel", 100.0, False),
        (100.0, "accel", 1e3 / GRAVITY_MPS2, False),
        (58.0, "gyro", 58.0, True),
        (58.0, "gyro", DEG, True),
    ],
)
def test_of_factors_that_are_near_each_other_the_one_that_fits_is_told(
    rate_hz: float, triad: str, factor: float, moving: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A hundred samples a second, and 102 milli-g in a m/s²; 58 samples, and 57.3 degrees in a radian (in turns)."""
    monkeypatch.setattr(closed_form, "RATE_HZ", rate_hz)
    assert told(multiplied({triad: factor}, moving=moving)) == pytest.approx({triad: factor}, rel=1e-6)


def test_a_scale_error_is_no_unit_where_a_sample_takes_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(closed_form, "RATE_HZ", 1.0)
    monkeypatch.setattr(closed_form, "DURATION_S", 900.0)
    assert told(multiplied({"accel_x": 1.003}, moving=True)) == {}


def test_exchanged_gyros_of_which_one_feels_next_to_nothing_are_not_turned_as_well(tmp_path: Path) -> None:
    """Of Earth's rate on the one either sign is as good: of chance it was the other."""
    case = hidden_case(90629, 480, tmp_path)
    (found,) = discrepancy([case.recording], case.model).findings
    assert (found["effect"], found["channel"]) == ("axis_swap", "gyro_x<-gyro_y")


def test_exchanged_gyros_of_opposite_inputs_are_not_two_that_are_turned(tmp_path: Path) -> None:
    """Of Earth's rate by a hundredth of one: to one of them it was as if turned, by chance."""
    case = hidden_case(90635, 66, tmp_path)
    (found,) = discrepancy([case.recording], case.model).findings
    assert (found["effect"], found["channel"]) == ("axis_swap", "gyro_x<-gyro_z")
