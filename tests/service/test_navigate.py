"""Offline navigation along a recording: truth gives the origin, errors grow as closed forms say."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from drivers.recording import read_recording, write_recording
from drivers.recording_meta import RecordingMeta, TurnMeta
from inertial.documents import BlockModel, Calibration, ChannelCoefficients, GyroCoefficients
from service.compensate import compensate
from service.errors import RefusedInput
from service.navigate import navigate_recording
from service.trials import record, trials, worth
from simulators.model_store import ideal_model
from simulators.scenarios import Scenario, demo_model, demo_scenario

DEG_H_RADPS = math.pi / 180 / 3600
TURN = TurnMeta(kind="turn", start_s=20.0, end_s=110.0, rate_dps=1.0, axis=[0.0, 0.0, 1.0], frame="body")


def quiet(seconds: float, motion: list[TurnMeta] | None = None) -> Scenario:
    """Return a scenario without any error: the truth as the frame's steps round it."""
    return demo_scenario(1).warmed_up().model_copy(update={"effect": []}).with_motion(list(motion or []), seconds)


def ideal() -> BlockModel:
    return ideal_model("dtg")


def test_ideal_block_stays_at_the_origin_at_rest_and_in_a_turn(tmp_path: Path) -> None:
    for name, motion in (("rest", []), ("turn", [TURN])):
        facts = navigate_recording(record(quiet(150.0, motion), ideal(), tmp_path / name))
        assert max(facts["radial_m"]) < 0.05  # the steps of the frame, 2⁻³⁰ rad and 2⁻²⁴ m/s, walk this far at most
        assert len(facts["time_s"]) == len(facts["position_m"]) == len(facts["velocity_mps"]) == len(facts["radial_m"])


def test_gyro_error_leads_off_by_the_cubic_law(tmp_path: Path) -> None:
    """A gyro error ε about body y tilts the nose: the error along tangent 1 grows as g·ε·t³/6 (Schuler neglected)."""
    error = 3.0 * DEG_H_RADPS
    model = ideal().model_copy(update={"calibration": ChannelCoefficients(gyro_y=GyroCoefficients(bias_radps=error))})
    recording = record(quiet(100.0), model, tmp_path / "error")
    wrong = recording.meta.model_copy(update={"block": recording.meta.block.model_copy(update={"calibration": None})})
    facts = navigate_recording(read_recording(write_recording(tmp_path / "wrong", recording.samples, wrong)))
    expected = 9.798 * error * 100.0**3 / 6
    assert abs(facts["position_m"][-1][0]) == pytest.approx(expected, rel=0.01)


def test_span_starts_at_the_attitude_that_the_turns_before_left(tmp_path: Path) -> None:
    recording = record(quiet(150.0, [TURN]), ideal(), tmp_path / "turn")
    facts = navigate_recording(recording, start_s=112.0, end_s=148.0)
    assert facts["time_s"][0] == pytest.approx(112.0, abs=0.02)
    assert max(facts["radial_m"]) < 0.01


def test_terms_are_worth_the_promised_factors(tmp_path: Path) -> None:
    scenario, model = demo_scenario(5), demo_model(5)
    run = record(scenario.warmed_up().with_motion([], 275.0), model, tmp_path / "run")
    facts = worth(trials(scenario, model, tmp_path), compensate(run))
    assert facts["improvement"]["rest"] > 5
    assert facts["improvement"]["turn"] > 3


def test_attitude_that_nothing_gives_is_refused(tmp_path: Path) -> None:
    recording = record(quiet(120.0, [TURN]), ideal(), tmp_path / "turn")
    bare = RecordingMeta.model_validate(
        {**recording.meta.model_dump(exclude={"reference"}), "reference": {"azimuth_deg": 40.0}}
    )
    path = write_recording(tmp_path / "bare", recording.samples, bare)
    with pytest.raises(RefusedInput, match=r"bare\.toml: \[reference\].*start where the block stands still"):
        navigate_recording(read_recording(path), start_s=50.0)


def test_rows_are_thinned_and_keep_both_ends(tmp_path: Path) -> None:
    facts = navigate_recording(record(quiet(20.0), ideal(), tmp_path / "rest"))
    assert len(facts["time_s"]) == 201
    assert facts["time_s"][-1] == pytest.approx(20.0)
    assert np.max(np.diff(facts["time_s"])) == pytest.approx(0.1)


def test_terms_make_up_for_a_wrong_gyro_coefficient(tmp_path: Path) -> None:
    """The paper's Table 3: terms found with the y-gyro bias coefficient raised by 80 % navigate to the same place."""
    scenario, model = demo_scenario(5), demo_model(5)
    recording = record(scenario.warmed_up().with_motion([], 275.0), model, tmp_path / "run")
    before = model.calibration.gyro_y.bias_radps
    raised = model.calibration.gyro_y.model_copy(update={"bias_radps": 1.8 * before})
    calibration = Calibration(coefficients=model.calibration.model_copy(update={"gyro_y": raised}))
    (tmp_path / "raised.json").write_text(calibration.canonical_json())
    block = recording.meta.block.model_copy(update={"calibration": "raised.json"})
    path = write_recording(tmp_path / "other", recording.samples, recording.meta.model_copy(update={"block": block}))
    ends = {}
    for name, one in (("before", recording), ("raised", read_recording(path))):
        facts = navigate_recording(one, compensate(one))
        ends[name] = np.array([*facts["position_m"][-1], *facts["velocity_mps"][-1]])
    uncorrected = navigate_recording(read_recording(path))["radial_m"][-1]
    moved = np.abs(ends["raised"] - ends["before"])
    assert np.max(moved[:3]) < 0.01
    assert np.max(moved[3:]) < 0.001
    assert uncorrected > 10 * float(np.linalg.norm(ends["raised"][:3]))
