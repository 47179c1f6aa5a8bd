"""The planner: what it chooses shows every coefficient, and better than a habit of the same length."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from inertial.calibration import DTG_MOUNTING
from inertial.documents import Noise
from inertial.earth import Site
from inertial.table_plan import Table, plan_table_run, predict
from inertial.turntable import TableSetup, TableTurn

NOISE = Noise.model_validate(
    {f"accel_{a}": {"white": 2e-4} for a in "xyz"} | {f"gyro_{a}": {"white": 2e-6} for a in "xyz"}
)
SETUP = TableSetup(Site.at(math.radians(35.7)), 0.3, np.eye(3), (), level_sigma_rad=3e-5, azimuth_sigma_rad=3e-5)
TABLE = Table()


def sixfold(rest_s: float) -> tuple[TableSetup, float]:
    """Return the six positions of the textbooks, then a revolution each way about every axis."""
    turns, now = [], rest_s

    def turn(quarters: int, axis: tuple[float, float, float], frame: str) -> None:
        nonlocal now
        end = now + abs(quarters) * math.pi / 2.0 / TABLE.slew_radps
        rate = math.copysign(TABLE.slew_radps, quarters)
        turns.append(TableTurn(now, end, rate, axis, frame, TABLE.angle_sigma_rad))  # type: ignore[arg-type]
        now = end + rest_s

    for quarters in (1, 1, 1, 1):
        turn(quarters, TABLE.outer_axis, "tangent")
    for quarters in (4, -4, 1):
        turn(quarters, TABLE.inner_axis, "body")
    for quarters in (4, -4, 1, 2):
        turn(quarters, TABLE.outer_axis, "tangent")
    return replace(SETUP, turns=tuple(turns)), now


@pytest.mark.parametrize("criterion", ["D", "A"])
def test_a_plan_shows_every_coefficient(criterion: str) -> None:
    plan = plan_table_run(SETUP, NOISE, steps=36, rest_s=30.0, criterion=criterion)  # type: ignore[arg-type]
    assert not plan.unobservable
    assert np.max(plan.conditioning) < 1e-3
    assert len(plan.order) == len(plan.sigma) == 48
    assert len(plan.steps) == 36


def test_a_plan_beats_six_positions_of_the_same_length() -> None:
    habit, length = sixfold(30.0)
    by_habit, unseen = predict(habit, length, NOISE, DTG_MOUNTING)
    plan = plan_table_run(SETUP, NOISE, steps=20, rest_s=20.0)
    assert plan.duration_s < 1.5 * length
    assert unseen  # six positions are six equations for the seven unknowns of an accelerometer
    assert not plan.unobservable
    assert np.exp(np.mean(np.log(by_habit / plan.sigma))) > 3.0


def test_longer_rests_give_smaller_sigma_as_the_root_of_time_where_noise_is_white() -> None:
    exact = replace(SETUP, level_sigma_rad=0.0, azimuth_sigma_rad=0.0)
    table = replace(TABLE, angle_sigma_rad=0.0, settle_s=0.5)
    plan = plan_table_run(exact, NOISE, {}, table=table, steps=30, rest_s=20.0)
    bias = plan.order.index("accel_x.bias_mps2")
    stretched = replace(
        plan.setup,
        turns=tuple(
            replace(t, start_s=4.0 * t.start_s, end_s=4.0 * t.end_s, rate_radps=t.rate_radps / 4.0)
            for t in plan.setup.turns
        ),
    )
    sigma, _ = predict(stretched, 4.0 * plan.duration_s, NOISE, {}, settle_s=2.0)
    assert sigma[bias] == pytest.approx(0.5 * plan.sigma[bias], rel=0.1)


def test_turns_do_not_overlap_and_end_within_the_plan() -> None:
    plan = plan_table_run(SETUP, NOISE, steps=12, rest_s=10.0)
    times = [t for turn in plan.setup.turns for t in (turn.start_s, turn.end_s)]
    assert times == sorted(times)
    assert times[-1] < plan.duration_s


def test_without_turns_in_both_senses_gyro_coefficients_are_named() -> None:
    setup, length = sixfold(30.0)
    setup = replace(setup, turns=setup.turns[:4])
    _, unseen = predict(setup, length, NOISE, {})
    assert any("gyro_z" in combination.text for combination in unseen)


def test_a_plan_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="plan nothing"):
        plan_table_run(SETUP, NOISE, steps=1)
