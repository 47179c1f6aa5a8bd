"""The drift law: what its table promises, and exponential saturation, which it must hold inside."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from inertial.ageing import TermHistories, fit_population
from inertial.ageing_forecast import HORIZON_MONTHS, leaving, leaving_months
from inertial.ageing_law import DriftLaw
from simulators.fleet import TermLaw, simulate_term

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # benchmarks are no installed package
from benchmarks.ageing import known

AGES = np.array([0.0, 0.5, 1.0, 3.0, 12.0, 24.0, 60.0, 264.0])


@pytest.mark.parametrize(
    ("law", "same"),
    [
        (DriftLaw(0.0, 0.7, 0.0, 3.0), lambda t: t),
        (DriftLaw(12.0 / 18.0, 0.0, 0.0, 6.0), lambda t: np.log1p(t / 6.0)),
        (DriftLaw(0.4, 1.0, 0.0, 0.3), lambda t: -np.expm1(-t / 30.0)),
        (DriftLaw(2.0, 1.0, 0.0, 40.0), lambda t: -np.expm1(-t / 6.0)),
        (DriftLaw(-0.4, 1.0, 0.0, 4.0), lambda t: np.expm1(t / 30.0)),
        (DriftLaw(-0.3, 0.0, 0.0, 1e-6), lambda t: t**1.3),
    ],
)
def test_the_law_holds_what_its_table_says(law: DriftLaw, same: Callable[[np.ndarray], np.ndarray]) -> None:
    np.testing.assert_allclose(law.growth(AGES), same(AGES) / same(np.array(12.0)), rtol=1e-5, atol=1e-9)


def test_the_law_is_smooth_through_its_limits_and_never_overflows() -> None:
    near, at = DriftLaw(0.4, 1e-7, 0.0, 4.0).growth(AGES), DriftLaw(0.4, 0.0, 0.0, 4.0).growth(AGES)
    np.testing.assert_allclose(near, at, rtol=1e-6)
    for decline in (-20.0, 20.0):
        for bend in (-3.0, 4.0):
            assert np.all(np.isfinite(DriftLaw(decline, bend, 0.0, 0.05).growth(AGES)))


def test_what_comes_at_once_is_there_from_the_start() -> None:
    np.testing.assert_allclose(DriftLaw(0.4, 0.5, 0.2, 3.0).growth(np.array([0.0, 12.0])), [0.2, 1.0], rtol=1e-6)


def test_a_law_that_strays_is_another_power_of_time_beyond_what_is_known() -> None:
    """Of a pure power, tᵖ, it makes t^(p + stray) from there on: in closed form, joined without a step."""
    known, stray = 24.0, -0.2
    root = DriftLaw(0.5, 0.0, 0.0, 1e-6, stray)
    ages = np.arange(6.0, 200.0, 0.5)
    slope = 0.5 / 12.0**0.5  # of h = √(t/12), times √t
    beyond = slope * known**-stray / (0.5 + stray) * (ages ** (0.5 + stray) - known ** (0.5 + stray))
    expected = np.where(ages <= known, np.sqrt(ages / 12.0), np.sqrt(known / 12.0) + beyond)
    np.testing.assert_allclose(root.growth_beyond(ages, known), expected, rtol=3e-4)  # τ is not quite 0
    np.testing.assert_array_equal(root.growth(ages), DriftLaw(0.5, 0.0, 0.0, 1e-6).growth(ages))
    late = ages[ages > 60.0]  # a block that is older than most goes on from the law where it stands
    from_there = root.growth_beyond(late, known)
    assert from_there[0] == root.growth(late)[0]
    np.testing.assert_allclose(np.diff(from_there), np.diff(root.growth_beyond(ages, known)[ages > 60.0]), rtol=1e-9)


def test_the_draws_of_a_fit_stray_as_they_are_said_to_and_alike_on_all_axes() -> None:
    from inertial.ageing import STRAY_MEAN, STRAY_SIGMA

    rng = np.random.default_rng(13)
    axes = [simulate_term(TermLaw(), 5, np.arange(1.0, 9.0), 8.0, rng).histories for _ in range(2)]
    one, other = fit_population(axes)
    strays = np.array([draw.law.stray for draw in one.draws])
    assert strays.tolist() == [draw.law.stray for draw in other.draws]
    assert np.mean(strays) == pytest.approx(STRAY_MEAN, abs=1e-9)
    assert np.std(strays) == pytest.approx(STRAY_SIGMA, rel=0.03)


def test_a_law_is_known_to_the_age_that_some_blocks_are_beyond() -> None:
    blocks = [(np.arange(1.0, last + 1.0), np.zeros(last), np.ones(last)) for last in (*[12] * 8, 36, 60)]
    assert TermHistories.of(blocks).known_months == 36.0


@pytest.mark.parametrize("law", ["logarithmic", "stretched"])
def test_with_the_planted_law_forecasts_cover_within_the_binomial_band(law: str) -> None:
    """Of a law that the family holds and of one that it does not: nothing of it is fitted, and none strays."""
    found = known(law, blocks=100, seed=1)
    low, high = binom.interval(0.999, found["intervals"], 0.9)
    assert found["intervals"] > 30
    assert low <= found["inside"] <= high


def test_exponential_saturation_is_covered_within_the_binomial_band() -> None:
    """Eighty blocks of two like axes, of which many never leave: what is fitted must know that the drift ends."""
    rng = np.random.default_rng(11)
    months, limit = np.arange(1.0, 25.0), 20.0
    axes = [simulate_term(TermLaw("saturating"), 80, months, 24.0 + HORIZON_MONTHS, rng) for _ in range(2)]
    fits = fit_population([axis.histories for axis in axes])
    samples = [
        leaving_months(axis.histories, fit, limit, k) for k, (axis, fit) in enumerate(zip(axes, fits, strict=True))
    ]
    truth = np.minimum(*(axis.leaves_months(limit) for axis in axes))
    found = [leaving(row) for row in np.minimum(*samples)]
    open_ones = [k for k, one in enumerate(found) if max(one.outside_now, one.beyond_horizon) < 0.9]
    highs = [np.inf if found[k].high is None else found[k].high for k in open_ones]
    inside = [(found[k].low or 0.0) <= truth[k] <= high for k, high in zip(open_ones, highs, strict=True)]
    low, high = binom.interval(0.999, len(inside), 0.9)
    assert len(inside) > 30
    assert low <= sum(inside) <= high


def test_the_prior_prefers_laws_with_a_name_and_its_slope_is_its_derivative() -> None:
    from inertial.ageing import BEND, SHARED_MEAN, _prior

    def at(bend: float) -> np.ndarray:
        point = SHARED_MEAN + 0.3
        point[BEND] = bend
        return np.asarray(point)

    heights = {bend: _prior(at(bend))[0] for bend in (0.0, 0.5, 1.0)}
    assert heights[0.0] > heights[0.5] < heights[1.0]
    for bend in (-0.4, 0.0, 0.1, 0.5, 0.9, 1.7):
        numeric = [
            (_prior(at(bend) + shift)[0] - _prior(at(bend) - shift)[0]) / 2e-5 for shift in 1e-5 * np.eye(len(at(bend)))
        ]
        np.testing.assert_allclose(_prior(at(bend))[1], numeric, atol=1e-5)
    assert _prior(SHARED_MEAN + 100.0)[0] == -np.inf
