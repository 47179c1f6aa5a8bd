"""Noise that is more than stated: named where its spectrum is of a term, unknown where it is of none."""

from __future__ import annotations

from pathlib import Path

from hidden_case import hidden_case

from simulators.discrepancy.report import discrepancy


def test_slow_noise_that_few_coefficients_tell_is_named_by_terms_that_explain_it_not_of_another_colour(
    tmp_path: Path,
) -> None:
    """A rate random walk of d = 10: no term has much over another, but what is there is certain."""
    case = hidden_case(90613, 416, tmp_path)
    (hidden,) = case.truth["effects"]
    report = discrepancy([case.recording], case.model)
    (found,) = report.findings
    names = {found["effect"], *(other["effect"] for other in found["alternatives"])}
    assert found["channel"] == hidden["channel"]
    assert names == {hidden["effect"], "bias_instability"}
    assert not report.document["remaining"]["empirical"]


def test_noise_that_comes_in_bursts_is_of_no_term_however_little_there_is_of_it(tmp_path: Path) -> None:
    case = hidden_case(90612, 199, tmp_path)
    assert case.truth["strange"] == "bursts"
    report = discrepancy([case.recording], case.model)
    assert report.verdict == "unknown"
    assert not report.findings
    assert {term["channel"] for term in report.document["remaining"]["empirical"]} == {case.truth["strange_channel"]}


def test_an_error_in_the_form_of_a_large_name_is_no_larger_noise(tmp_path: Path) -> None:
    """A line of 200 σ whose size and frequency move a little: what that leaves over is its misfit, said once."""
    case = hidden_case(90615, 360, tmp_path)
    report = discrepancy([case.recording], case.model)
    assert [(found["effect"], found["channel"]) for found in report.findings] == [("sinusoid", "gyro_z")]
    misfits = [(one["term"], one["amplitude"]) for one in report.document["remaining"]["misfits"]]
    assert misfits
    assert len(misfits) == len(set(misfits))
