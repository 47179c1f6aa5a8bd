"""A random walk that goes on while a sensor is shaken along its axis, of which only the mean is seen meanwhile."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import closed_form
import numpy as np
import pytest
from hidden_case import hidden_case

from drivers.recording import Recording, RecordingMeta
from simulators.discrepancy.compare import compare
from simulators.discrepancy.hidden_course import hidden_courses
from simulators.discrepancy.report import discrepancy

RATE_HZ = closed_form.RATE_HZ
FIRST, LAST = round(80.0 * RATE_HZ), round(130.0 * RATE_HZ)
WALK = 1.5e-4  # m/s² per root second


def walked(seed: int) -> Recording:
    """Return a recording at rest, shaken along z, of an accelerometer that walks."""
    rng = np.random.default_rng([seed, 7])

    def change(_: closed_form.Truth, readings: np.ndarray) -> None:
        readings[:, 2] += np.cumsum(rng.standard_normal(len(readings))) * WALK / np.sqrt(RATE_HZ)
        readings[FIRST:LAST, 2] += np.resize([1.0, -1.0], LAST - FIRST)

    case = closed_form.recording(change, seed, moving=False)
    span = {"kind": "vibration", "start_s": 80.0, "end_s": 130.0, "grms": 0.1, "band_hz": [5.0, 9.0]}
    meta = {**case.meta.model_dump(exclude_none=True), "motion": [{**span, "axis": [0.0, 0.0, 1.0]}]}
    return replace(case, meta=RecordingMeta.model_validate(meta))


@pytest.mark.parametrize("seed", [13, 22, 40, 47])
def test_it_is_a_walk_and_no_drift_step_or_rectification(seed: int) -> None:
    """Where it stood at its mean meanwhile it jumped to it and from it; one walk in five had another name beside it."""
    report = discrepancy([walked(seed)], closed_form.model())
    assert [(one["effect"], one["channel"]) for one in report.findings] == [("rate_random_walk", "accel_z")]
    assert report.verdict in ("named", "tie")


def test_a_drift_beside_a_walk_in_vibration_ties_with_it(tmp_path: Path) -> None:
    case = hidden_case(90637, 202, tmp_path)
    (hidden,) = case.truth["effects"]
    for found in discrepancy([case.recording], case.model).findings:
        names = {(one["effect"], one["channel"]) for one in (found, *found["alternatives"])}
        assert (hidden["effect"], hidden["channel"]) in names


def test_what_is_hidden_has_no_mean_of_its_own_and_is_nothing_elsewhere() -> None:
    """The mean of a vibration's samples is what is compared."""
    scene = compare(walked(1), closed_form.model())
    courses = hidden_courses(scene)
    assert [channel for channel, _, _ in courses] == [2, 2]
    ((shaken, _),) = scene.vibrations
    for _, course, sigma in courses:
        assert abs(course[shaken].mean()) < 1e-12
        assert not course[~shaken].any()
        assert sigma == pytest.approx(1.0, rel=0.01)
    assert abs(courses[0][1] @ courses[1][1]) < 1e-9 * (courses[0][1] @ courses[0][1])


def test_a_step_while_it_is_shaken_is_where_the_means_say(tmp_path: Path) -> None:
    """Six seconds into a vibration; where it began, with a rectification that made up for it, it explained less."""
    case = hidden_case(90633, 410, tmp_path)
    found = {(one["effect"], one["channel"]): one for one in discrepancy([case.recording], case.model).findings}
    hidden = {(one["effect"], one["channel"]): one["parameters"] for one in case.truth["effects"]}
    assert found.keys() == hidden.keys()
    time = found["bias_step", "accel_z"]["parameters"]["time"]
    assert abs(time["value"] - hidden["bias_step", "accel_z"]["time"]) < 3.3 * time["sigma"]
