"""Two names of one sensor, of which the first to be found had a shape that did some of the second's work."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from closed_form import RATE_HZ, WHITE, Truth, model, recording
from hidden_case import hidden_case

from simulators.discrepancy.report import discrepancy

GYRO_SIGMA = WHITE["gyro"] * np.sqrt(RATE_HZ)


@pytest.mark.parametrize("number", [310, 425])
def test_names_are_judged_with_the_shapes_of_others_refined_beside_them(number: int, tmp_path: Path) -> None:
    """An asymmetry beside a coefficient whose reference made up for it; a shift beside a slower transient."""
    case = hidden_case(90617, number, tmp_path)
    told = {
        (one["effect"], one["channel"])
        for found in discrepancy([case.recording], case.model).findings
        for one in (found, *(other for other in found["alternatives"] if other["behind_nats"] < 3.0))
    }
    assert {(one["effect"], one["channel"]) for one in case.truth["effects"]} <= told


def test_a_name_that_has_taken_what_two_hide_gives_way_to_both(tmp_path: Path) -> None:
    """A supply's coefficient at a voltage that made up for a thermal lag, and a walk that was named for the rest."""
    case = hidden_case(90709, 12, tmp_path)
    found = {(one["effect"], one["channel"]) for one in discrepancy([case.recording], case.model).findings}
    assert found == {(one["effect"], one["channel"]) for one in case.truth["effects"]}


def test_a_shift_beside_a_transient_leaves_each_its_own_size() -> None:
    amplitude, time_constant_s, shift = -2.0 * GYRO_SIGMA, 40.0, 0.5 * GYRO_SIGMA

    def change(true: Truth, readings: np.ndarray) -> None:
        readings[:, 5] += amplitude * np.exp(-true["t"] / time_constant_s) + shift

    report = discrepancy([recording(change, 121)], model())
    found = {one["effect"]: one["parameters"] for one in report.findings}
    assert set(found) == {"turn_on_transient", "bias_shift"}, report.document["text"]
    for effect, name, value in (
        ("turn_on_transient", "amplitude", amplitude),
        ("turn_on_transient", "time_constant", time_constant_s),
        ("bias_shift", "shift", shift),
    ):
        one = found[effect][name]
        assert abs(one["value"] - value) < 3.3 * one["sigma"], (effect, name)
