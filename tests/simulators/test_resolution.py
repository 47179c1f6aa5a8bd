"""The step that increments show: a coarser readout and another unit are told by it, however large the noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_form import RATE_HZ, WHITE, model, recording
from hypothesis import example, given
from hypothesis import strategies as st
from test_readout_steps import STEP_RAD, in_steps, model_in_steps

from inertial.rounding import increment_step
from simulators.discrepancy.report import discrepancy


@given(
    step=st.floats(1e-7, 1e-3),
    origin=st.floats(-1.0, 1.0),
    spread=st.floats(0.6, 300.0),
    fine=st.floats(0.0, 0.02),
    seed=st.integers(0, 2**32 - 1),
)
@example(step=1e-3, origin=0.0, spread=270.0, fine=0.01953125, seed=1878160)  # the closest two lie at the thin end
def test_a_lattice_is_found_wherever_it_lies_and_whatever_the_frame_rounds(
    step: float, origin: float, spread: float, fine: float, seed: int
) -> None:
    counts = np.round(spread * np.random.default_rng(seed).standard_normal(4000))
    readings, last_place = origin + counts * step, fine * step + 1e-12
    found = increment_step(np.round(readings / last_place) * last_place, last_place)
    assert found is not None
    # Half a last place off each, at worst all to the side that tilts a straight line through them most.
    apart = np.abs(np.unique(counts) - np.unique(counts).mean())
    assert found[0] == pytest.approx(step, rel=max(0.5 * fine * apart.sum() / (apart @ apart), 1e-5))


@given(seed=st.integers(0, 2**32 - 1))
def test_readings_on_no_lattice_show_none(seed: int) -> None:
    readings = np.random.default_rng(seed).standard_normal(4000)
    assert increment_step(readings, 1e-12) is None
    assert increment_step(readings) is None


@pytest.mark.parametrize("moving", [False, True])
def test_one_sensor_in_another_unit_is_told_by_its_step_where_its_input_says_little(moving: bool) -> None:
    """Of Earth rate alone the factor shows to a tenth, beside noise that is as many times larger."""
    case = recording(None, 71, moving=moving)
    samples = case.samples.copy()
    samples["dtheta"] = in_steps(samples["dtheta"], STEP_RAD)
    samples["dtheta"][:, 0] *= np.degrees(1.0)
    report = discrepancy([replace(case, samples=samples)], model_in_steps(STEP_RAD))
    assert [(f["effect"], f["channel"]) for f in report.findings] == [("unit_error", "gyro_x")]
    assert report.findings[0]["parameters"]["factor"]["value"] == pytest.approx(np.degrees(1.0))
    assert report.verdict == "named"


def test_a_triad_in_another_unit_is_one_mistake() -> None:
    case = recording(None, 72, moving=False)
    samples = case.samples.copy()
    samples["dtheta"] = in_steps(samples["dtheta"], STEP_RAD) / np.radians(1.0)
    report = discrepancy([replace(case, samples=samples)], model_in_steps(STEP_RAD))
    assert [(f["effect"], f["channel"]) for f in report.findings] == [("unit_error", "gyro")]


def test_a_coarser_step_is_named_where_its_noise_is_lost_in_that_of_the_sensor() -> None:
    noise_rad = WHITE["gyro"] / np.sqrt(RATE_HZ)
    case = recording(None, 73, moving=False)
    samples = case.samples.copy()
    samples["dtheta"][:, 1] = in_steps(samples["dtheta"][:, 1], 0.3 * noise_rad)
    samples["dtheta"][:, [0, 2]] = in_steps(samples["dtheta"][:, [0, 2]], 0.2 * noise_rad)
    report = discrepancy([replace(case, samples=samples)], model_in_steps(0.2 * noise_rad))
    assert [(f["effect"], f["channel"]) for f in report.findings] == [("quantisation", "gyro_y")]
    step = report.findings[0]["parameters"]["step"]
    assert abs(step["value"] - 0.3 * noise_rad) < 3.0 * step["sigma"]
    assert step["sigma"] < 0.05 * noise_rad


def test_noise_like_that_of_rounding_on_steps_as_stated_is_no_coarser_step() -> None:
    case, step = recording(None, 74, moving=False), 0.3 * WHITE["gyro"] / np.sqrt(RATE_HZ)
    samples = case.samples.copy()
    rounding = 10.0 * step * np.random.default_rng(74).uniform(-0.5, 0.5, len(samples) + 1)
    samples["dtheta"][:, 1] += np.diff(rounding)
    samples["dtheta"] = in_steps(samples["dtheta"], step)
    report = discrepancy([replace(case, samples=samples)], model_in_steps(step))
    assert report.verdict != "none"
    assert "quantisation" not in [f["effect"] for f in report.findings]
    on_no_lattice = replace(case, samples=samples.copy())
    on_no_lattice.samples["dtheta"][:, 1] += 0.3 * step * np.random.default_rng(75).standard_normal(len(samples))
    report = discrepancy([on_no_lattice], model())
    assert [(f["effect"], f["channel"]) for f in report.findings] == [("quantisation", "gyro_y")]
