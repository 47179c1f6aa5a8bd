"""Overlapping Allan deviation: against allantools, closed forms, and the scatter its confidence promises."""

from __future__ import annotations

import allantools
import numpy as np
import pytest
from scipy.stats import binom

from inertial.allan import averaging_factors, overlapping_allan

INTERVAL_S = 0.01


@pytest.mark.parametrize("mean", [0.0, 9.81])
def test_agrees_with_allantools(mean: float) -> None:
    rng = np.random.default_rng(1)
    rate = mean + 1e-3 * rng.standard_normal(30_011) + 1e-6 * np.cumsum(rng.standard_normal(30_011))
    curve = overlapping_allan(rate, INTERVAL_S)
    taus, deviation, _, terms = allantools.oadev(rate, rate=1.0 / INTERVAL_S, data_type="freq", taus=curve.averaging_s)
    np.testing.assert_allclose(curve.averaging_s, taus, rtol=1e-12)
    np.testing.assert_allclose(curve.deviation, deviation, rtol=1e-9)
    np.testing.assert_array_equal(curve.terms, terms)


def test_every_averaging_factor_up_to_half_the_record_agrees_with_the_definition() -> None:
    rate = np.random.default_rng(2).standard_normal(101)
    curve = overlapping_allan(rate, 0.5, np.arange(1, 51))
    for m, deviation in zip(range(1, 51), curve.deviation, strict=True):
        means = np.array([rate[i : i + m].mean() for i in range(101 - m + 1)])
        squares = (means[m:] - means[:-m]) ** 2
        assert deviation == pytest.approx(np.sqrt(0.5 * squares.mean()), rel=1e-12)


def test_a_large_constant_part_costs_no_digits() -> None:
    # 2⁻³⁰ steps on top of 2²⁰ are exact in double precision, so both records hold the same noise
    steps = np.random.default_rng(3).integers(-1000, 1000, 20_000) * 2.0**-30
    small, large = (overlapping_allan(offset + steps, INTERVAL_S) for offset in (0.0, 2.0**20))
    np.testing.assert_allclose(large.deviation, small.deviation, rtol=1e-9)


def test_a_ramp_shows_as_slope_times_tau_over_root_two() -> None:
    curve = overlapping_allan(3e-3 * INTERVAL_S * np.arange(5000), INTERVAL_S)
    np.testing.assert_allclose(curve.deviation, 3e-3 * curve.averaging_s / np.sqrt(2.0), rtol=1e-9)


@pytest.mark.parametrize("kind", ["white", "walk"])
def test_the_interval_holds_the_truth_as_often_as_it_says(kind: str) -> None:
    rng = np.random.default_rng(4)
    runs, n, factors = 300, 4000, np.array([1, 30, 300, 1000])
    inside = np.zeros(factors.size)
    for _ in range(runs):
        rate = rng.standard_normal(n)
        if kind == "walk":
            rate = np.cumsum(rate)
        curve = overlapping_allan(rate, 1.0, factors)
        # of a discrete walk: (2 m² + 1) / (6 m); of white noise: 1 / m
        truth = np.sqrt(1.0 / factors if kind == "white" else (2.0 * factors**2 + 1.0) / (6.0 * factors))
        low, high = curve.interval(0.95)
        inside += (low <= truth) & (truth <= high)
    least, most = binom.interval(0.999, runs, 0.95)
    assert np.all(inside >= least)
    # at the two longest times the curve cannot show its slope, and the confidence is cautious
    assert np.all(inside[:2] <= most)


def test_a_single_averaging_time_has_a_cautious_interval() -> None:
    rate = np.random.default_rng(5).standard_normal(1000)
    alone, among = overlapping_allan(rate, 1.0, [10]), overlapping_allan(rate, 1.0, [5, 10, 20])
    assert alone.deviation[0] == among.deviation[1]
    assert 1.0 < alone.freedom[0] <= among.freedom[1]


def test_default_factors_are_whole_distinct_and_leave_three_spans() -> None:
    factors = averaging_factors(10_000_000, 107)
    assert factors[0] == 1
    assert factors[-1] == 3_333_333
    assert 95 <= factors.size <= 107
    assert np.all(np.diff(factors) > 0)


@pytest.mark.parametrize(
    ("rate", "interval_s", "factors", "said"),
    [
        (np.zeros((5, 3)), 1.0, None, "one channel"),
        (np.zeros(1), 1.0, None, "one channel"),
        (np.zeros(10), 0.0, None, "interval"),
        (np.zeros(10), 1.0, [6], "half the record"),
        (np.zeros(10), 1.0, [0], "from 1"),
        (np.zeros(10), 1.0, [1.5], "whole"),
        (np.array([0.0, np.nan, 0.0, 1.0]), 1.0, [1], "NaN"),
    ],
)
def test_what_cannot_be_averaged_is_refused_with_the_reason(
    rate: np.ndarray, interval_s: float, factors: list[float] | None, said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        overlapping_allan(rate, interval_s, factors)
