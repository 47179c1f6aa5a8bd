"""Recording to result: what is found, how sure, and when it is not fit."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.recording import Recording, read_recording, write_recording
from drivers.recording_meta import SiteMeta, TurnMeta, WindowMeta
from inertial.documents import BlockModel, Calibration, Noise, Result
from service.align import align_recording
from service.compensate import compensate, partial
from service.errors import RefusedInput
from service.methods import METHODS
from service.physical import Physical
from service.report import render
from service.trials import distances, planted, record
from simulators.scenarios import Scenario, demo_model, demo_scenario, reference_errors

Array = NDArray[np.float64]

MG_MPS2 = 9.80665e-3
DEG_H_RADPS = math.pi / 180 / 3600
SEED = 3


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return demo_scenario(SEED).warmed_up().with_motion([], 275.0)


@pytest.fixture(scope="module")
def model() -> BlockModel:
    return demo_model(SEED)


@pytest.fixture(scope="module")
def recording(scenario: Scenario, model: BlockModel, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(scenario, model, tmp_path_factory.mktemp("run") / "rest")


@pytest.fixture(scope="module")
def result(recording: Recording) -> Result:
    return compensate(recording)


def test_planted_shift_is_found_within_three_sigma(result: Result, scenario: Scenario, model: BlockModel) -> None:
    assert result.verdict == "shift compensated"
    assert result.fit
    assert max(distances(scenario, model, result)) < 3
    truth = planted(scenario, model)
    left = np.array(result.terms["final"].g_radps) - truth["g_radps"]
    assert np.max(np.abs(left)) < 0.4 * DEG_H_RADPS  # of 2.4 planted


def test_windows_are_chosen_from_the_first_still_span(result: Result) -> None:
    spans = [(window.kind, window.end_s - window.start_s) for window in result.windows]
    assert [kind for kind, _ in spans] == ["align", "stage_1", "stage_2", "stage_3", "verify"]
    assert [length for _, length in spans] == pytest.approx([30, 60, 60, 60, 60])


def test_recorded_windows_give_the_same_to_the_last_bit(recording: Recording, result: Result, tmp_path: Path) -> None:
    windows = [WindowMeta(kind=w.kind, start_s=w.start_s, end_s=w.end_s) for w in result.windows]
    assert recording.calibration_path is not None
    (tmp_path / "calibration.json").write_bytes(recording.calibration_path.read_bytes())
    again = write_recording(tmp_path / "run", recording.samples, recording.meta.model_copy(update={"window": windows}))
    replayed = compensate(read_recording(again))
    assert replayed.terms == result.terms
    assert replayed.covariance == result.covariance
    assert replayed.windows == result.windows


def test_progress_shows_the_numbers_of_the_result(recording: Recording, result: Result) -> None:
    so_far = partial(recording, result.windows[:3])
    assert so_far == {kind: result.terms[kind] for kind in ("stage_1", "stage_2")}


def test_covariance_belongs_to_sigma(result: Result) -> None:
    diagonal = [result.covariance[i][i] for i in range(6)]
    assert all(value is not None for value in diagonal)
    sigma = [*result.sigma.f_mps2, *result.sigma.g_radps]
    assert np.sqrt(np.array(diagonal, float)) == pytest.approx(sigma)


def test_gyro_calibration_error_moves_its_own_term_alone(
    recording: Recording, result: Result, model: BlockModel
) -> None:
    """The paper's Table 3: the y-gyro bias coefficient raised by 80 %."""
    before = model.calibration
    change = 0.8 * before.gyro_y.bias_radps
    raised = before.gyro_y.model_copy(update={"bias_radps": before.gyro_y.bias_radps + change})
    calibration = Calibration(coefficients=before.model_copy(update={"gyro_y": raised}))
    other = compensate(recording, calibration=calibration)
    g_moved = np.array(other.terms["final"].g_radps) - result.terms["final"].g_radps
    f_moved = np.array(other.terms["final"].f_mps2) - result.terms["final"].f_mps2
    assert abs(change) > 0.1 * DEG_H_RADPS
    assert g_moved == pytest.approx([0.0, -change, 0.0], abs=0.001 * DEG_H_RADPS)
    assert np.max(np.abs(f_moved)) < 0.001 * MG_MPS2


def test_noise_comes_from_a_model_when_one_is_given(recording: Recording, model: BlockModel) -> None:
    with_model = compensate(recording, model=model)
    assert with_model.noise.gyro_x == model.noise.gyro_x
    assert with_model.reference["noise"] == "block model"
    free = compensate(recording, model=model.model_copy(update={"noise": Noise(free=True)}))
    assert free.reference["noise"] == "these data"


def test_block_that_moves_in_a_window_is_not_fit(
    scenario: Scenario, model: BlockModel, result: Result, tmp_path: Path
) -> None:
    turn = TurnMeta(kind="turn", start_s=120.0, end_s=122.0, rate_dps=0.5, axis=[0.0, 0.0, 1.0], frame="body")
    moved = record(scenario.with_motion([turn], 275.0), model, tmp_path / "moved")
    windows = [WindowMeta(kind=w.kind, start_s=w.start_s, end_s=w.end_s) for w in result.windows]
    said = moved.meta.model_copy(update={"motion": [], "window": windows})
    found = compensate(read_recording(write_recording(tmp_path / "said", moved.samples, said)))
    assert found.verdict == "not fit"
    assert found.state == "FAULT"
    assert [reason.split(":")[0] for reason in found.reasons if reason.startswith("moved")] == ["moved_in_stage_2"]


def test_windows_keep_clear_of_a_movement_that_nobody_described(
    scenario: Scenario, model: BlockModel, tmp_path: Path
) -> None:
    turn = TurnMeta(kind="turn", start_s=60.0, end_s=62.0, rate_dps=0.5, axis=[0.0, 0.0, 1.0], frame="body")
    moved = record(scenario.with_motion([turn], 275.0), model, tmp_path / "moved")
    said = moved.meta.model_copy(update={"motion": []})
    found = compensate(read_recording(write_recording(tmp_path / "said", moved.samples, said)))
    assert found.windows[0].start_s > 62.0


def test_described_turn_is_kept_out_of_the_windows(scenario: Scenario, model: BlockModel, tmp_path: Path) -> None:
    turn = TurnMeta(kind="turn", start_s=10.0, end_s=20.0, rate_dps=9.0, axis=[0.0, 0.0, 1.0], frame="body")
    found = compensate(record(scenario.with_motion([turn], 295.0), model, tmp_path / "turned"))
    assert found.windows[0].start_s >= 20.0
    assert found.alignment["heading_deg"] == pytest.approx(-90.0)
    assert found.fit
    assert max(distances(scenario, model, found)) < 3.5


def test_short_recording_is_shared_out_and_a_shorter_one_refused(
    recording: Recording, scenario: Scenario, model: BlockModel
) -> None:
    short = compensate(recording, start_s=0.0, end_s=140.0)
    lengths = [window.end_s - window.start_s for window in short.windows]
    assert lengths == pytest.approx([15.0, 31.0, 31.0, 31.0, 31.0])
    assert max(distances(scenario, model, short)) < 3.5
    with pytest.raises(RefusedInput, match=r"80\.0 s; compensation takes 270 s, not less than 90 s"):
        compensate(recording, start_s=0.0, end_s=80.0)


def test_without_a_level_the_tilt_is_named_and_not_bounded(
    recording: Recording, scenario: Scenario, tmp_path: Path
) -> None:
    bare = scenario.reference.model_copy(update={"roll_deg": None, "pitch_deg": None, "level_sigma_deg": None})
    assert recording.calibration_path is not None
    (tmp_path / "calibration.json").write_bytes(recording.calibration_path.read_bytes())
    path = write_recording(tmp_path / "bare", recording.samples, recording.meta.model_copy(update={"reference": bare}))
    found = compensate(read_recording(path))
    assert found.sigma.f_mps2[:2] == [None, None]
    assert found.covariance[0] == [None] * len(found.order)
    assert any("pitch" in unseen.text and "1 mg" in unseen.text for unseen in found.unobservable)


def test_site_without_latitude_is_refused(recording: Recording, tmp_path: Path) -> None:
    meta = recording.meta.model_copy(
        update={"site": SiteMeta(), "block": recording.meta.block.model_copy(update={"calibration": None})}
    )
    path = write_recording(tmp_path / "nowhere", recording.samples, meta)
    with pytest.raises(ValueError, match=r"nowhere\.toml: \[site\] latitude_deg"):
        compensate(read_recording(path))


def test_report_is_one_page_and_the_same_every_time(result: Result) -> None:
    page = render(result)
    assert page == render(Result.model_validate_json(result.canonical_json()))
    assert "shift compensated" in page
    assert "http" not in page.replace("http-equiv", "")
    for digest in result.inputs.values():
        assert digest in page


def test_report_shows_hostile_text_as_text(result: Result) -> None:
    hostile = result.model_copy(update={"reasons": ["<script>alert(1)</script>"], "block": {"name": "<img src=x>"}})
    page = render(hostile)
    assert "<script>" not in page
    assert "<img" not in page


@pytest.mark.parametrize("method", list(METHODS))
def test_every_method_makes_the_same_facts(
    recording: Recording, scenario: Scenario, model: BlockModel, method: str
) -> None:
    found = compensate(recording, method=method)
    assert (found.method, found.verdict) == (method, "shift compensated")
    assert set(found.terms) == {"stage_1", "stage_2", "stage_3", "final"}
    assert found.terms["final"] == found.terms["stage_3"]
    assert found.order[:6] == ["f_x", "f_y", "f_z", "g_x", "g_y", "g_z"]
    assert np.shape(found.covariance) == (len(found.order),) * 2
    assert max(distances(scenario, model, found)) < 3.5
    so_far = partial(recording, found.windows[:2], method=method)
    assert so_far == {"stage_1": found.terms["stage_1"]}
    assert found.budget is not None
    assert found.budget["time_s"] == [60.0, 300.0]


def test_pooling_is_surer_than_the_chain(recording: Recording, model: BlockModel) -> None:
    """With the model's noise: gyro and vertical accelerometer terms gain about 1.86 (reading.md)."""
    pooled, chained = (compensate(recording, method=method, model=model).sigma for method in ("optimal", "paper"))
    gain = np.array(chained.g_radps[1:], float) / np.array(pooled.g_radps[1:], float)
    assert np.all(gain > 1.3)  # the azimuth's σ, in both alike, keeps it below 1.86
    assert chained.f_mps2[2] is not None
    assert pooled.f_mps2[2] is not None
    assert chained.f_mps2[2] / pooled.f_mps2[2] > 1.5


def test_optimal_names_its_unknowns_and_what_it_hardly_sees(result: Result) -> None:
    assert result.order == ["f_x", "f_y", "f_z", "g_x", "g_y", "g_z", "level_1", "level_2", "azimuth"]
    assert result.observability is not None
    assert len(result.observability.singular_values) == 9
    assert np.diag(np.array(result.observability.correlation)) == pytest.approx(np.ones(9))
    assert result.observability.fit == pytest.approx(np.ones(6), abs=0.5)
    texts = " / ".join(one.text for one in result.unobservable)
    for words in ("x accelerometer bias and pitch are one", "roll are one", "azimuth error are one", "gravity"):
        assert words in texts


# ---- a second attitude -------------------------------------------------------------------------------------------


def slewed(
    frame: Literal["tangent", "body"], folder: Path, sigma_deg: float | None = 0.01
) -> tuple[Scenario, Recording]:
    """Return a block on a rough launcher (level to 0.05°, azimuth to 0.5°) that is turned about by 180° half way."""
    rough = {"level_sigma_deg": 0.05, "azimuth_sigma_deg": 0.5, "level_frame": frame}
    base = demo_scenario(SEED).warmed_up()
    reference = base.reference.model_copy(update=rough)
    kept = [entry for entry in base.effect if entry.effect == "bias_shift"]
    effects = [*kept, *reference_errors(reference, np.random.default_rng(SEED))]
    slew = TurnMeta(
        kind="turn",
        start_s=155.0,
        end_s=175.0,
        rate_dps=9.0,
        axis=[0.0, 0.0, 1.0],
        frame="tangent",
        angle_sigma_deg=sigma_deg,
    )
    scenario = base.model_copy(update={"reference": reference, "effect": effects}).with_motion([slew], 300.0)
    return scenario, record(scenario, demo_model(SEED), folder / "slewed")


def test_a_slewed_launcher_separates_level_and_azimuth(model: BlockModel, tmp_path: Path) -> None:
    scenario, recording = slewed("tangent", tmp_path)
    found = compensate(recording)
    stages = {window.kind: window.end_s for window in found.windows}
    assert stages["stage_2"] <= 155.0 < 175.0 < stages["stage_3"]
    assert found.verdict == "shift compensated"
    assert found.order[-1] == "turn_1"
    assert max(distances(scenario, model, found)) < 3.5
    assert all(sigma is not None and sigma < 0.01 * MG_MPS2 for sigma in found.sigma.f_mps2)  # 0.86 mg by the level
    assert abs(found.alignment["refined"]["heading_deg"]) == pytest.approx(180.0, abs=0.05)
    assert not any("accelerometer bias and pitch" in one.text for one in found.unobservable)
    assert found.uncertainty is not None
    assert found.uncertainty.order == found.order


def test_a_level_error_that_rides_with_the_block_stays_hidden(model: BlockModel, tmp_path: Path) -> None:
    scenario, recording = slewed("body", tmp_path)
    found = compensate(recording)
    assert found.sigma.f_mps2[0] == pytest.approx(0.86 * MG_MPS2, rel=0.1)
    assert any("accelerometer bias and pitch" in one.text for one in found.unobservable)
    assert max(distances(scenario, model, found)) < 3.5
    windows = [WindowMeta(kind=w.kind, start_s=w.start_s, end_s=w.end_s) for w in found.windows]
    meta = recording.meta.model_copy(update={"window": windows})
    with pytest.raises(RefusedInput, match="two attitudes"):
        compensate(replace(recording, meta=meta), method="paper")


def test_a_turn_beside_align_is_refused(model: BlockModel, tmp_path: Path) -> None:
    _, recording = slewed("tangent", tmp_path)
    spans = {"align": 100.0, "stage_1": 180.0, "stage_2": 200.0, "stage_3": 220.0, "verify": 240.0}
    windows = [WindowMeta.model_validate({"kind": k, "start_s": at, "end_s": at + 20.0}) for k, at in spans.items()]
    meta = recording.meta.model_copy(update={"window": windows})
    with pytest.raises(RefusedInput, match="turns between its windows align and stage_1"):
        compensate(replace(recording, meta=meta), model=model)


# ---- real blocks -------------------------------------------------------------------------------------------------


def left_dph(result: Result, recording: Recording, start_s: float, end_s: float) -> Array:
    """Return the mean rate with the terms in, beside the Earth's, by axis."""
    physical = Physical.of(recording)
    span = physical.span(start_s, end_s)
    rate = span.true(physical.coefficients)[1].sum(axis=0) / span.duration_s
    refined = result.alignment["refined"]
    azimuth = math.radians(refined["azimuth_deg"])
    earth = np.array(refined["C_tb"]).T @ physical.site.earth_rate_radps(azimuth)
    return np.asarray((rate + result.terms["final"].g_radps - earth) / DEG_H_RADPS)


def test_real_block_is_left_with_the_rate_of_the_earth(shared_data: Path) -> None:
    recording = read_recording(shared_data / "recordings" / "rlg_vehicle_quiet")
    found = compensate(recording)
    assert found.method == "optimal"
    assert found.verdict == "no significant shift"
    assert abs(found.terms["final"].f_mps2[2]) < 0.02 * MG_MPS2
    windows = {window.kind: window for window in found.windows}
    stages = (windows["stage_1"].start_s, windows["stage_3"].end_s)
    verify = (windows["verify"].start_s, windows["verify"].end_s)
    for start_s, end_s in (stages, verify, (0.0, 431.0)):
        assert np.max(np.abs(left_dph(found, recording, start_s, end_s))) < 0.15
    assert found.sigma.f_mps2[:2] == [None, None]  # it levelled itself
    assert None not in found.sigma.g_radps


def test_real_block_has_no_significant_shift_by_the_paper_either(shared_data: Path) -> None:
    found = compensate(read_recording(shared_data / "recordings" / "rlg_vehicle_quiet"), method="paper")
    assert found.verdict == "no significant shift"
    assert abs(found.terms["final"].f_mps2[2]) < 0.02 * MG_MPS2


def test_disturbed_block_is_not_passed_off_as_still(shared_data: Path) -> None:
    found = compensate(read_recording(shared_data / "recordings" / "rlg_vehicle_disturbed"))
    assert found.verdict == "not fit"
    assert any(reason.startswith("moved_in_") for reason in found.reasons)


@pytest.mark.parametrize("name", ["rlg_vehicle_quiet", "rlg_vehicle_disturbed"])
def test_inertial_alignment_finds_north_without_the_azimuth(shared_data: Path, name: str) -> None:
    recording = read_recording(shared_data / "recordings" / name)
    reference = recording.meta.reference.model_copy(update={"azimuth_deg": None, "azimuth_sigma_deg": None})
    bare = replace(recording, meta=recording.meta.model_copy(update={"reference": reference}))
    found = compensate(bare, alignment="inertial")
    assert found.alignment["azimuth_deg"] == pytest.approx(90.6, abs=0.3)
    assert found.windows[0].end_s - found.windows[0].start_s == 60.0
    assert found.reference["alignment"] == "inertial"
    assert not any(reason.startswith("moved_in_align") for reason in found.reasons)
    whole = align_recording(bare, alignment="inertial", end_s=300.0)
    assert whole["azimuth_deg"] == pytest.approx(90.6, abs=0.3)
    assert whole["azimuth_noise_sigma_deg"] < 0.3 < whole["azimuth_sigma_deg"]  # nothing tells of the gyros' bias
    asked_of_the_data = align_recording(bare, end_s=300.0)["alignment"]
    assert asked_of_the_data == ("inertial" if name == "rlg_vehicle_disturbed" else "rest")
