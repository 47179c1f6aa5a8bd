"""A walk of a coefficient or two is as good a shift or drift: larger noise with a name is a rival of names."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from closed_form import RATE_HZ, WHITE, Truth, model, recording
from hidden_case import hidden_case

from inertial.documents import CHANNELS, BlockModel
from simulators.discrepancy.adopt import Search, Searcher
from simulators.discrepancy.candidates import Library
from simulators.discrepancy.compare import compare
from simulators.discrepancy.evidence import Evidence
from simulators.discrepancy.next_recording import Question, propose
from simulators.discrepancy.noise_instead import beyond_noise, noise_instead
from simulators.discrepancy.ranking import Ranking, Scored
from simulators.discrepancy.report import discrepancy

GYRO_X = CHANNELS.index("gyro_x")
WALK = 1e-6  # rad/s/√s


def walking(true: Truth, readings: np.ndarray) -> None:
    """Let a gyro's bias walk."""
    steps = np.random.default_rng(7).standard_normal(len(true["t"]))
    readings[:, 3] += WALK / np.sqrt(RATE_HZ) * np.cumsum(steps)


def searched(change: Any, believed: BlockModel, **circumstances: bool) -> tuple[Evidence, Search]:
    evidence = Evidence(Library([compare(recording(change, 111, **circumstances), believed)]))
    return evidence, Searcher(evidence).run()


def names_of(finding: dict[str, Any]) -> set[tuple[str, str]]:
    return {(one["effect"], one["channel"]) for one in (finding, *finding["alternatives"])}


def test_noise_as_stated_explains_nothing_that_a_fit_does_not() -> None:
    evidence, search = searched(None, model())
    for channel, name in enumerate(CHANNELS):
        found = noise_instead(evidence, search.fit, channel)
        assert found.channel == name
        assert 0.0 <= found.nats < 3.0
        assert not found.certain


def test_a_walk_is_as_large_and_as_certain_as_it_was_made() -> None:
    evidence, search = searched(walking, model(), moving=False)
    found = noise_instead(evidence, search.bare, GYRO_X)
    assert found.certain
    assert "rate_random_walk" in found.names
    assert found.noise.white == WHITE["gyro"]
    assert 0.4 * WALK < max(found.noise.random_walk, found.noise.flicker) < 2.5 * WALK
    assert noise_instead(evidence, search.bare, GYRO_X + 1).nats < 3.0


def test_of_a_model_that_leaves_its_noise_free_noise_of_other_proportions_is_a_rival_and_no_finding() -> None:
    believed = model()
    believed = believed.model_copy(update={"noise": believed.noise.model_copy(update={"free": True})})
    evidence, search = searched(walking, believed, moving=False)
    found = noise_instead(evidence, search.bare, GYRO_X)
    assert found.certain
    assert "rate_random_walk" in found.names
    assert 0.8 * WHITE["gyro"] < found.noise.white < 1.2 * WHITE["gyro"]
    assert discrepancy([recording(walking, 111, moving=False)], believed).findings == []


def test_a_model_that_says_nothing_of_its_noise_has_none_that_is_too_large() -> None:
    evidence, search = searched(walking, model(free=True), moving=False)
    found = noise_instead(evidence, search.bare, GYRO_X)
    assert (found.nats, found.names, found.certain) == (0.0, (), False)


def test_a_name_that_larger_noise_does_as_well_as_ties_with_it(tmp_path: Path) -> None:
    """Flicker of d = 7 in few coefficients, of which neither it nor the name that leads is certain alone."""
    case = hidden_case(90703, 241, tmp_path)
    (hidden,) = case.truth["effects"]
    report = discrepancy([case.recording], case.model)
    (found,) = report.findings
    assert report.verdict == "tie"
    assert (hidden["effect"], hidden["channel"]) in names_of(found)
    assert f"bias instability on {hidden['channel']}" in report.document["text"]
    (behind,) = [one["behind_nats"] for one in found["alternatives"] if one["effect"] == hidden["effect"]]
    assert found["confidence"] < 1.0 / (1.0 + math.exp(-behind)) + 1e-3
    assert found["next_recording"][0]["expected_nats"] > 0.0


def test_larger_noise_that_a_name_does_as_well_as_ties_with_it(tmp_path: Path) -> None:
    """A rate random walk of d = 7 that went one way."""
    case = hidden_case(90702, 191, tmp_path)
    (found,) = discrepancy([case.recording], case.model).findings
    assert (found["effect"], found["channel"]) == ("rate_random_walk", "accel_z")
    assert ("drift", "accel_z") in names_of(found)
    assert all(one["behind_nats"] < 3.0 for one in found["alternatives"])


@pytest.mark.parametrize(("seed", "number"), [(90709, 41), (90637, 155)])
def test_two_names_that_together_do_little_better_than_larger_noise_are_not_told_for_it(
    seed: int, number: int, tmp_path: Path
) -> None:
    """Rate random walks of d = 15 and 10, a drift or a step and a thermal lag: by 2 and 5 nats."""
    case = hidden_case(seed, number, tmp_path)
    (hidden,) = case.truth["effects"]
    (found,) = discrepancy([case.recording], case.model).findings
    assert (found["effect"], found["channel"]) == (hidden["effect"], hidden["channel"])


@pytest.mark.parametrize(("seed", "number"), [(90625, 510), (90627, 267)])
def test_a_further_name_short_of_its_margin_ties_with_the_noise_that_is_named_in_its_place(
    seed: int, number: int, tmp_path: Path
) -> None:
    """A transient and a drift, each beside another name: 150 to 300 to one, but a walk was told and no word of them."""
    case = hidden_case(seed, number, tmp_path)
    told = set().union(*map(names_of, discrepancy([case.recording], case.model).findings))
    assert {(one["effect"], one["channel"]) for one in case.truth["effects"]} <= told


def test_noise_that_only_a_mean_asks_for_is_no_reason_to_say_nothing(tmp_path: Path) -> None:
    """A shift of d = 15 beside another name, ten to one against a walk that the noise had at that, unnamed."""
    case = hidden_case(90712, 270, tmp_path)
    findings = discrepancy([case.recording], case.model).findings
    assert {(one["effect"], one["channel"]) for one in findings} == {("sinusoid", "accel_z"), ("bias_shift", "gyro_z")}


def test_a_curve_that_explains_no_more_than_larger_noise_does_is_nothing_unknown(tmp_path: Path) -> None:
    case = hidden_case(90618, 15, tmp_path)
    report = discrepancy([case.recording], case.model)
    (found,) = report.findings
    assert names_of(found) == {("bias_instability", "gyro_x"), ("rate_random_walk", "gyro_x")}
    assert not report.document["remaining"]["empirical"]


def test_what_was_lost_is_no_evidence_for_noise_either(tmp_path: Path) -> None:
    """Of likelihoods that are held against each other both leave out what stands for missing samples."""
    case = hidden_case(90705, 326, tmp_path)
    findings = discrepancy([case.recording], case.model).findings
    assert ("size_effect", "accel_z") in [(one["effect"], one["channel"]) for one in findings]


def test_a_recording_tells_a_name_from_larger_noise_by_less_than_from_none() -> None:
    evidence, search = searched(walking, model(), moving=False)
    ranked = Ranking(evidence).rank(search.bare, [])
    drift: Scored = next(one for one in ranked if one.hypothesis.name == ("drift", "gyro_x"))
    instead = noise_instead(evidence, search.bare, GYRO_X)
    alone, beside = propose(
        evidence, drift.fit, [Question(drift.hypothesis, [], None), Question(drift.hypothesis, [], instead)]
    )
    quiet = {one.name: one.expected_nats for one in alone}
    for one in beside:
        assert 0.0 < one.expected_nats < quiet[one.name]
    none = replace(instead, noise=model().noise.gyro_x)
    (same,) = propose(evidence, drift.fit, [Question(drift.hypothesis, [], none)])
    assert {one.name: one.expected_nats for one in same} == pytest.approx(quiet, rel=1e-3)


def test_a_line_beside_a_walk_is_held_against_no_more_than_the_walk_alone() -> None:
    """What larger noise saves by its name, seven nats, it saves beside a line of six as well."""

    def change(true: Truth, readings: np.ndarray) -> None:
        walking(true, readings)
        readings[:, 3] += 2.6 * WALK * np.sin(2.0 * np.pi * true["t"] / 20.0)

    evidence = Evidence(Library([compare(recording(change, 112, moving=False), model())]))
    bare = evidence.fit([])
    line = next(one for one in Ranking(evidence).rank(bare, []) if one.hypothesis.name == ("sinusoid", "gyro_x"))
    beyond, noise = beyond_noise(evidence, line, bare)
    assert noise is not None
    assert 4.0 < line.score < noise.nats
    assert beyond == pytest.approx(line.score, abs=1.0)
