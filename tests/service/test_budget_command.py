"""The error budget of a result, from the document alone."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from drivers.recording import Recording
from drivers.recording_meta import TurnMeta
from inertial.documents import Result, parse_document
from service.budget import predicted
from service.compensate import compensate
from service.errors import RefusedInput
from service.navigate import navigate_recording
from service.trials import record
from simulators.scenarios import demo_model, demo_scenario

SEED = 5
HALF_TURN = TurnMeta(kind="turn", start_s=0.0, end_s=1.0, rate_dps=180.0, axis=[0.0, 0.0, 1.0], frame="body")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    scenario = demo_scenario(SEED).warmed_up().with_motion([], 600.0)
    return record(scenario, demo_model(SEED), tmp_path_factory.mktemp("run") / "rest")


@pytest.fixture(scope="module", params=["optimal", "paper"])
def result(request: pytest.FixtureRequest, recording: Recording) -> Result:
    return compensate(recording, method=request.param)


def test_the_document_alone_gives_the_budget_that_it_carries(result: Result) -> None:
    again = parse_document(Result, result.canonical_json(), "result.json")
    assert predicted(again, (60.0, 300.0)) == result.budget
    json.dumps(result.budget, allow_nan=False)


def test_shares_of_the_causes_stay_within_the_whole(result: Result) -> None:
    assert result.budget is not None
    for causes in result.budget["contributors"]:
        shares = [cause["share"] for cause in causes]
        assert shares == sorted(shares, reverse=True)
        assert 0.8 < sum(shares) <= 1.0 + 1e-9
    assert {cause["cause"] for cause in result.budget["contributors"][1]} >= {"noise of gyro_x", "noise of gyro_y"}
    radial = result.budget["radial_m"]
    assert radial["50"][1] < radial["95"][1]


def test_navigation_of_fresh_data_ends_where_predicted(result: Result, recording: Recording) -> None:
    """300 s from the end of verification: the state's nine errors in their predicted σ, one draw."""
    facts = navigate_recording(recording, result, 270.0, 570.0)
    assert result.budget is not None
    sigma = np.array(result.budget["position_sigma_m"][1])
    assert np.all(np.abs(np.array(facts["position_m"][-1])) < 4.0 * sigma)
    assert facts["radial_m"][-1] < 2.0 * result.budget["radial_m"]["95"][1]


def test_a_turn_shows_what_rest_hides(result: Result) -> None:
    """Level σ of 0.003° is 0.05 mg in the terms: after half a turn both push the same way, 2·γ·σ."""
    rest = predicted(result, [200.0])
    turned = predicted(result, [200.0], [HALF_TURN])
    assert turned["profile"] == "motion"
    assert turned["position_sigma_m"][0][0] > 1.3 * rest["position_sigma_m"][0][0]
    pushed = 2.0 * 9.8 * math.radians(0.003) * 199.5**2 / 2.0
    level = next(one["share"] for one in turned["contributors"][0] if one["cause"] == "level reference")
    variance = np.sum(np.square(turned["position_sigma_m"][0]))
    assert math.sqrt(level * variance / 2.0) == pytest.approx(pushed, rel=0.03)


def test_times_that_are_none_and_old_results_are_refused(result: Result) -> None:
    with pytest.raises(RefusedInput, match="no times"):
        predicted(result, [0.0])
    with pytest.raises(RefusedInput, match="compensate` again"):
        predicted(result.model_copy(update={"uncertainty": None}), [60.0])


def test_figures_are_the_same_every_time(tmp_path: Path) -> None:
    from service.experiments.figures import Curve, draw

    curves = [Curve("a < b", [0.0, 1.0, 2.0], [0.0, 1.5, -0.5], group=0), Curve("c", [0.0, 2.0], [1.0, 1.0], group=1)]
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        draw(tmp_path / name / "figure", "A & B", "s", "m", curves)
    made = [(tmp_path / name / "figure.svg").read_bytes() for name in ("first", "second")]
    assert made[0] == made[1]
    assert b"a &lt; b" in made[0]
    assert b"plotly" in (tmp_path / "first" / "figure.html").read_bytes()
