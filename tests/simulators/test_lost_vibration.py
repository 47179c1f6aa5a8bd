"""Samples lost while a block is shaken: the mean of those that came is off by what was lost, and by no more."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import closed_form
import numpy as np
import pytest
from hidden_case import hidden_case
from scipy.stats import chi2

from drivers.recording import RecordingMeta
from simulators.discrepancy.lost_vibration import missed_mean_sigma
from simulators.discrepancy.report import discrepancy

RATE_HZ = closed_form.RATE_HZ


def shaking(rng: np.random.Generator, count: int, band_hz: tuple[float, float], rms_mps2: float) -> np.ndarray:
    """Return mean accelerations (count,) between samples of a random vibration that begins and ends at rest."""
    edges_s = np.arange(count + 1) / RATE_HZ
    omega = 2.0 * math.pi * rng.uniform(*band_hz, 60)
    phase = rng.uniform(0.0, 2.0 * math.pi, 60)
    speed = np.cos(np.outer(edges_s, omega) + phase) @ (rms_mps2 * math.sqrt(2.0 / 60.0) / omega)
    envelope = np.clip(np.minimum(edges_s, edges_s[-1] - edges_s) / 0.1, 0.0, 1.0)
    return np.asarray(np.diff(speed * envelope) * RATE_HZ)


@pytest.mark.parametrize("band_hz", [(1.0, 6.0), (3.0, 9.0)])
@pytest.mark.parametrize("lengths", [(1,), (1, 2, 3, 1, 1, 5), (40, 90)])
def test_what_gaps_take_of_a_mean_is_as_large_as_said(band_hz: tuple[float, float], lengths: tuple[int, ...]) -> None:
    rng, runs, count = np.random.default_rng(5), 200, round(60.0 * RATE_HZ)
    total = 0.0
    for _ in range(runs):
        vibration = shaking(rng, count, band_hz, 2.0)
        came = np.ones(count, dtype=np.bool_)
        for place, length in zip(np.linspace(0.1, 0.8, len(lengths)), lengths, strict=True):
            first = int(place * count) + int(rng.integers(0, 200))
            came[first : first + length] = False
        total += (float(vibration[came].mean()) / missed_mean_sigma(vibration, came)) ** 2
    low, high = chi2.ppf([5e-4, 1 - 5e-4], runs)
    assert low < total < high


def test_nothing_is_missed_of_what_came_whole_and_nothing_is_said_of_what_never_came() -> None:
    vibration = np.random.default_rng(6).standard_normal(500)
    assert missed_mean_sigma(vibration, np.ones(500, dtype=np.bool_)) == 0.0
    assert missed_mean_sigma(vibration, np.zeros(500, dtype=np.bool_)) == 0.0
    assert missed_mean_sigma(vibration, np.arange(500) < 3) > 0.0


@pytest.mark.parametrize("lost", [[(1500, 90), (1900, 40)], [(1320, 1), (1480, 2), (2001, 1)]])
def test_a_gap_between_two_large_readings_is_no_shift_while_it_is_shaken(lost: list[tuple[int, int]]) -> None:
    """Straight lines from crest to crest over the gaps would be a mean of σ's by the dozen, and look like a bias."""
    rng = np.random.default_rng(19)
    first, last = round(60.0 * RATE_HZ), round(120.0 * RATE_HZ)
    course = shaking(rng, last - first, (3.0, 9.0), 2.0)

    def change(_: closed_form.Truth, readings: np.ndarray) -> None:
        readings[first:last, 2] += course

    case = closed_form.recording(change, 83, moving=False)
    kept = np.ones(len(case.samples), dtype=np.bool_)
    for start, count in lost:
        while course[start - first - 1] < 1.0 or course[start + count - first] < 1.0:
            start += 1
        kept[start : start + count] = False
    span = {"kind": "vibration", "start_s": 60.0, "end_s": 120.0, "grms": 0.2, "band_hz": [3.0, 9.0]}
    meta = {**case.meta.model_dump(exclude_none=True), "motion": [{**span, "axis": [0.0, 0.0, 1.0]}]}
    shaken = replace(case, samples=case.samples[kept], meta=RecordingMeta.model_validate(meta))
    report = discrepancy([shaken], closed_form.model())
    assert [found["effect"] for found in report.findings if found["effect"] != "lost_samples"] == []
    assert report.document["remaining"]["empirical"] == []


def test_what_a_register_held_while_it_was_shaken_is_no_part_of_the_vibration(tmp_path: Path) -> None:
    """For 0.18 s it stood at whatever it had last read, which has no mean of nought and is no rectification."""
    case = hidden_case(90612, 316, tmp_path)
    report = discrepancy([case.recording], case.model)
    assert [(one["effect"], one["channel"]) for one in report.findings] == [("stuck_samples", "accel_y")]
