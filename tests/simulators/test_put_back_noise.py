"""Noise that stands for what a vibration hid along its axis: as large as at rest, no less and no more."""

from __future__ import annotations

from dataclasses import replace

import closed_form
import numpy as np
import pytest
from scipy.stats import chi2

from drivers.recording import Recording, RecordingMeta
from simulators.discrepancy.compare import compare
from simulators.discrepancy.unsteady import level_spread

RATE_HZ, WHITE = closed_form.RATE_HZ, closed_form.WHITE["accel"]
FIRST, LAST = round(60.0 * RATE_HZ), round(160.0 * RATE_HZ)
BLOCK, RUNS = round(0.5 * RATE_HZ), 12


def shaken(seed: int, times: float) -> Recording:
    """Return a recording at rest, shaken by turns along z, with noise so many times what is stated."""
    rng = np.random.default_rng([seed, 1])

    def change(_: closed_form.Truth, readings: np.ndarray) -> None:
        readings[:, 2] += np.sqrt(times**2 - 1.0) * WHITE * np.sqrt(RATE_HZ) * rng.standard_normal(len(readings))
        readings[FIRST:LAST, 2] += np.resize([1.0, -1.0], LAST - FIRST)

    case = closed_form.recording(change, seed, moving=False)
    span = {"kind": "vibration", "start_s": 60.0, "end_s": 160.0, "grms": 0.1, "band_hz": [5.0, 15.0]}
    meta = {**case.meta.model_dump(exclude_none=True), "motion": [{**span, "axis": [0.0, 0.0, 1.0]}]}
    return replace(case, meta=RecordingMeta.model_validate(meta))


def slow_power(recording: Recording) -> float:
    """Return the variance of half-second means while it is shaken, over that of white noise as stated."""
    residual, _ = level_spread(compare(recording, closed_form.model()), 2)
    hidden = residual[FIRST:LAST].reshape(-1, BLOCK).mean(axis=1)
    return float(np.var(hidden, ddof=1) * BLOCK / RATE_HZ / WHITE**2)


@pytest.mark.parametrize("times", [1.0, 2.0])
def test_it_is_as_large_as_at_rest_and_as_certain_as_the_whole_band_makes_it(times: float) -> None:
    """One draw stands for all, whose size χ² bounds; from record to record a level of 2800 samples is off by 5 %.

    So that a model which states the noise is taken at its word where the record agrees.
    """
    power = np.array([slow_power(shaken(seed, times)) for seed in range(RUNS)]) / times**2
    blocks = (LAST - FIRST) // BLOCK
    low, high = chi2.interval(0.999, blocks - 1)
    assert low / (blocks - 1) < power.mean() < high / (blocks - 1)
    off = np.log(power / power.mean())
    assert np.sqrt(np.mean(off**2)) < 0.05 * np.sqrt(chi2.ppf(0.999, RUNS - 1) / (RUNS - 1))


@pytest.mark.parametrize("hertz", [3.7, 8.0])
def test_a_line_at_rest_is_put_back_as_no_noise(hertz: float) -> None:
    case = shaken(3, 1.0)
    samples = case.samples.copy()
    samples["dv"][:, 2] += 30.0 * WHITE / np.sqrt(RATE_HZ) * np.sin(2.0 * np.pi * hertz * samples["time"])
    hidden = []
    for one in (case, replace(case, samples=samples)):
        residual, _ = level_spread(compare(one, closed_form.model()), 2)
        hidden.append(float(np.var(residual[FIRST:LAST])))
    assert hidden[1] < 1.1 * hidden[0]
