"""A log that is stamped by another clock than the block's own: what counts from switch-on counts from its start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_form import DURATION_S, RATE_HZ, Truth, model, recording

from drivers.protocols.native import DTHETA_LSB_RAD
from drivers.recording import Recording
from drivers.samples import intervals_s
from simulators.discrepancy.report import discrepancy
from simulators.discrepancy.switched_on import from_first_sample, tell_switch_on
from simulators.scenarios import Scenario, ScenarioMeta, make_block

DEG_PER_H = np.pi / 180 / 3600
SIZE, FADES_S = 8.0 * DEG_PER_H, 30.0
UNIX_S = 1.7e9


def warm_up(true: Truth, readings: np.ndarray) -> None:
    readings[:, 4] += SIZE * np.exp(-true["t"] / FADES_S)


def later(case: Recording, by_s: float) -> Recording:
    """Return a recording that was stamped by another clock."""
    samples = case.samples.copy()
    samples["time"] += by_s
    motions = [
        one.model_copy(update={"start_s": one.start_s + by_s, "end_s": one.end_s + by_s}) for one in case.meta.motion
    ]
    return replace(case, samples=samples, meta=case.meta.model_copy(update={"motion": motions}))


@pytest.mark.parametrize("by_s", [UNIX_S, 25_000.0, -1000.0])
def test_a_transient_is_named_with_its_size_and_the_model_with_it_simulates_it(by_s: float) -> None:
    case = later(recording(warm_up, 71), by_s)
    report = discrepancy([case], model())
    (found,) = report.findings
    assert (report.verdict, found["effect"], found["channel"]) == ("named", "turn_on_transient", "gyro_y")
    for name, true in (("amplitude", SIZE), ("time_constant", FADES_S)):
        assert abs(found["parameters"][name]["value"] - true) < 3.3 * found["parameters"][name]["sigma"]
    assert "counted from the first sample" in report.document["text"]
    assert discrepancy([case], report.model).verdict == "none"

    meta = case.meta
    scenario = Scenario(site=meta.site, reference=meta.reference, block=meta.block, scenario=ScenarioMeta())
    plain, with_it = (
        make_block(scenario, one).generate(round(DURATION_S * RATE_HZ))["dtheta"][:, 1].cumsum()
        for one in (model(), report.model)
    )
    t = np.arange(1, len(plain) + 1) / RATE_HZ
    size, fades_s = (found["parameters"][name]["value"] for name in ("amplitude", "time_constant"))
    # Each of the two angles is rounded to a whole step.
    np.testing.assert_allclose(with_it - plain, size * fades_s * -np.expm1(-t / fades_s), atol=DTHETA_LSB_RAD)


def test_time_that_may_count_from_switch_on_is_left_as_it_is() -> None:
    case, other = recording(None, 81), later(recording(None, 82), 25_000.0)
    assert tell_switch_on([later(case, 1000.0)])
    assert tell_switch_on([case, other])  # both clocks may have begun together
    assert not tell_switch_on([other])
    assert discrepancy([later(case, 1000.0)], model()).document["remarks"] == []


def test_intervals_of_large_stamps_are_those_of_the_clock() -> None:
    """A number of 1.7e9 is known to a quarter of a microsecond, a part in ten thousand of a millisecond (1σ)."""
    case = recording(None, 83, moving=False)
    samples = case.samples.copy()
    samples["time"] = UNIX_S + np.arange(1, len(samples) + 1) / 1000.0
    assert np.ptp(intervals_s(samples)) > 1e-4 * 1e-3
    interval_s = intervals_s(from_first_sample(replace(case, samples=samples)).samples)
    np.testing.assert_allclose(interval_s, 1e-3, rtol=1e-9)
    samples["time"] = UNIX_S + np.arange(1, len(samples) + 1) / 3000.0  # no whole microseconds: left as they are
    stamps_s = from_first_sample(replace(case, samples=samples)).samples["time"]
    np.testing.assert_array_equal(np.diff(stamps_s), np.diff(stamps_s[0] + samples["time"] - samples["time"][0]))
