"""The walk that is pulled back: how it goes on, that histories tell of it, and that forecasts then cover."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from inertial.ageing import fit_population
from inertial.ageing_filter import pulled
from inertial.ageing_forecast import HORIZON_MONTHS, leaving, leaving_months
from simulators.fleet import TermLaw, simulate_term

CHECKS = np.arange(1.0, 37.0)


@pytest.mark.parametrize("rate", [0.0, 1e-9, 0.1, 5.0])
def test_two_spans_after_one_another_are_one(rate: float) -> None:
    """Chapman and Kolmogorov: what came first is pulled back by what is left after the second."""
    (left, came), (later, more) = pulled(2.0, rate), pulled(5.0, rate)
    assert pulled(7.0, rate) == pytest.approx((left * later, came * later**2 + more), rel=1e-12)


def test_without_a_pull_the_walk_is_free_and_with_one_it_settles() -> None:
    assert pulled(7.0, 0.0) == (1.0, 7.0)
    assert pulled(1e4, 0.25) == pytest.approx((0.0, 1.0 / (2.0 * 0.25)))


def test_histories_that_tell_of_a_pull_are_heard() -> None:
    """Three years of a walk that is three σ a √month: within some months, or free."""
    for planted, low, high in ((6.0, 3.0, 12.0), (None, 24.0, np.inf)):
        law = TermLaw(spread=3.0, walk=3.0, relaxation_months=planted)
        term = simulate_term(law, 60, CHECKS, 36.0, np.random.default_rng(21))
        draws = fit_population([term.histories])[0].draws
        assert low < np.median([draw.relaxation_months for draw in draws]) < high


def test_a_walk_pulled_back_is_covered_within_the_binomial_band() -> None:
    """Where the walk says as much of what comes as the drift."""
    rng, limit = np.random.default_rng(22), 20.0
    law = TermLaw(spread=10.0, walk=3.0, relaxation_months=6.0)
    term = simulate_term(law, 100, CHECKS, CHECKS[-1] + HORIZON_MONTHS, rng)
    found = [leaving(row) for row in leaving_months(term.histories, fit_population([term.histories])[0], limit, 0)]
    open_ones = [k for k, one in enumerate(found) if max(one.outside_now, one.beyond_horizon) < 0.9]
    truth = term.leaves_months(limit)
    highs = [np.inf if found[k].high is None else found[k].high for k in open_ones]
    inside = [(found[k].low or 0.0) <= truth[k] <= high for k, high in zip(open_ones, highs, strict=True)]
    low, high = binom.interval(0.999, len(inside), 0.9)
    assert len(inside) > 30
    assert low <= sum(inside) <= high
