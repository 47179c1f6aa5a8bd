"""Stamps that a host puts on as frames arrive scatter; the block's own sampling does not, or it does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_form import RATE_HZ, model, recording

from drivers.recording import Recording
from drivers.samples import intervals_s
from simulators.discrepancy.report import discrepancy
from simulators.discrepancy.steady_clock import at_steady_rate, stamp_scatter_s

JITTER_S = 1e-3


def stamped_by_a_host(seed: int, *, lost: bool = False) -> tuple[Recording, np.ndarray]:
    """Return a recording with scattered stamps, of nine tenths of all frames if the others were lost; true stamps."""
    case, rng = recording(None, seed), np.random.default_rng(seed)
    samples = case.samples[rng.random(len(case.samples)) > 0.1] if lost else case.samples.copy()
    true_s = samples["time"].copy()
    samples["time"] += JITTER_S * rng.uniform(-1.0, 1.0, len(samples))
    return replace(case, samples=samples), true_s


@pytest.mark.parametrize("lost", [False, True])
def test_scattered_stamps_are_put_back_on_the_clock_and_said_to_be(*, lost: bool) -> None:
    """The line's own error at its ends is twice the scatter over the root of the number of stamps."""
    case, true_s = stamped_by_a_host(61, lost=lost)
    (steady,) = at_steady_rate([case])
    sigma_s = JITTER_S / np.sqrt(3.0)
    assert np.max(np.abs(steady.samples["time"] - true_s)) < 4.0 * 2.0 * sigma_s / np.sqrt(len(true_s))
    assert stamp_scatter_s(case.samples) == pytest.approx(sigma_s, rel=0.05)
    report = discrepancy([case], model())
    assert {one["effect"] for one in report.findings} == ({"lost_samples"} if lost else set())
    assert any("scatter by 0.58 ms" in remark for remark in report.document["remarks"])


def test_a_block_that_samples_unsteadily_keeps_its_stamps() -> None:
    """What it sums up of gravity follows its intervals."""
    case, _ = stamped_by_a_host(62)
    samples = case.samples.copy()
    for field in ("dv", "dtheta"):
        samples[field] *= (intervals_s(samples) * RATE_HZ)[:, None]
    case = replace(case, samples=samples)
    assert stamp_scatter_s(samples) == 0.0
    assert at_steady_rate([case])[0] is case


@pytest.mark.parametrize("error", [3e-4, 1e-3, -1e-3])
def test_a_steady_clock_that_runs_wrong_is_left_to_be_named(error: float) -> None:
    """Turns begin and end within its samples of a twentieth of a second, up to four of these late."""
    case = recording(None, 63)
    case.samples["time"] *= 1.0 + error
    assert at_steady_rate([case])[0] is case
    (found,) = discrepancy([case], model()).findings
    assert (found["effect"], found["channel"]) == ("clock_scale", "all")
    value = found["parameters"]["error"]
    assert abs(value["value"] - error) < 3.3 * value["sigma"]
