"""The square-root filter against textbook results and against batch least squares."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from inertial.square_root_filter import SquareRootFilter, batch_least_squares


def test_one_measurement_of_one_unknown_is_the_weighted_mean() -> None:
    estimator = SquareRootFilter(np.array([1.0]), np.array([[2.0]]))
    innovation = estimator.update(np.array([4.0]), np.array([[1.0]]), np.array([[1.0]]))
    assert estimator.mean == pytest.approx([1.0 + 4.0 / 5.0 * 3.0])
    assert estimator.covariance == pytest.approx(np.array([[4.0 / 5.0]]))
    assert innovation**2 == pytest.approx([9.0 / 5.0])
    assert estimator.chi_square == pytest.approx(9.0 / 5.0)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_filter_agrees_with_batch_to_a_millionth_of_sigma_however_wide_the_prior(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, batches = 6, 8
    prior = 10.0 ** rng.uniform(-2, 5, n)
    truth = prior * rng.standard_normal(n)
    estimator = SquareRootFilter(np.zeros(n), np.diag(prior))
    rows, targets, spreads = [], [], []
    for _ in range(batches):
        m = int(rng.integers(1, 4))
        H, sigma = rng.standard_normal((m, n)), 10.0 ** rng.uniform(-3, 0, m)
        z = H @ truth + sigma * rng.standard_normal(m)
        estimator.update(z, H, np.diag(sigma))
        rows.append(H)
        targets.append(z)
        spreads.append(sigma)
    mean, covariance = batch_least_squares(np.concatenate(targets), np.vstack(rows), np.concatenate(spreads), prior)
    sigma = np.sqrt(np.diag(covariance))
    assert np.max(np.abs(estimator.mean - mean) / sigma) < 1e-6
    assert np.allclose(estimator.covariance, covariance, rtol=1e-6, atol=1e-6 * np.outer(sigma, sigma).min())


def test_an_almost_exact_measurement_keeps_the_covariance_symmetric_and_positive() -> None:
    """Where the plain Kalman formula P − K·H·P has lost all digits."""
    estimator = SquareRootFilter(np.zeros(2), 1e6 * np.eye(2))
    for k in range(20):
        estimator.update(np.zeros(1), np.array([[1.0, 1.0 + 1e-6 * k]]), np.array([[1e-6]]))
    eigenvalues = np.linalg.eigvalsh(estimator.covariance)
    assert eigenvalues[0] > 0.0
    assert np.array_equal(estimator.covariance, estimator.covariance.T)


def test_innovations_are_white_and_of_unit_variance() -> None:
    rng = np.random.default_rng(5)
    truth = rng.standard_normal(3)
    estimator = SquareRootFilter(np.zeros(3), np.eye(3))
    for _ in range(300):
        H = rng.standard_normal((2, 3))
        root = np.array([[0.3, 0.0], [0.2, 0.1]])
        estimator.update(H @ truth + root @ rng.standard_normal(2), H, root)
    assert chi2.ppf(0.0005, 600) < estimator.chi_square < chi2.ppf(0.9995, 600)
