"""Covariance of integrated noise against brute-force sums and the Allan floor that defines the terms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from inertial.documents import ChannelNoise
from inertial.increment_covariance import integral_covariance

SPANS = np.array([[0.0, 1.0], [1.0, 2.5], [4.0, 4.5], [60.0, 61.0]])


def test_white_noise_is_density_times_overlap() -> None:
    found = integral_covariance(ChannelNoise(white=3.0), SPANS, np.array([[0.5, 4.25]]))
    np.testing.assert_allclose(found[:, 0], 9.0 * np.array([0.5, 1.5, 0.25, 0.0]))


@pytest.mark.parametrize("averaging_s", [0.01, 1.0, 30.0])
def test_flicker_has_its_allan_floor(averaging_s: float) -> None:
    spans = np.array([[0.0, 1.0], [1.0, 2.0]]) * averaging_s
    covariance = integral_covariance(ChannelNoise(flicker=2.0), spans) / averaging_s**2
    difference = np.array([1.0, -1.0])
    # Finite longest relaxation: the floor is short of 2 ln 2/π·B² by O(τ/longest).
    allan = 0.5 * difference @ covariance @ difference
    assert allan == pytest.approx(2.0 * math.log(2.0) / math.pi * 4.0, rel=5e-3)


def test_random_walk_by_summing_its_steps() -> None:
    step, reference = 0.01, 10.0
    middle = np.arange(0.0, 20.0, step) + step / 2.0
    # Walk from the instant of reference, both ways: x(t) = ∫ of white noise between the reference and t.
    steps = np.where(
        middle[:, None] > reference,
        (middle[None, :] > reference) & (middle[None, :] < middle[:, None]),
        (middle[None, :] < reference) & (middle[None, :] > middle[:, None]),
    )
    spans = np.array([[2.0, 3.0], [3.0, 9.0], [9.5, 10.0], [10.0, 12.0], [15.0, 16.0]])
    integrals = np.array([((middle > a) & (middle < b)).astype(float) @ steps * step for a, b in spans])
    expected = 4.0 * integrals @ integrals.T * step
    found = integral_covariance(ChannelNoise(random_walk=2.0), spans, reference_s=reference)
    np.testing.assert_allclose(found, expected, atol=0.01 * expected.max())


def test_quantisation_is_shared_at_common_edges() -> None:
    spans = np.array([[0.0, 1.0], [1.0, 2.0], [3.0, 4.0]])
    found = integral_covariance(ChannelNoise(quantisation=math.sqrt(12.0)), spans)
    np.testing.assert_allclose(found, [[2.0, -1.0, 0.0], [-1.0, 2.0, 0.0], [0.0, 0.0, 2.0]])


def test_all_together_is_a_covariance() -> None:
    noise = ChannelNoise(white=1e-3, flicker=1.0, random_walk=0.1, quantisation=0.01)
    spans = np.column_stack([np.arange(300.0), np.arange(300.0) + 1.0])
    assert np.linalg.eigvalsh(integral_covariance(noise, spans, reference_s=150.0)).min() > 0.0
