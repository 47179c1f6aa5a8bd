"""Noise processes against the theory of their Allan variances (IEEE 952, annex C)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import chi2

from simulators.noise import Flicker, Quantiser, RateRandomWalk, White, generator

T = 0.01
CHANNELS = 6
MAKE: list[Callable[[int], White | Flicker | RateRandomWalk]] = [
    lambda seed: White(np.ones(CHANNELS), T, generator(seed)),
    lambda seed: Flicker(np.ones(CHANNELS), T, generator(seed)),
    lambda seed: RateRandomWalk(np.ones(CHANNELS), T, generator(seed)),
]


def assert_chi_square(values: np.ndarray, variance: float, tolerance: float = 0.0) -> None:
    """Independent zero-mean Gaussian ``values`` have this variance, at 1e-6 false alarms."""
    low, high = chi2.ppf([5e-7, 1 - 5e-7], values.size) / values.size
    assert low * (1 - tolerance) < np.mean(values**2) / variance < high * (1 + tolerance)


@pytest.mark.parametrize("make", MAKE)
def test_noise_does_not_depend_on_the_chunks_it_is_drawn_in(make: Callable[[int], White]) -> None:
    whole = make(1).increments(1000)
    process = make(1)
    assert np.array_equal(whole, np.concatenate([process.increments(n) for n in (1, 2, 13, 384, 600)]))


@pytest.mark.parametrize("make", MAKE)
def test_another_seed_is_other_noise(make: Callable[[int], White]) -> None:
    correlation = np.corrcoef(make(1).increments(5000)[:, 0], make(2).increments(5000)[:, 0])[0, 1]
    first, second = make(1).increments(50), make(2).increments(50)
    assert not np.any(first == second)
    if make is MAKE[0]:
        assert abs(correlation) < 5 / math.sqrt(5000)


def test_white_noise_has_the_variance_of_its_random_walk() -> None:
    rows = White(3e-4 * np.ones(CHANNELS), T, generator(3)).increments(100_000)
    assert_chi_square(rows.ravel(), 9e-8 * T)
    # The random walk itself after 10 s: N²·t.
    assert_chi_square(rows.reshape(-1, 1000, CHANNELS).sum(axis=1).ravel(), 9e-8 * 10.0)


def test_rate_random_walk_has_its_allan_variance() -> None:
    rate = RateRandomWalk(2e-3 * np.ones(CHANNELS), T, generator(4)).increments(400_000) / T
    for m in (1, 10, 1000):
        mean = rate.reshape(-1, m, CHANNELS).mean(axis=1)
        # Differences over spans that do not meet are independent; half their square is the Allan variance K²τ/3.
        assert_chi_square((mean[1::2] - mean[::2]).ravel(), 2 * 4e-6 * m * T / 3)


@pytest.mark.parametrize("m", [10, 100, 1000, 4000])
def test_flicker_has_a_flat_allan_deviation_of_0_664_b(m: int) -> None:
    rate = Flicker(2e-7 * np.ones(CHANNELS), T, generator(5)).increments(400_000) / T
    mean = rate.reshape(-1, m, CHANNELS).mean(axis=1)
    # Such differences of flicker are almost independent; the sum of processes follows 1/f within 2 %.
    assert_chi_square((mean[1::2] - mean[::2]).ravel(), 2 * (2 * math.log(2) / math.pi) * 4e-14, tolerance=0.03)


def test_flicker_starts_in_its_steady_state() -> None:
    channels = 20_000
    process = Flicker(np.ones(channels), 1.0, generator(6))
    first = process.increments(1)[0]
    later = process.increments(40)[-1]
    assert np.var(first) == pytest.approx(np.var(later), rel=6 * math.sqrt(2 / channels))


def test_quantised_increments_are_differences_of_the_rounded_sum() -> None:
    step = np.array([0.25, 0.0, 1e-3])
    increments = np.random.default_rng(7).normal(0.1, 0.4, (5000, 3))
    rounded = increments.copy()
    quantiser = Quantiser(step)
    quantiser.quantise(rounded[:17])
    quantiser.quantise(rounded[17:])
    for c in (0, 2):
        expected = np.diff(np.rint(np.cumsum(increments[:, c]) / step[c]) * step[c], prepend=0.0)
        # Two ways of summing may round a half to different sides.
        assert np.mean(np.abs(rounded[:, c] - expected) < 1e-9) > 0.999
        assert np.max(np.abs(np.cumsum(rounded[:, c]) - np.cumsum(increments[:, c]))) <= step[c] * 0.5 + 1e-9
        assert np.array_equal(rounded[:, c], np.rint(rounded[:, c] / step[c]) * step[c])
    assert np.array_equal(rounded[:, 1], increments[:, 1])
