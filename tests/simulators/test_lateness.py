"""Turns that come late: what a schedule was off by is told from a delay and from a clock that runs wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hidden_case import hidden_case
from scipy.fft import dct

from benchmarks._blind import plans
from simulators.discrepancy.candidates import Library, setup_difference
from simulators.discrepancy.compare import Scene, compare
from simulators.discrepancy.evidence import Evidence
from simulators.discrepancy.lateness import as_late
from simulators.discrepancy.report import discrepancy
from simulators.discrepancy.turn_errors import all_late, turn_errors

SEED, NUMBER = 90611, 442
"""Eleven turns, all some 2.5 σ late, and each start and end by 1 ms (σ) more or less."""


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Return the block on its table."""
    case = hidden_case(SEED, NUMBER, tmp_path_factory.mktemp("late"))
    return compare(case.recording, case.model)


def test_how_late_the_turns_were_is_found(late: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Against what the generator drew: far nearer than the 1 ms to which each is known beforehand."""
    drawn, draw = [], plans.true_setup

    def seen(*args: object, **kwargs: object) -> object:
        drawn.append(draw(*args, **kwargs))  # type: ignore[arg-type]
        return drawn[-1]

    monkeypatch.setattr(plans, "true_setup", seen)
    hidden_case(SEED, NUMBER, tmp_path)
    true = drawn[-1]
    true_s = np.array([(one.start_shift_s, one.end_shift_s) for one in true.turns]) + true.offset_s
    (scene,) = as_late([late])
    assert abs(true_s.mean()) > 2e-3
    assert np.sqrt(np.mean((np.array(scene.lateness_s) - true_s) ** 2)) < 3e-4


def test_chords_add_up_to_what_the_late_turns_do(late: Scene) -> None:
    """Accelerometers read the attitude: there twice the shift adds more than twice as much."""
    rng = np.random.default_rng(4)
    offset_s, own_s = 2.5e-3, 5e-4 * rng.standard_normal((11, 2))
    scene = replace(late, lateness_s=tuple(map(tuple, offset_s + own_s)))
    errors = turn_errors(scene)
    chords = offset_s * all_late(scene, errors)
    for one, (start_s, end_s) in zip(errors, own_s, strict=True):
        chords = chords + start_s * one.starts[0] + end_s * one.ends[0]
    motions = list(scene.setup.motions)
    for one, (start_s, end_s) in zip(errors, offset_s + own_s, strict=True):
        span_s = one.turn.end_s - one.turn.start_s
        rate = one.turn.rate_radps * span_s / (span_s - start_s + end_s)
        moved = replace(one.turn, start_s=one.turn.start_s + start_s, end_s=one.turn.end_s + end_s, rate_radps=rate)
        motions[one.place] = moved
    true = scene.predict(replace(scene.setup, motions=tuple(motions))) - scene.predicted
    tangents = turn_errors(late)
    straight = offset_s * all_late(late, tangents)
    for one, (start_s, end_s) in zip(tangents, own_s, strict=True):
        straight = straight + start_s * one.starts[0] + end_s * one.ends[0]
    for group in (slice(0, 3), slice(3, 6)):
        size = np.max(np.abs(true[:, group]))
        assert np.max(np.abs(chords - true)[:, group]) < 2e-3 * size
    assert np.max(np.abs(straight - true)[:, :3]) > 0.02 * np.max(np.abs(true[:, :3]))


@pytest.mark.parametrize(("effect", "size"), [("latency", 1e-4), ("clock_scale", 1e-6)])
def test_small_delays_and_clock_errors_by_turns_are_what_prediction_says(late: Scene, effect: str, size: float) -> None:
    """To the hundredth by which a shift of 0.1 ms is more than in proportion."""
    hardly = replace(late, lateness_s=((1e-4, 1e-4),) * 11)
    library = Library([hardly], only={(effect, "all")}, plain=True)
    (by_turns,) = (h for h in library.hypotheses if h.effect == effect)
    change = setup_difference(late, effect, "all", size) / size
    for (_, channel), part in library.columns[by_turns.columns[0]].parts.items():
        true = dct(late.analysed(change[:, channel], channel) / library.spread[0, channel], norm="ortho")
        assert np.max(np.abs(part - true)) < 0.01 * np.max(np.abs(true))


def test_a_schedule_kept_late_is_no_delay_of_the_block(tmp_path: Path) -> None:
    case = hidden_case(SEED, NUMBER, tmp_path)
    report = discrepancy([case.recording], case.model)
    assert "latency" not in {one["effect"] for one in report.findings}


@pytest.mark.parametrize(("seed", "number"), [(90610, 121), (90610, 241), (90612, 107)])
def test_a_wrong_clock_is_named_though_every_turn_might_have_been_late_by_as_much(
    seed: int, number: int, tmp_path: Path
) -> None:
    """By 3 to 4 ms at the end, where 1 ms is allowed: but each in proportion to its time, to a twentieth of that.

    In the last case turns are late as well, by a millisecond, and the mount sways, which accelerometers feel in some
    attitudes only.
    """
    case = hidden_case(seed, number, tmp_path)
    (finding,) = discrepancy([case.recording], case.model).findings
    assert finding["effect"] == "clock_scale"
    (true,) = case.truth["effects"]
    found = finding["parameters"]["error"]
    assert abs(found["value"] - true["parameters"]["error"]) < 3.3 * found["sigma"]


def test_how_much_likelier_a_well_kept_schedule_is_agrees_with_the_marginal_likelihood(late: Scene) -> None:
    """Against ∫ exp(right·a - a·matrix·a/2) N(a; 0, prior) da with both priors, by determinants of the whole."""
    evidence = Evidence(Library([late], only=(), plain=True))
    fit = evidence.fit([])
    own = [i for s in evidence.library.schedules.values() for group in (*s.starts, *s.ends) for i in group]
    matrix, right = evidence.normal(fit.ids, {slot: noise.power for slot, noise in fit.noise.items()})

    def log_marginal(times: float) -> float:
        sigma = np.array([evidence.prior[i] * (times if i in own else 1.0) for i in fit.ids])
        inner = np.eye(len(sigma)) + matrix * np.outer(sigma, sigma)
        _, log_det = np.linalg.slogdet(inner)
        return float(0.5 * (right * sigma) @ np.linalg.solve(inner, right * sigma) - 0.5 * log_det)

    shares = (0.3, 0.1, 0.03)
    found = evidence.if_kept(fit.ids, fit.amplitude, fit.covariance, shares)
    assert found == pytest.approx([log_marginal(share) - log_marginal(1.0) for share in shares], abs=0.01)
