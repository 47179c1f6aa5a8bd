"""Larger white noise goes on all the time: that of one burst is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from closed_form import RATE_HZ, WHITE, model, recording

from drivers.recording import Recording
from simulators.discrepancy.report import discrepancy

Draw = Callable[[np.random.Generator, int], np.ndarray]


def noisier(times: float, seed: int, draw: Draw, start_s: float = 0.0, end_s: float = np.inf) -> Recording:
    """Return a recording with so many times the white noise of accel_y more, for a while."""
    case = recording(None, seed)
    samples, more = case.samples.copy(), draw(np.random.default_rng(seed), len(case.samples))
    span = (samples["time"] > start_s) & (samples["time"] <= end_s)
    samples["dv"][:, 1] += times * WHITE["accel"] / np.sqrt(RATE_HZ) * np.where(span, more, 0.0)
    return replace(case, samples=samples)


def gaussian(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return Gaussian noise."""
    return rng.standard_normal(count)


def heavy(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return noise of the same variance, one sample in twenty four times as large."""
    return rng.standard_normal(count) * np.where(rng.random(count) < 0.05, 4.0, 1.0) / np.sqrt(1.75)


def students(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return noise of the same variance with tails of a power law."""
    return rng.standard_t(4, count) / np.sqrt(2.0)


@pytest.mark.parametrize(("times", "start_s", "length_s"), [(1.5, 40.0, 16.0), (1.0, 150.0, 40.0)])
def test_white_noise_that_is_larger_for_a_while_is_no_random_walk(
    times: float, start_s: float, length_s: float
) -> None:
    case = noisier(times, 7, gaussian, start_s, start_s + length_s)
    report = discrepancy([case], model())
    assert (report.verdict, report.findings) == ("unknown", []), report.document["text"]
    (term,) = report.document["remaining"]["empirical"]
    assert (term["channel"], term["kind"]) == ("accel_y", "unsteady")
    assert start_s <= term["at_s"] <= start_s + length_s


@pytest.mark.parametrize("draw", [gaussian, heavy, students])
@pytest.mark.parametrize("times", [0.6, 3.0])
def test_white_noise_that_is_larger_all_the_time_is_a_random_walk(draw: Draw, times: float) -> None:
    for seed in range(3):
        report = discrepancy([noisier(times, seed, draw)], model())
        assert report.verdict == "named", (seed, report.document["text"])
        assert [(one["effect"], one["channel"]) for one in report.findings] == [("random_walk", "accel_y")]
