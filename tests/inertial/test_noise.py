"""Noise identification on records made without its code: values, honesty of the intervals, and real channels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

from inertial.allan import overlapping_allan
from inertial.noise import NoiseFit, identify_noise, noise_of_block

Array = NDArray[np.float64]
INTERVAL_S = 0.01
TERMS = ("quantisation", "white", "flicker", "random_walk", "ramp")


def one_over_f(rng: np.random.Generator, n: int) -> Array:
    """Two-sided spectrum 1/(2πf): a piece of a periodic record eight times as long."""
    length = 8 * n
    frequency = np.fft.rfftfreq(length, INTERVAL_S)
    amplitude = np.zeros(frequency.size)
    amplitude[1:] = np.sqrt(length / (2.0 * np.pi * frequency[1:] * INTERVAL_S))
    normal = rng.standard_normal((2, frequency.size)) / np.sqrt(2.0)
    return np.asarray(np.fft.irfft(amplitude * (normal[0] + 1j * normal[1]), length)[:n])


def record(seed: int, n: int, mean: float = 0.0, **planted: float) -> Array:
    """Readings of a channel with the planted terms, from the definition of each."""
    rng = np.random.default_rng(seed)
    rate = mean + planted.get("ramp", 0.0) * INTERVAL_S * np.arange(n)
    rate += planted.get("white", 0.0) / np.sqrt(INTERVAL_S) * rng.standard_normal(n)
    rate += planted.get("random_walk", 0.0) * np.sqrt(INTERVAL_S) * np.cumsum(rng.standard_normal(n))
    if "flicker" in planted:
        rate += planted["flicker"] * one_over_f(rng, n)
    if step := planted.get("quantisation", 0.0):
        angle = np.concatenate([[0.0], np.cumsum(rate * INTERVAL_S)]) + rng.uniform(0.0, step)
        rate = np.diff(np.round(angle / step)) * step / INTERVAL_S
    return rate


FULL = {"quantisation": 1e-4, "white": 1e-3, "flicker": 2e-3, "random_walk": 1e-3, "ramp": 5e-4}


@pytest.mark.parametrize(
    ("planted", "runs", "n"),
    [
        (FULL, 40, 60_000),
        ({"white": 1e-3, "quantisation": 1e-4}, 80, 6_000),
        ({"white": 1e-3, "random_walk": 3e-3}, 80, 6_000),
        ({"white": 1e-3, "flicker": 3e-3}, 60, 16_000),
        # steps of ten times the random motion: rounding errors far from white
        ({"white": 1e-4, "quantisation": 1e-4, "mean": 0.0137}, 80, 8_000),
    ],
    ids=["all five", "quantised", "random walk", "flicker", "coarse"],
)
def test_planted_parameters_lie_inside_their_interval_as_often_as_it_says(
    planted: dict[str, float], runs: int, n: int
) -> None:
    fits = [identify_noise(record(seed, n, **planted), INTERVAL_S) for seed in range(runs)]
    for term in TERMS:
        found = [getattr(fit, term) for fit in fits]
        truth = planted.get(term, 0.0)
        seen = [value for value in found if value.seen]
        if truth == 0.0:
            # three σ, one-sided, with five terms watched: a handful of records at most
            assert len(seen) <= binom.ppf(0.999, runs, 0.005), term
            continue
        assert len(seen) >= 0.6 * runs, term
        inside = sum(low <= truth <= high for low, high in (value.interval95 for value in seen))
        assert inside >= binom.ppf(0.0005, len(seen), 0.95), term
        # and the intervals are no wider than the estimates' scatter calls for
        scatter = np.std([value.value for value in seen])
        assert np.median([value.sigma for value in seen]) <= 1.6 * scatter + 3e-6 * truth, term


def test_absent_terms_are_not_seen() -> None:
    runs = 80
    fits = [identify_noise(record(1000 + seed, 4_000, white=1e-3), INTERVAL_S) for seed in range(runs)]
    for term in ("quantisation", "flicker", "random_walk", "ramp"):
        seen = sum(getattr(fit, term).seen for fit in fits)
        assert seen <= binom.ppf(0.999, runs, 0.00135), term
        reached = sum(getattr(fit, term).interval95[0] <= 0.0 <= getattr(fit, term).interval95[1] for fit in fits)
        assert reached >= binom.ppf(0.0005, runs, 0.95), term
    assert all(fit.white.seen for fit in fits)


@pytest.fixture(scope="module")
def full_fit() -> tuple[Array, NoiseFit]:
    rate = record(5, 100_000, **FULL)
    return rate, identify_noise(rate, INTERVAL_S)


def test_fitted_terms_predict_the_allan_curve(full_fit: tuple[Array, NoiseFit]) -> None:
    rate, fit = full_fit
    curve = overlapping_allan(rate, INTERVAL_S, np.geomspace(1, 5000, 20).astype(int))
    low, high = curve.interval(0.999)
    predicted = fit.allan_deviation(curve.averaging_s)
    assert np.all((low <= predicted) & (predicted <= high))


def test_flicker_is_defined_by_its_allan_floor() -> None:
    rate = record(6, 200_000, flicker=1e-3)
    middle = overlapping_allan(rate, INTERVAL_S, [100]).deviation[0]
    assert middle == pytest.approx(0.664e-3, rel=0.05)
    assert identify_noise(rate, INTERVAL_S).flicker.value == pytest.approx(1e-3, rel=0.03)


def test_values_scale_with_unit_and_interval(full_fit: tuple[Array, NoiseFit]) -> None:
    rate, fit = full_fit
    scaled = identify_noise(1e-6 * rate, 4.0 * INTERVAL_S)
    for term, power in zip(TERMS, (1.0, 0.5, 0.0, -0.5, -1.0), strict=True):
        assert getattr(scaled, term).value == pytest.approx(1e-6 * 4.0**power * getattr(fit, term).value, rel=1e-3)


def test_a_constant_part_and_a_large_ramp_do_not_disturb_the_noise() -> None:
    rate = record(7, 20_000, white=1e-3, quantisation=0.0)
    plain = identify_noise(rate, INTERVAL_S)
    moved = identify_noise(9.81 + rate + 1e-2 * INTERVAL_S * np.arange(rate.size), INTERVAL_S)
    assert moved.white.value == pytest.approx(plain.white.value, rel=1e-6)
    assert moved.ramp.value == pytest.approx(1e-2 + plain.ramp.value, rel=1e-3)


def test_a_long_record_goes_in_two_bands_with_the_same_result() -> None:
    planted = {"white": 1e-3, "quantisation": 1e-4, "random_walk": 1e-4}
    fit = identify_noise(record(8, 2_500_000, **planted), INTERVAL_S)
    for term, truth in planted.items():
        found = getattr(fit, term)
        assert found.seen
        assert abs(found.value - truth) < 4.0 * found.sigma
        assert found.sigma < 0.1 * truth
    assert fit.misfit == pytest.approx(1.0, abs=0.5)


def test_a_resonance_does_not_pass_for_noise_at_other_frequencies() -> None:
    rate = record(9, 30_000, white=1e-3)
    sway = record(10, 30_000, white=0.1)
    # a resonance at 2 Hz, a fifth of a hertz wide, a hundred times above the floor there
    transform = np.fft.rfft(sway)
    frequency = np.fft.rfftfreq(sway.size, INTERVAL_S)
    swaying = rate + np.fft.irfft(transform * np.exp(-0.5 * ((frequency - 2.0) / 0.1) ** 2), sway.size)
    fit = identify_noise(swaying, INTERVAL_S)
    assert fit.misfit > 5.0
    assert fit.white.value == pytest.approx(1e-3, rel=0.3)
    assert not fit.random_walk.seen
    block = noise_of_block(*[np.column_stack([rate, swaying, rate])] * 2, INTERVAL_S)
    # what was set aside is not lost: as angle noise it moves the integral as far
    angle = np.std(np.cumsum(swaying - rate) * INTERVAL_S)
    assert block.gyro_y.quantisation / np.sqrt(12.0) == pytest.approx(angle, rel=0.1)


def test_a_live_channel_never_gets_less_white_noise_than_it_has() -> None:
    # laser-gyro grade: the readout's step is eight times the random motion between samples
    columns = [
        record(seed, 18_000, mean, white=6e-7, quantisation=4.85e-7) for seed, mean in enumerate((0.0, 4e-5, 1e-5))
    ]
    for found in dict(noise_of_block(np.column_stack(columns), np.column_stack(columns), INTERVAL_S)).values():
        if found is not False:
            assert 0.8 * 6e-7 < found.white < 3.0 * 6e-7
            assert found.quantisation == pytest.approx(4.85e-7, rel=0.3)


def test_stuck_channels_have_no_noise_to_find() -> None:
    stuck = np.column_stack([np.full(1000, 1.25), np.zeros(1000), record(1, 1000, white=1e-3)])
    found = noise_of_block(stuck, stuck, INTERVAL_S)
    assert found.accel_x.white == found.accel_y.white == 0.0
    assert found.accel_z.white > 0.0
    with pytest.raises(ValueError, match="all readings are equal"):
        identify_noise(stuck[:, 0], INTERVAL_S)


@pytest.mark.parametrize("name", ["rlg_vehicle_quiet", "rlg_vehicle_disturbed"])
def test_a_real_block_in_a_swaying_vehicle(shared_data: Path, name: str) -> None:
    table = pq.read_table(shared_data / "recordings" / f"{name}.parquet")
    rates = np.column_stack([table[column].to_numpy() / INTERVAL_S for column in table.column_names[1:]])
    for span in (slice(0, 10_000), slice(0, 30_000)):
        found = noise_of_block(rates[span, :3], rates[span, 3:], INTERVAL_S)
        for channel, column in zip(("gyro_x", "gyro_y", "gyro_z"), rates[span, 3:].T, strict=True):
            noise = getattr(found, channel)
            # 0.1 arcsec steps; no more white noise than all the scatter there is
            assert noise.quantisation >= 4.8e-7
            assert 1e-7 < noise.white < np.std(column) * np.sqrt(INTERVAL_S)
    if name == "rlg_vehicle_quiet":
        # the vertical channel is the quietest: below 0.05 Hz its spectrum lies at 9e-5 m/s²/√Hz
        assert 2e-5 < found.accel_z.white < 2e-4


@pytest.mark.parametrize(
    ("rate", "interval_s", "said"),
    [
        (np.zeros((100, 3)), 0.01, r"\(n,\)"),
        (np.zeros(10), 0.01, "too few"),
        (np.arange(100.0), 0.0, "interval"),
        (np.append(np.arange(99.0), np.nan), 0.01, "NaN"),
    ],
)
def test_what_cannot_be_identified_is_refused_with_the_reason(rate: Array, interval_s: float, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        identify_noise(rate, interval_s)
