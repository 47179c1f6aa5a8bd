"""Noise that is more than stated: named where its spectrum is of a term, unknown where it is of none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from closed_form import RATE_HZ, WHITE, model, recording
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


def test_larger_white_noise_of_heavy_tails_is_white() -> None:
    """Tails make its size less certain, and not its colour.

    The mean of RUNS errors over their σ is standard normal over √RUNS, 99.9 %.
    """
    more, runs, off = np.sqrt(8.0) * WHITE["gyro"], 4, []
    for run in range(runs):
        case, rng = recording(None, 83 + run), np.random.default_rng(run)
        samples = case.samples.copy()
        wild = np.where(rng.random(len(samples)) < 0.05, 4.0, 1.0) / np.sqrt(1.75)
        samples["dtheta"][:, 0] += more / np.sqrt(RATE_HZ) * wild * rng.standard_normal(len(samples))
        (found,) = discrepancy([replace(case, samples=samples)], model()).findings
        assert (found["effect"], found["channel"], found["alternatives"]) == ("random_walk", "gyro_x", [])
        coefficient = found["parameters"]["coefficient"]
        off.append((coefficient["value"] - more) / coefficient["sigma"])
    assert abs(np.mean(off)) < 3.29 / np.sqrt(runs), off
