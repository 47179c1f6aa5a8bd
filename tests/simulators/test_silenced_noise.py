"""A limit is told from a scale error of third order by the noise that it silences."""

from __future__ import annotations

from pathlib import Path

from hidden_case import hidden_case

from simulators.discrepancy.report import discrepancy


def test_a_limit_that_only_some_noise_meets_is_no_curve_beside_which_noise_comes_and_goes(tmp_path: Path) -> None:
    """Of 32 σ; by means a scale error of third order is as good, and beside it noise is gone in the fastest turn."""
    case = hidden_case(90640, 465, tmp_path)
    (hidden,) = case.truth["effects"]
    (found,) = discrepancy([case.recording], case.model).findings
    assert (found["effect"], found["channel"]) == (hidden["effect"], hidden["channel"])
    limit = found["parameters"]["limit"]
    assert abs(limit["value"] - hidden["parameters"]["limit"]) < 4.0 * limit["sigma"]
