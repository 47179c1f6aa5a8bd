"""The noise family of the discrepancy workflow has the spectra of processes simulated apart."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.fft import dct
from scipy.optimize import minimize, nnls
from scipy.signal import lfilter
from scipy.stats import chi2

from inertial.documents import ChannelNoise
from simulators.discrepancy.fisher_scoring import climb, top
from simulators.discrepancy.sway_ends import end_rates, turned_ends
from simulators.discrepancy.whitening import FREE_SHARE, STATED, SWAY, WIDE, Basis, cosine_basis, fit_noise
from simulators.motion import Turn

COUNT, INTERVAL_S, RECORDS = 4096, 0.01, 60


@pytest.mark.parametrize("tilted", [False, True])
def test_a_mount_that_sways_acts_on_accelerometers_by_its_angle_and_on_gyros_by_its_rate(tilted: bool) -> None:
    """Per bin the mean of RECORDS periodograms, 99.9 % of all bins.

    The angle that a record's ends are apart by is most of a rate's power below the correlation time. The mean alone is
    left out there: the family does not use it.
    """
    basis, rng = cosine_basis(COUNT, INTERVAL_S, tilted=tilted), np.random.default_rng(3)
    place = next(k for k in basis.terms(SWAY) if basis.names[k].startswith("sway 0.245"))
    decay = math.exp(-1.0 / 24.5)
    power = np.zeros(len(basis.counts))
    for _ in range(RECORDS):
        angle = lfilter([1.0], [1.0, -2.0 * decay, decay**2], rng.standard_normal(COUNT + 1001))[1000:]
        seen = angle[1:] if tilted else np.diff(angle)
        power += np.add.reduceat(dct(seen, norm="ortho") ** 2, basis.bounds[:-1])
    low = slice(0 if tilted else 1, int(np.searchsorted(basis.frequency_hz, 2.0)))  # above it leaks, too
    counted = RECORDS * basis.counts[low]
    ratio = power[low] / counted / basis.power[low, place]
    ratio /= np.average(ratio, weights=counted)
    bounds = np.array(chi2.interval(1.0 - 1e-3 / len(counted), counted)) / counted
    assert np.all((bounds[0] < ratio) & (ratio < bounds[1])), ratio


def test_a_gyro_feels_a_sway_by_its_angle_at_both_ends_and_else_far_less() -> None:
    """As above, of what is left of rates without what the first and the last angle make of them."""
    basis, rng = cosine_basis(COUNT, INTERVAL_S, ends=0.0), np.random.default_rng(4)
    decay = math.exp(-1.0 / 24.5)
    courses = end_rates(COUNT, INTERVAL_S, 0.245) * INTERVAL_S
    power = np.zeros(len(basis.counts))
    for _ in range(RECORDS):
        angle = lfilter([1.0], [1.0, -2.0 * decay, decay**2], rng.standard_normal(COUNT + 1001))[1000:]
        left = np.diff(angle) - angle[0] * courses[0] - angle[-1] * courses[1]
        power += np.add.reduceat(dct(left, norm="ortho") ** 2, basis.bounds[:-1])
    low = slice(1, int(np.searchsorted(basis.frequency_hz, 2.0)))
    expected = basis.sway(0.245, tilted=False)[low] * INTERVAL_S**2
    variance = (1.0 + decay**2) / (1.0 - decay**2) ** 3
    counted = RECORDS * basis.counts[low]
    ratio = power[low] / counted / (expected * variance)
    bounds = np.array(chi2.interval(1.0 - 1e-3 / len(counted), counted)) / counted
    assert np.all((bounds[0] < ratio) & (ratio < bounds[1])), ratio
    with_ends = cosine_basis(COUNT, INTERVAL_S).sway(0.245, tilted=False)[low] * INTERVAL_S**2
    assert expected[0] < 0.1 * with_ends[0]


@pytest.mark.parametrize("lasts_s", [2.0, 6.0])
def test_a_gyro_that_is_turned_in_a_mount_that_sways_feels_its_angle_come_back_about_another_axis(
    lasts_s: float,
) -> None:
    """A quarter turn about x at any time, of which slow coefficients hold as much as ends of an angle do: 4 σ."""
    decay, rng = math.exp(-1.0 / 24.5), np.random.default_rng(5)
    courses = end_rates(COUNT, INTERVAL_S, 0.245) * INTERVAL_S
    time_s, low, power = np.arange(COUNT) * INTERVAL_S, slice(1, 5), 0.0
    for _ in range(10 * RECORDS):
        start_s = rng.uniform(0.0, COUNT * INTERVAL_S - lasts_s)
        turn = Turn(start_s, start_s + lasts_s, 0.5 * math.pi / lasts_s, (1.0, 0.0, 0.0))
        turned = turn.rate_radps * np.clip(time_s - start_s, 0.0, lasts_s)
        angle = lfilter([1.0], [1.0, -2.0 * decay, decay**2], rng.standard_normal((2, COUNT + 1001)))[:, 1000:]
        left = np.cos(turned) * np.diff(angle[0]) + np.sin(turned) * np.diff(angle[1])
        left -= angle[0, 0] * courses[0] + angle[1, -1] * courses[1]
        power += float(np.sum(dct(left, norm="ortho")[low] ** 2))
    ends = turned_ends([turn], 0.245)
    assert ends == pytest.approx([0.0, ends[1], ends[1]])
    expected = cosine_basis(COUNT, INTERVAL_S, ends=float(ends[1])).sway(0.245, tilted=False)[low] * INTERVAL_S**2
    expected *= (1.0 + decay**2) / (1.0 - decay**2) ** 3
    assert power / (10 * RECORDS * expected.sum()) == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / (10 * RECORDS * 4)))


@pytest.mark.parametrize("stated_times", [0.5, 1.0, 2.0])
def test_noise_in_the_proportions_of_a_model_that_errs_in_its_size_is_found_at_its_size(stated_times: float) -> None:
    """A model that leaves its noise free knows its proportions: that some there is at least is in them already."""
    basis, true, under = _of_proportions(stated_times)
    found = fit_noise(basis, basis.counts * true, basis.counts, None, under)
    assert found.level == STATED
    assert found.power[1:] == pytest.approx(true[1:], rel=0.02)


def test_of_slow_noise_there_is_the_least_share_even_where_white_noise_is_far_less() -> None:
    basis, true, under = _of_proportions(1.0)
    slow = (under - under.min()) / FREE_SHARE**2
    quieter = 0.01 * (true - slow) + slow
    found = fit_noise(basis, basis.counts * quieter, basis.counts, None, under, slow=False)
    assert np.all(found.power > 0.9 * FREE_SHARE**2 * slow)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_no_variances_are_likelier_than_those_that_are_found(seed: int) -> None:
    """Neither those of the noise that was drawn, nor those that a general optimiser finds from the same start."""
    random = np.random.default_rng(seed)
    basis = cosine_basis(COUNT, INTERVAL_S)
    columns, counts = np.ascontiguousarray(basis.power[1:, basis.terms(WIDE)]), basis.counts[1:]
    columns = columns / np.median(columns, axis=0)
    there = random.random(columns.shape[1]) < 0.3
    true = np.where(there, 10.0 ** random.uniform(-2.0, 2.0, columns.shape[1]), 0.0)
    floor = np.full(len(counts), 10.0 ** random.uniform(-3.0, 0.0))
    rss = (floor + columns @ true) * random.chisquare(counts)

    def falls(variances: np.ndarray) -> float:
        power = floor + columns @ variances
        return 0.5 * float(np.sum(counts * np.log(power) + rss / power))

    start = np.full(columns.shape[1], 0.1)
    found = start.copy()
    climb(columns, rss, counts, floor, found, 0)
    peer = minimize(falls, start, method="L-BFGS-B", bounds=[(0.0, None)] * len(start))
    assert np.all(found >= 0.0)
    assert falls(found) < min(falls(true), peer.fun) + 0.01


@given(st.integers(0, 2**32 - 1), st.integers(1, 15))
@settings(max_examples=60, deadline=None, derandomize=True)
def test_the_top_of_a_parabola_is_that_of_least_squares_without_a_negative_number(seed: int, terms: int) -> None:
    """SciPy's solver of the problem as rows, of terms that are nearly alike, from the start and from the top itself."""
    random = np.random.default_rng(seed)
    likeness = random.uniform(0.0, 0.999)
    rows = likeness * random.random((40, 1)) + (1.0 - likeness) * random.random((40, terms))
    seen = rows @ np.where(random.random(terms) < 0.5, random.random(terms), 0.0) + 0.1 * random.standard_normal(40)
    peer, _ = nnls(rows, seen)
    for start in (np.zeros(terms), random.random(terms), peer):
        found = top(rows.T @ seen, rows.T @ rows, start)
        assert np.all(found >= 0.0)
        assert np.sum((rows @ found - seen) ** 2) <= np.sum((rows @ peer - seen) ** 2) + 1e-6


def _of_proportions(stated_times: float) -> tuple[Basis, np.ndarray, np.ndarray]:
    """Return a basis of a model that states noise so many times as large as it is, its power as it is, the least."""
    basis = cosine_basis(COUNT, INTERVAL_S)
    noise = ChannelNoise(white=stated_times, flicker=2.0 * stated_times, random_walk=0.1 * stated_times)
    slow = FREE_SHARE**2 * basis.stated(noise.model_copy(update={"white": 0.0}), 0.0)
    stated = basis.stated(noise, 0.0)
    return replace(basis, shape=stated, least_slow=slow), stated / stated_times**2, slow + 1e-9 * stated.min()
