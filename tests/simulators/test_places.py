"""What looking in many places costs: as much as there are places that can be told apart."""

from __future__ import annotations

import math

import numpy as np
import pytest
from closed_form import RATE_HZ, WHITE, Truth, model, recording
from scipy.optimize import brentq
from scipy.stats import binom, chi2

from simulators.discrepancy.atoms import Steps, best_line, score_of
from simulators.discrepancy.candidates import STEP_PLACES, Library, to_cosine
from simulators.discrepancy.compare import compare
from simulators.discrepancy.evidence import Evidence, bayes_factor
from simulators.discrepancy.look import Look
from simulators.discrepancy.margins import FALSE_ALARM_RATE, MARGIN
from simulators.discrepancy.ranking import Ranking
from simulators.discrepancy.shapes import line_places
from simulators.discrepancy.whitening import cosine_basis

COUNT, RECORDS = 600, 3000


@pytest.mark.parametrize("d", [4.0, 7.0, 25.0])
def test_a_step_would_do_as_well_where_its_likelihood_says(d: float) -> None:
    """A step without noise gains d²/2 times the squared cosine between it and another, in closed form."""
    basis, spread, first = cosine_basis(COUNT, 0.1), np.ones(COUNT), 350
    power = np.ones(len(basis.counts))
    rest = COUNT - first
    left = to_cosine(d / math.sqrt(rest) * (np.arange(COUNT) >= first))
    found = Steps(basis, spread).best(score_of(left, power, basis, spread), power)
    behind = COUNT - np.arange(COUNT)[1:-1]
    cosine2 = np.minimum(rest, behind) ** 2 / (rest * behind)
    assert found.first == first
    assert found.gain == pytest.approx(0.5 * d**2, rel=0.01)
    assert found.alike == pytest.approx(np.sum(np.exp(0.5 * d**2 * (cosine2 - 1.0))) / COUNT, rel=0.1, abs=0.1 / COUNT)


@pytest.mark.parametrize("amplitudes", [1, 2, 3])
def test_names_by_chance_are_far_rarer_than_is_promised(amplitudes: int) -> None:
    """Of all names of a library together, in noise that is known, by the tail of χ² of their likelihood ratios."""
    ranking = Ranking(Evidence(Library([compare(recording(None, 130), model())])))

    def beyond(gain: float) -> float:
        return bayes_factor(gain, amplitudes, ranking.names) - MARGIN

    gain = brentq(beyond, amplitudes, 100.0)
    assert ranking.names * chi2.sf(2.0 * gain, amplitudes) < 0.2 * FALSE_ALARM_RATE


def test_steps_where_there_are_none_are_as_rare_as_their_price_says() -> None:
    """Mean Bayes factors of 1 are passed by exp(3) in one record of twenty at most (Markov); 99.9 % of the binomial."""
    basis, spread, rng = cosine_basis(COUNT, 0.1), np.ones(COUNT), np.random.default_rng(11)
    steps, power = Steps(basis, spread), np.ones(len(basis.counts))
    passed = 0
    for _ in range(RECORDS):
        step = steps.best(score_of(rng.standard_normal(COUNT), power, basis, spread), power)
        passed += bayes_factor(step.gain, 1, min(STEP_PLACES, 1.0 / step.alike)) > 3.0
    assert passed <= binom.ppf(0.999, RECORDS, math.exp(-3.0))


@pytest.mark.parametrize("most", [300, 10_000])
def test_a_line_has_some_frequency_and_each_octave_is_as_likely(most: int) -> None:
    """Prior probabilities add up to one; half of it is alike in each octave, where few frequencies are few places."""
    chance = np.array([1.0 / line_places(cycles, most) for cycles in range(1, most + 1)])
    assert chance.sum() == pytest.approx(1.0, rel=2e-3)
    octaves = [chance[2**k - 1 : 2 ** (k + 1) - 1].sum() - 2**k * 0.5 / most for k in range(3, 8)]
    assert octaves == pytest.approx([octaves[0]] * 5, rel=0.1)


def test_lines_where_there_are_none_are_as_rare_as_their_price_says() -> None:
    """As of steps."""
    basis, spread, rng = cosine_basis(COUNT, 0.1), np.ones(COUNT), np.random.default_rng(12)
    power, passed = np.ones(len(basis.counts)), 0
    for _ in range(RECORDS):
        hertz, gain = best_line(score_of(rng.standard_normal(COUNT), power, basis, spread), power, basis)
        passed += bayes_factor(gain, 2, line_places(hertz * COUNT * 0.1, COUNT // 2)) > 3.0
    assert passed <= binom.ppf(0.999, RECORDS, math.exp(-3.0))


def test_a_time_constant_of_which_many_do_as_well_is_one_of_few_places() -> None:
    """At half a σ a sample nothing tells one from its neighbours; at twenty σ nearly all others are told from it."""
    places = []
    for sigmas in (0.12, 20.0):

        def change(true: Truth, readings: np.ndarray, size: float = sigmas * WHITE["gyro"] * np.sqrt(RATE_HZ)) -> None:
            readings[:, 5] += size * np.exp(-true["t"] / 60.0)

        evidence = Evidence(Library([compare(recording(change, 131, moving=False), model())]))
        bare, ranking = evidence.fit([]), Ranking(evidence)
        look = Look(evidence, bare, ranking.quiet(bare))
        grid = [h for h in evidence.library.hypotheses if h.name == ("turn_on_transient", "gyro_z")]
        best = max(grid, key=look.gain)
        assert best.places == len(grid)
        places.append(ranking.shapes.refine(best, bare, look).places)
    assert 1.0 <= places[0] < 0.6 * len(grid)
    assert places[1] == pytest.approx(len(grid), rel=0.01)
