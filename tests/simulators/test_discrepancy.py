"""A few hidden cases, their effects written by closed form apart from the library: names, sizes, nothing invented."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from closed_form import Change, Truth, model, recording

from simulators.discrepancy.report import discrepancy
from simulators.model_store import load_model

DEG_PER_H = np.pi / 180 / 3600


def bias(_: Truth, readings: np.ndarray) -> None:
    readings[:, 3] += 1.5 * DEG_PER_H


def step(true: Truth, readings: np.ndarray) -> None:
    readings[true["t"] > 131.0, 1] += 4e-4


def warm_up(true: Truth, readings: np.ndarray) -> None:
    readings[:, 4] += 8.0 * DEG_PER_H * np.exp(-true["t"] / 30.0)


def scale(true: Truth, readings: np.ndarray) -> None:
    readings[:, 5] += 6e-5 * true["gyro"][:, 2]


def lean(true: Truth, readings: np.ndarray) -> None:
    readings[:, 0] += 2e-5 * true["accel"][:, 1]


def unbalance(true: Truth, readings: np.ndarray) -> None:
    readings[:, 4] += 6e-7 * true["accel"][:, 0]


def hum(true: Truth, readings: np.ndarray) -> None:
    readings[:, 2] += 3e-4 * np.cos(2 * np.pi * 1.37 * true["t"])


def flipped(_: Truth, readings: np.ndarray) -> None:
    readings[:, 4] *= -1.0


def swapped(_: Truth, readings: np.ndarray) -> None:
    readings[:, [0, 1]] = readings[:, [1, 0]]


def degrees(_: Truth, readings: np.ndarray) -> None:
    readings[:, 3:] *= 180 / np.pi


CASES: list[tuple[Change, str, str, dict[str, float]]] = [
    (bias, "bias_shift", "gyro_x", {"shift": 1.5 * DEG_PER_H}),
    (step, "bias_step", "accel_y", {"step": 4e-4, "time": 131.0}),
    (warm_up, "turn_on_transient", "gyro_y", {"amplitude": 8.0 * DEG_PER_H, "time_constant": 30.0}),
    (scale, "scale_factor", "gyro_z", {"error": 6e-5}),
    (lean, "misalignment", "accel_x<-accel_y", {"angle": 2e-5}),
    (unbalance, "g_sensitivity", "gyro_y<-accel_x", {"coefficient": 6e-7}),
    (hum, "sinusoid", "accel_z", {"frequency": 1.37}),
    (flipped, "sign_flip", "gyro_y", {}),
    (swapped, "axis_swap", "accel_x<-accel_y", {}),
    (degrees, "unit_error", "gyro", {"factor": 180 / np.pi}),
]


@pytest.mark.parametrize(("change", "effect", "channel", "values"), CASES, ids=[c[1] for c in CASES])
def test_a_hidden_effect_is_named_with_its_size_and_nothing_else(
    change: Callable[..., None], effect: str, channel: str, values: dict[str, float]
) -> None:
    report = discrepancy([recording(change, 71)], model())
    assert report.verdict == "named", report.document["text"]
    assert [(f["effect"], f["channel"]) for f in report.findings] == [(effect, channel)]
    finding = report.findings[0]
    assert finding["confidence"] > 0.9
    assert finding["gap_after"] < finding["gap_before"]
    for name, value in values.items():
        found = finding["parameters"][name]
        # 4.5 σ for one case in 1e5, and a part in a thousand for shapes that are searched on a grid.
        assert abs(found["value"] - value) < 4.5 * (found["sigma"] or 0.0) + 1e-3 * abs(value)


@pytest.mark.parametrize("seed", range(3))
def test_where_nothing_is_hidden_nothing_is_named(seed: int) -> None:
    report = discrepancy([recording(None, 80 + seed, moving=seed != 1)], model(free=seed == 2))
    assert report.verdict == "none", report.document["text"]
    assert report.findings == []
    assert report.document["remaining"]["empirical"] == []
    assert report.model == model(free=seed == 2)


def test_noise_three_times_larger_than_stated_is_named_as_noise() -> None:
    report = discrepancy([recording(None, 91)], model(factor=1 / 3))
    assert {f["effect"] for f in report.findings} == {"random_walk"}
    assert len(report.findings) == 6


@pytest.mark.parametrize(("column", "slack"), [(2, 2.5e-3), (5, 2e-5)])
def test_a_sensor_that_lags_behind_its_input_by_a_slack_is_unknown_and_said_to_have_hysteresis(
    column: int, slack: float
) -> None:
    """Going up it reads the input less the slack, going down the input and the slack, in between what it last read."""

    def lag(true: Truth, readings: np.ndarray) -> None:
        inputs = np.hstack([true["accel"], true["gyro"]])[:, column]
        width = 0.25 * np.ptp(inputs)
        reading = inputs[0]
        for k, value in enumerate(inputs):
            reading = np.clip(reading, value - width, value + width)
            readings[k, column] += slack / width * (reading - value)

    report = discrepancy([recording(lag, 61)], model())
    assert (report.verdict, report.findings) == ("unknown", []), report.document["text"]
    assert "hysteresis" in report.document["remaining"]["empirical"][0]["term"]


def test_a_wave_that_no_effect_has_is_unknown() -> None:
    def wave(true: Truth, readings: np.ndarray) -> None:
        angle = 2 * np.pi * true["t"] / 70.0
        readings[:, 4] += 2e-5 * np.tanh(3.0 * np.sin(angle))

    report = discrepancy([recording(wave, 92, moving=False)], model())
    assert report.verdict == "unknown", report.document["text"]
    assert {term["channel"] for term in report.document["remaining"]["empirical"]} == {"gyro_y"}


def test_at_rest_a_tilt_and_a_bias_are_a_tie_and_the_next_recording_would_split_them() -> None:
    def shifted(_: Truth, readings: np.ndarray) -> None:
        readings[:, 0] += 3e-4

    report = discrepancy([recording(shifted, 93, moving=False)], model())
    assert report.verdict == "tie"
    finding = report.findings[0]
    names = {(finding["effect"], finding["channel"])} | {(a["effect"], a["channel"]) for a in finding["alternatives"]}
    assert ("bias_shift", "accel_x") in names
    assert len(names) > 1
    best = report.document["next_recording"][0]
    assert best["name"] != "rest_longer"
    assert best["expected_nats"] > 3.0


def test_it_writes_report_page_and_a_child_model_that_leaves_nothing_to_find(tmp_path: Path) -> None:
    told: list[float] = []
    case = recording(scale, 94)
    report = discrepancy([case], model(), tmp_path, lambda share, _: told.append(share))
    assert told == sorted(told)
    assert told[-1] == 1.0
    document = json.loads((tmp_path / "report.json").read_text())
    assert document == report.document
    page = (tmp_path / "report.html").read_text()
    assert "scale_factor" in page
    assert "http://" not in page
    assert "https://" not in page
    child = load_model(tmp_path / f"{document['model']['sha256']}.json")
    assert child.parent == model().sha256()
    assert child.effects[0].effect == "scale_factor"
    again = discrepancy([case], child)
    assert again.verdict == "none"
