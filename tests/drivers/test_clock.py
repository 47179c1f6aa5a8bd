"""Device clocks that wrap, and those that begin anew."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.clock import WrappingCounter, host_offset_s
from drivers.timebase import Timebase

TICK_S = 0.001
MODULUS = 1000


def test_wraps_are_undone_across_batches() -> None:
    counter = WrappingCounter(MODULUS, TICK_S)
    true = np.arange(0, 12_000, 10)
    out = [counter.unwrap(part % MODULUS, part * TICK_S) for part in np.array_split(true, 7)]
    assert np.array_equal(np.concatenate([part.ticks for part in out]), true)
    assert not any(part.restarts for part in out)


@pytest.mark.parametrize("lost", [990, 1000, 1010, 5000, 5300])
def test_lost_whole_periods_do_not_pass_unseen(lost: int) -> None:
    true = np.concatenate([np.arange(0, 500, 10), np.arange(490 + lost, 1500 + lost, 10)])
    late_s = np.random.default_rng(1).uniform(0, 0.05, len(true))
    unwrapped = WrappingCounter(MODULUS, TICK_S).unwrap(true % MODULUS, true * TICK_S + late_s)
    assert np.array_equal(unwrapped.ticks, true)
    assert unwrapped.restarts == []


def test_a_restart_is_told_from_a_wrap() -> None:
    counts = np.concatenate([np.arange(0, 700, 10), np.arange(0, 300, 10)])
    host_s = np.arange(len(counts)) * 0.01
    unwrapped = WrappingCounter(MODULUS, TICK_S).unwrap(counts, host_s)
    assert unwrapped.restarts == [70]
    assert np.all(np.diff(unwrapped.ticks) > 0)


def test_a_counter_that_wraps_too_fast_to_prove_a_restart_claims_none() -> None:
    counter = WrappingCounter(256, 0.0005)  # 0.128 s
    unwrapped = counter.unwrap(np.array([0, 16, 32, 240, 0, 16]), np.array([0, 0.008, 0.3, 0.31, 0.32, 0.33]))
    assert unwrapped.restarts == []
    assert unwrapped.ticks.tolist() == [0, 16, 32, 240, 256, 272]


def test_offset_is_that_of_the_least_delay() -> None:
    rng = np.random.default_rng(2)
    device_s = np.arange(1000) * 0.01
    host_s = device_s + 100 + rng.exponential(0.005, 1000)
    # The least of 1000 exponential delays of mean 5 ms is exponential with mean 5 µs: above 60 µs once in 160,000.
    assert 0 <= host_offset_s(device_s, host_s) - 100 < 60e-6


def test_simulated_time_runs_at_its_speed_from_a_shared_epoch() -> None:
    fast = Timebase(50.0, epoch_s=0.0)
    slow = Timebase(1.0, epoch_s=0.0)
    before, now, after = slow.now_s(), fast.now_s(), slow.now_s()
    assert 50 * before <= now <= 50 * after
    assert fast.real_s(5.0) == 0.1


def test_no_limit_is_shorter_than_what_the_host_needs() -> None:
    assert Timebase(1.0).limit_s(0.5) == 0.5
    assert Timebase(50.0).limit_s(0.5) == 5.0


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_speeds_are_refused(speed: float) -> None:
    with pytest.raises(ValueError, match="speed"):
        Timebase(speed)
