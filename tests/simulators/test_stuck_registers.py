"""A coarse readout repeats values by itself; a register that stands still does not carry on what it rounds off."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from closed_form import RATE_HZ, model, recording

from drivers.recording import Recording
from simulators.discrepancy.compare import compare
from simulators.discrepancy.standing import find_stuck

STEP_MPS = 1.5e-4  # the noise of a sample is 0.3 of it


def coarse(case: Recording, *, mean_steps: float) -> Recording:
    """Return the recording with accel_x read in whole steps, what was rounded off carried on to the next sample."""
    samples = case.samples.copy()
    rates = samples["dv"][:, 0] - samples["dv"][:, 0].mean() + mean_steps * STEP_MPS
    total = np.rint(np.cumsum(rates) / STEP_MPS)
    samples["dv"][:, 0] = np.diff(total, prepend=0.0) * STEP_MPS
    return dataclasses.replace(case, samples=samples)


@pytest.mark.parametrize("mean_steps", [7.0, 7.02, 7.3, 7.5])
def test_repeats_by_rounding_are_no_stuck_register(mean_steps: float) -> None:
    for seed in range(5):
        case = coarse(recording(None, seed, moving=False), mean_steps=mean_steps)
        runs = np.diff(np.flatnonzero(np.diff(case.samples["dv"][:, 0]) != 0.0))
        assert runs.max() >= 6  # as short as a stuck register may be: there is something to be fooled by
        assert find_stuck(compare(case, model()))[1] == []


def test_zeros_of_a_small_input_that_comes_and_goes_are_no_stuck_register() -> None:
    """A vehicle that people lean on: a coarse readout is at zero for a second now and then, as often before."""
    for seed in range(5):
        case = recording(None, 60 + seed, moving=False)
        samples, rng = case.samples, np.random.default_rng(seed)
        lean = np.full(len(samples), 0.8)
        for first in range(150, 4600, 350):
            lean[first : first + rng.integers(20, 36)] = 0.0
        total = np.rint(np.cumsum(lean + 0.3 * rng.standard_normal(len(samples))))
        samples["dv"][:, 0] = np.diff(total, prepend=0.0) * STEP_MPS
        assert find_stuck(compare(case, model()))[1] == []


@pytest.mark.parametrize("mean_steps", [7.0, 7.4, 0.38])
def test_a_register_that_stands_still_is_found_where_it_stands(mean_steps: float) -> None:
    case = coarse(recording(None, 9, moving=False), mean_steps=mean_steps)
    first = int(np.flatnonzero(case.samples["dv"][2000:, 0] < 7.5 * STEP_MPS)[0]) + 2001
    count = 120
    case.samples["dv"][first : first + count, 0] = case.samples["dv"][first - 1, 0]
    scene, found = find_stuck(compare(case, model()))
    assert [one.channel for one in found] == ["accel_x"]
    # Neighbours may by chance have the same value and belong to the run.
    assert found[0].start_s == pytest.approx(first / RATE_HZ, abs=10 / RATE_HZ)
    assert found[0].duration_s == pytest.approx(count / RATE_HZ, abs=20 / RATE_HZ)
    assert scene.data.missing[first : first + count, 0].all()
    assert not scene.data.missing[:, 1:].any()


def test_a_knock_that_some_readings_share_is_no_stuck_register_at_rest() -> None:
    """Steps so coarse that the noise never shows: five readings a step up now and then, as somebody walks past."""
    case = recording(None, 12, moving=False)
    step = 100.0 * STEP_MPS
    case.samples["dv"][:, 0] = 80.0 * step
    for first in range(200, 4600, 400):
        case.samples["dv"][first : first + 5, 0] += step
    assert find_stuck(compare(case, model()))[1] == []
