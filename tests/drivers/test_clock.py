"""The block's clock against the host's: offset and skew under one-sided delays, with honest sigmas."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.clock import ClockFit, HostClock
from drivers.timebase import Timebase

SKEW = 50e-6
DELAYS = {
    "uniform": lambda rng, count: rng.uniform(0, 5e-3, count),
    "exponential": lambda rng, count: rng.exponential(5e-3, count),
}


def fitted(device_s: np.ndarray, delays_s: np.ndarray, batches: int = 300) -> ClockFit:
    """Return the fit to a clock of skew ``SKEW`` and offset 1000 s, fed in batches."""
    clock, host_s = HostClock(), 1000 + device_s * (1 + SKEW) + delays_s
    for device, host in zip(np.array_split(device_s, batches), np.array_split(host_s, batches), strict=True):
        clock.follow(device, host)
    fit = clock.fit()
    assert fit is not None
    return fit


@pytest.mark.parametrize("kind", DELAYS)
def test_50_ppm_are_found_to_1_ppm_in_60_s_with_an_honest_sigma(kind: str) -> None:
    """At 100 Hz, over 100 seeds; the normalised errors of 100 fits have a mean square within 1 ± 0.5 (3.5 σ)."""
    device_s = np.arange(6000) * 0.01
    fits = [fitted(device_s, DELAYS[kind](np.random.default_rng(seed), 6000), 30) for seed in range(100)]
    skew = np.array([fit.skew - SKEW for fit in fits])
    assert np.abs(skew).max() < 1e-6
    assert 0.5 < np.mean((skew / [fit.skew_sigma for fit in fits]) ** 2) < 1.5
    middle = np.array([fit.host_at_s - 1000 - fit.at_s * (1 + SKEW) for fit in fits])
    assert 0.5 < np.mean((middle / [fit.sigma_s for fit in fits]) ** 2) < 2.0  # its errors have exponential tails
    assert max(fit.sigma_s for fit in fits) < 20e-6
    assert fits[0].span_s == pytest.approx(60, abs=0.1)


def test_a_faster_block_is_found_more_exactly() -> None:
    """Least delays are as n⁻¹: twenty times the samples, a twentieth of the σ."""
    slow = fitted(np.arange(6000) * 0.01, DELAYS["uniform"](np.random.default_rng(0), 6000))
    fast = fitted(np.arange(120_000) / 2000, DELAYS["uniform"](np.random.default_rng(0), 120_000))
    assert fast.skew_sigma == pytest.approx(slow.skew_sigma / 20, rel=0.5)
    assert abs(fast.skew - SKEW) < 5 * fast.skew_sigma


def test_stalls_of_the_host_do_not_move_the_fit() -> None:
    rng = np.random.default_rng(3)
    delays_s = DELAYS["exponential"](rng, 6000)
    delays_s[2000:2300] += 0.4
    delays_s[5900:] += 0.1
    assert abs(fitted(np.arange(6000) * 0.01, delays_s).skew - SKEW) < 1e-6


def test_the_window_moves_and_its_memory_is_bounded() -> None:
    """A clock that changes its skew is followed, and what it did before is forgotten."""
    rng, device_s = np.random.default_rng(4), np.arange(60_000) * 0.01
    host_s = np.where(device_s < 300, device_s * (1 + SKEW), device_s * (1 - SKEW) + 600 * SKEW)
    clock = HostClock()
    for device, host in zip(np.array_split(device_s, 100), np.array_split(host_s, 100), strict=True):
        clock.follow(device, host + DELAYS["uniform"](rng, len(device)))
    fit = clock.fit()
    assert fit is not None
    assert abs(fit.skew + SKEW) < 1e-6
    assert fit.span_s <= 120.5


def test_a_line_gives_host_times_and_a_restarted_clock_is_another() -> None:
    device_s = np.arange(6000) * 0.01
    clock = HostClock()
    clock.follow(device_s, device_s * (1 + SKEW) + 1000)
    fit = clock.fit()
    assert fit is not None
    assert fit.host_time_s(device_s) == pytest.approx(1000 + device_s * (1 + SKEW), abs=1e-6)
    assert fit.offset_s == pytest.approx(1000, abs=1e-6)
    clock.restart()
    assert clock.fit() is None
    clock.follow(device_s, device_s + 5000)
    fit = clock.fit()
    assert fit is not None
    assert fit.offset_s == pytest.approx(5000, abs=1e-6)


def test_too_little_says_nothing() -> None:
    clock = HostClock()
    assert clock.fit() is None
    clock.follow(np.array([0.0, 1.0]), np.array([5.0, 6.0]))
    assert clock.fit() is None


def test_simulated_time_runs_at_its_speed_from_a_shared_epoch() -> None:
    fast = Timebase(50.0, epoch_s=0.0)
    slow = Timebase(1.0, epoch_s=0.0)
    before, now, after = slow.now_s(), fast.now_s(), slow.now_s()
    assert 50 * before <= now <= 50 * after
    assert fast.real_s(5.0) == 0.1


def test_no_limit_is_shorter_than_what_the_host_needs() -> None:
    assert Timebase(1.0).limit_s(0.5) == 0.5
    assert Timebase(50.0).limit_s(0.5) == 20.0  # 0.4 s of a loaded host's time


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_speeds_are_refused(speed: float) -> None:
    with pytest.raises(ValueError, match="speed"):
        Timebase(speed)
