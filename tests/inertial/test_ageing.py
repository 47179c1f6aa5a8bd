"""The drift model: an exact likelihood, forecasts that cover, steps told from drift at the stated false-alarm rate."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, multivariate_normal, norm, poisson
from scipy.stats import t as student

from inertial.ageing import PopulationFit, Sizes, TermHistories, best_sizes, fit_population, with_steps
from inertial.ageing_filter import log_likelihood
from inertial.ageing_forecast import HORIZON_MONTHS, Leaving, bands, leaving, leaving_months
from inertial.ageing_law import DriftLaw
from inertial.ageing_steps import find_steps, predicted_sigma
from simulators.fleet import FleetTerm, Shock, TermLaw, simulate_term

MONTHLY = np.arange(1.0, 37.0)
LOGARITHMIC = DriftLaw(decline=12.0 / 18.0, bend=0.0, onset=0.0, law_months=6.0)
TRUE = Sizes(LOGARITHMIC, mean=0.0, spread=10.0, offset=1.0, walk=0.15, scatter=0.3, relaxation_months=math.inf)
"""What ``TermLaw()`` plants."""


def dense_covariance(months: np.ndarray, sigma: np.ndarray, sizes: Sizes) -> np.ndarray:
    """The model's covariance written out, with nothing of the filter."""
    growth = np.log1p(months / 6.0) / np.log1p(2.0)
    earlier, apart = np.minimum.outer(months, months), np.abs(np.subtract.outer(months, months))
    rate = 1.0 / sizes.relaxation_months
    came = -np.expm1(-2.0 * rate * earlier) / (2.0 * rate) if rate > 0.0 else earlier
    walk = sizes.walk**2 * came * np.exp(-rate * apart)
    own = np.diag(sigma**2 + sizes.scatter**2)
    return own + walk + sizes.offset**2 + sizes.spread**2 * np.outer(growth, growth)


@pytest.mark.parametrize("relaxation_months", [4.0, math.inf])
def test_the_likelihood_is_that_of_the_dense_gaussian(relaxation_months: float) -> None:
    sizes = replace(TRUE, walk=0.8, relaxation_months=relaxation_months)
    rng = np.random.default_rng(1)
    blocks = []
    expected = 0.0
    for count in (1, 4, 9):
        months = np.sort(rng.uniform(0.0, 40.0, count))
        sigma = rng.uniform(0.5, 2.0, count)
        value = rng.standard_normal(count) * 5.0
        growth = np.log1p(months / 6.0) / np.log1p(2.0)
        expected += multivariate_normal(1.5 * growth, dense_covariance(months, sigma, sizes)).logpdf(value)
        blocks.append((months, value, sigma))
    histories = TermHistories.of(blocks)
    row = replace(sizes, mean=1.5).row
    found = log_likelihood(
        histories.offsets,
        histories.months,
        TRUE.law.growth(histories.months),
        histories.value,
        histories.sigma**2,
        histories.jump,
        row,
    )
    assert found == pytest.approx(expected, rel=1e-9)


def test_a_marked_step_leaves_the_likelihood_of_what_does_not_depend_on_it() -> None:
    """A step of unknown size before the last check makes that check say nothing."""
    rng = np.random.default_rng(2)
    months, value, sigma = np.arange(1.0, 7.0), rng.standard_normal(6), np.ones(6)
    short = TermHistories.of([(months[:5], value[:5], sigma[:5])])
    whole = with_steps(TermHistories.of([(months, value, sigma)]), [5])

    def likelihood(histories: TermHistories) -> float:
        growth = TRUE.law.growth(histories.months)
        rows = histories.offsets, histories.months, growth, histories.value, histories.sigma**2
        return log_likelihood(*rows, histories.jump, TRUE.row)

    assert likelihood(whole) == pytest.approx(likelihood(short), rel=1e-12)


def test_a_marked_step_stays_also_where_the_walk_is_pulled_back() -> None:
    """All checks behind it may lie as much higher as they like."""
    rng = np.random.default_rng(9)
    months, value, sigma = np.arange(1.0, 21.0), rng.standard_normal(20), np.ones(20)
    pulled_back = replace(TRUE, walk=0.5, relaxation_months=3.0)

    def likelihood(shift: float) -> float:
        histories = with_steps(TermHistories.of([(months, value + np.where(months > 8.0, shift, 0.0), sigma)]), [8])
        rows = histories.offsets, histories.months, TRUE.law.growth(months), histories.value, histories.sigma**2
        return log_likelihood(*rows, histories.jump, pulled_back.row)

    assert likelihood(30.0) == pytest.approx(likelihood(0.0), abs=1e-2)  # 30²/10⁶ of the step's own wide σ, and less


@pytest.fixture(scope="module")
def fleet() -> FleetTerm:
    """60 blocks, 24 monthly checks, logarithmic drift."""
    return simulate_term(TermLaw(), 60, MONTHLY[:24], 24.0 + HORIZON_MONTHS, np.random.default_rng(3))


@pytest.fixture(scope="module")
def fit(fleet: FleetTerm) -> PopulationFit:
    """The fleet's own."""
    return fit_population([fleet.histories])[0]


def test_the_fit_finds_what_was_planted(fit: PopulationFit) -> None:
    for name in ("spread", "walk", "scatter"):
        # Variances, for these are what checks measure with an error about Gaussian; of the 64 draws some thirty are
        # independent, hence Student's t, 99.9 %.
        values = np.square([getattr(draw, name) for draw in fit.draws])
        assert abs(getattr(TRUE, name) ** 2 - values.mean()) < student.isf(0.0005, 30) * values.std(), name


@pytest.mark.parametrize("law", ["linear", "growing", "saturating"])
def test_a_long_history_of_fast_drift_is_fitted_to_the_peak(law: str) -> None:
    """Five years of it: the way from any one law to the peak is a narrow one, and is not to be lost."""
    planted = TermLaw(law, spread=50.0, walk=0.05)
    rng = np.random.default_rng(12)
    axes = [simulate_term(planted, 50, np.arange(1.0, 61.0), 60.0, rng).histories for _ in range(2)]
    for sizes in best_sizes(axes):
        # Off the peak the walk takes up what the law leaves over: here at once ten times as much.
        assert sizes.walk < 3.0 * planted.walk
        assert planted.spread / 1.5 < sizes.spread < planted.spread * 1.5  # 50 rates: 1.5 is four σ


def test_the_same_histories_give_the_same_fit() -> None:
    few = simulate_term(TermLaw(), 4, MONTHLY[:6], 6.0, np.random.default_rng(4)).histories
    assert fit_population([few, few]) == fit_population([few, few])


def test_forecasts_cover_within_the_binomial_band(fleet: FleetTerm, fit: PopulationFit) -> None:
    limit = 20.0
    samples = leaving_months(fleet.histories, fit, limit, seed=0)
    truth = fleet.leaves_months(limit)
    forecasts = [leaving(row) for row in samples]
    open_ones = [k for k, one in enumerate(forecasts) if max(one.outside_now, one.beyond_horizon) < 0.9]
    inside = [
        (forecasts[k].low or 0.0) <= truth[k] <= (np.inf if forecasts[k].high is None else forecasts[k].high)
        for k in open_ones
    ]
    low, high = binom.interval(0.999, len(inside), 0.9)
    assert low <= sum(inside) <= high
    assert len(inside) > 20


def test_a_forecast_band_joins_the_history(fleet: FleetTerm, fit: PopulationFit) -> None:
    months, mean, sigma = bands(fleet.histories, fit)
    last = np.array([fleet.truth[block, np.searchsorted(fleet.truth_months, 24.0)] for block in range(60)])
    assert np.all(months[:, 0] == 24.0)
    assert np.all(np.diff(sigma, axis=1)[:, 12:] > 0.0)
    distance = (last - mean[:, 0]) / sigma[:, 0]
    assert 60 * np.mean(distance**2) < 99.6  # χ² of 60, 99.9 %


def test_intervals_open_where_the_horizon_or_the_present_cuts_them() -> None:
    months = np.arange(1.0, 101.0)
    assert leaving(months) == Leaving(50.0, 5.0, 95.0, 0.0, 0.0)
    late = np.where(months > 80.0, np.inf, months)
    assert leaving(late) == Leaving(50.0, 10.0, None, 0.0, 0.2)
    now = np.where(months <= 30.0, 0.0, months)
    assert leaving(now) == Leaving(50.0, 0.0, 90.0, 0.3, 0.0)


# ------------------------------------------------------------------ steps


def test_scores_without_a_step_raise_no_more_alarms_than_stated() -> None:
    """250 block-years at a stated rate of 0.2: 50 expected at most; the bound of theory is Poisson's."""
    rate, blocks, years = 0.2, 100, 2.5
    term = simulate_term(TermLaw(), blocks, MONTHLY[:30], 30.0, np.random.default_rng(5))
    alarms = sum(len(steps) for steps in find_steps(term.histories, TRUE, rate))
    assert alarms <= poisson.ppf(0.999, rate * blocks * years)
    # And the bound is no empty promise: far fewer would mean thresholds that cost power for nothing.
    assert alarms >= poisson.ppf(0.001, 0.5 * rate * blocks * years)


def test_steps_are_found_where_they_are_and_measured() -> None:
    blocks, check = 40, 30
    plain = simulate_term(TermLaw(), blocks, MONTHLY, 36.0, np.random.default_rng(7))
    sizes = [6.0 * predicted_sigma(plain.histories, TRUE, block, check) for block in range(blocks)]
    shocks = tuple(Shock(block, check, size) for block, size in enumerate(sizes))
    term = simulate_term(TermLaw(), blocks, MONTHLY, 36.0, np.random.default_rng(7), shocks)
    found = find_steps(term.histories, TRUE, 0.01 / 6.0)
    hit = [[step for step in steps if step.check == check] for steps in found]
    assert sum(len(steps) == 1 for steps in hit) >= blocks - 2
    assert all(step.found_at <= check + 2 for steps in hit for step in steps)
    distance = np.array([(steps[0].size - sizes[k]) / steps[0].sigma for k, steps in enumerate(hit) if steps])
    assert np.sum(distance**2) < 86.0  # χ² of 40 and fewer, 99.9 % of 50


def test_slow_drift_however_fast_is_no_step() -> None:
    law = TermLaw(spread=300.0)
    term = simulate_term(law, 40, MONTHLY, 36.0, np.random.default_rng(8))
    sizes = Sizes(LOGARITHMIC, mean=0.0, spread=300.0, offset=1.0, walk=0.15, scatter=0.3, relaxation_months=math.inf)
    alarms = sum(len(steps) for steps in find_steps(term.histories, sizes, 0.01))
    assert alarms <= poisson.ppf(0.999, 0.01 * 40 * 3.0)


def test_the_threshold_is_below_bonferroni_and_above_a_single_test() -> None:
    from inertial.ageing_steps import _threshold

    alone, together = _threshold(5e-5, []), _threshold(5e-5, [(5e-5, 0.9)])
    assert alone == pytest.approx(norm.isf(0.25e-4), abs=1e-3)
    assert norm.isf(0.25e-4 * 20.0) < together < alone
