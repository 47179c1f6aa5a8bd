"""The true rate against the host's clock: found when it is wrong, never when the host is late."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.rate_check import RateCheck
from drivers.samples import SampleArray, Status, empty_samples


def stream(count: int, rate_hz: float) -> SampleArray:
    """Return samples whose own clock runs at ``rate_hz``."""
    samples = empty_samples(count)
    samples["sequence"] = np.arange(count)
    samples["time"] = np.arange(count) / rate_hz
    return samples


def feed(check: RateCheck, samples: SampleArray, host_s: np.ndarray, together: int = 37) -> None:
    for start in range(0, len(samples), together):
        check.follow(samples[start : start + together], host_s[start : start + together])


@pytest.mark.parametrize(
    ("off", "found"), [(0.0, False), (0.0005, False), (-0.0005, False), (0.0015, True), (-0.0015, True), (0.0376, True)]
)
@pytest.mark.parametrize("delays", ["uniform", "exponential"])
def test_a_discrepancy_above_a_thousandth_is_found(off: float, found: bool, delays: str) -> None:
    samples, rng = stream(60_00, 100.0), np.random.default_rng(1)
    late_s = rng.uniform(0, 0.005, 6000) if delays == "uniform" else rng.exponential(0.005, 6000)
    check = RateCheck()
    feed(check, samples, samples["time"] * (1 + off) + late_s)
    # The least of a window's 100 delays is uniform's within 0.05 ms ± 0.05, so that a drift over 1 s is known to
    # 0.07 ms and the median of sixty to 0.012 ms: 1e-5.
    assert check.discrepancy == pytest.approx(off, abs=5e-5)
    assert bool(check.condition) == found


def test_a_stated_rate_is_checked_where_the_device_has_no_clock() -> None:
    samples = stream(20_000, 962.4)
    check = RateCheck(stated_rate_hz=1000.0)
    feed(check, samples, samples["time"] + 5.0)
    assert check.condition == Status.WRONG_RATE
    assert check.discrepancy == pytest.approx(1000 / 962.4 - 1, abs=1e-6)


def test_stalls_losses_and_bursts_are_no_wrong_rate() -> None:
    samples, rng = stream(12_000, 100.0), np.random.default_rng(2)
    host_s = samples["time"] + rng.uniform(0, 0.003, 12_000)
    for start in range(500, 12_000, 1500):  # the host stands still for half a second and then reads all
        host_s[start : start + 50] = host_s[start + 50]
    host_s[6000:] += 0.3  # the device's clock slipped once
    kept = np.concatenate([np.arange(0, 3000), np.arange(3400, 12_000)])
    check = RateCheck()
    feed(check, samples[kept], host_s[kept])
    assert not check.condition


@pytest.mark.parametrize("together", [1, 10, 6000])
def test_the_answer_does_not_depend_on_how_samples_are_gathered(together: int) -> None:
    samples = stream(6000, 100.0)
    host_s = samples["time"] * 1.002 + np.random.default_rng(3).uniform(0, 0.005, 6000)
    reference, check = RateCheck(), RateCheck()
    feed(reference, samples, host_s)
    feed(check, samples, host_s, together)
    assert check.discrepancy == reference.discrepancy != 0.0


def test_a_restart_begins_anew_and_no_host_time_tells_nothing() -> None:
    check = RateCheck()
    samples = stream(3000, 100.0)
    feed(check, np.concatenate([samples, samples]), np.concatenate([samples["time"], 100 + samples["time"]]))
    assert not check.condition
    timeless = RateCheck()
    feed(timeless, samples, np.zeros(3000))
    assert (timeless.discrepancy, timeless.condition) == (0.0, Status(0))
