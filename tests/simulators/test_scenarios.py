"""Scenarios: files that say all, the demo's draw, recordings and models on disk."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from drivers.recording import read_recording
from drivers.recording_meta import RecordingError, ReferenceMeta, RestMeta, TurnMeta
from inertial.documents import BlockModel, Calibration, ChannelNoise, DocumentError, Noise, parse_document
from inertial.earth import EARTH_RATE_RADPS
from inertial.error_model import Coefficients, true_from_readings
from simulators.errors import ScenarioError
from simulators.model_store import ModelStore, ideal_model, load_model, save_model
from simulators.noise import generator
from simulators.scenarios import (
    DEG,
    DEG_PER_H,
    MG,
    Move,
    NoisyLine,
    Scenario,
    StuckSensor,
    believed_setup,
    demo_model,
    demo_scenario,
    effect,
    make_block,
    planted_terms,
    read_scenario,
    reference_errors,
    write_scenario,
)
from simulators.simulate import simulate_recording

WRITTEN_BY_HAND = """
[site]
latitude_deg = 35.7
height_m = 1200.0
[reference]
azimuth_deg = 40.0
azimuth_sigma_deg = 0.1
roll_deg = 1.0
pitch_deg = -2.0
level_sigma_deg = 0.003
[block]
sample_rate_hz = 100.0
[[motion]]
kind = "turn"
start_s = 2.0
end_s = 4.0
rate_dps = 1.0
axis = [0.0, 0.0, 1.0]
frame = "body"
[scenario]
duration_s = 6.0
seed = 4
end_c = 40.0
[[effect]]
effect = "bias_shift"
channel = "gyro_y"
parameters = { shift = { value = 2.4, unit = "deg/h" } }
[[fault]]
kind = "unplug"
at_s = 3.0
duration_s = 1.5
"""


def scenario_file(folder: Path, text: str) -> Path:
    path = folder / "scenario.toml"
    path.write_text(text)
    return path


def test_a_scenario_written_by_hand_is_read(tmp_path: Path) -> None:
    scenario = read_scenario(scenario_file(tmp_path, WRITTEN_BY_HAND))
    assert scenario.duration_s == 6.0
    assert planted_terms(scenario, BlockModel()).g_radps[1] == pytest.approx(-2.4 * DEG_PER_H)
    assert len(make_block(scenario, BlockModel()).generate(10)) == 10


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("duration_s = 6.0", "duration_min = 6.0"), "duration_min"),
        (('kind = "unplug"', 'kind = "earthquake"'), "earthquake"),
        (("height_m = 1200.0", "height_ft = 1200.0"), "height_ft"),
        (("seed = 4", "seed = 4.5"), "seed"),
        (("seed = 4", "seed = [4"), "is not TOML"),
    ],
)
def test_a_wrong_key_is_refused_with_file_and_place(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    path = scenario_file(tmp_path, WRITTEN_BY_HAND.replace(*change))
    with pytest.raises(RecordingError, match=words) as refused:
        read_scenario(path)
    assert str(path) in str(refused.value)


def test_a_scenario_survives_its_file(tmp_path: Path) -> None:
    faults = [
        NoisyLine(kind="garbage", probability=0.1, at_s=1.0),
        Move(kind="move", at_s=100.0, duration_s=2.0, rate_dps=1.0),
        StuckSensor(kind="stuck_sensor", channel="gyro_x", duration_s=1.0),
    ]
    scenario = demo_scenario(7).model_copy(update={"fault": faults})
    assert read_scenario(write_scenario(scenario, tmp_path / "s.toml")) == scenario


def test_a_recording_s_own_toml_is_a_scenario(tmp_path: Path, shared_data: Path) -> None:
    scenario = read_scenario(shared_data / "recordings" / "rlg_vehicle_quiet.toml")
    assert scenario.duration_s == 430.0
    path = simulate_recording(
        scenario.with_motion([RestMeta(kind="rest", start_s=0.0, end_s=2.0)], 2.0),
        tmp_path / "again",
        model=ideal_model(),
    )
    assert read_scenario(path.with_suffix(".toml")).site == scenario.site


def test_without_a_latitude_there_is_nothing_to_simulate(shared_data: Path) -> None:
    scenario = read_scenario(shared_data / "recordings" / "xsens_multiposition.toml")
    with pytest.raises(ScenarioError, match="latitude_deg is missing"):
        believed_setup(scenario)


def test_an_impossible_motion_or_calibration_is_a_scenario_error(tmp_path: Path) -> None:
    scenario = read_scenario(
        scenario_file(
            tmp_path,
            WRITTEN_BY_HAND
            + '[[motion]]\nkind = "vibration"\nstart_s = 4.0\nend_s = 5.0\naxis = [1.0, 0.0, 0.0]\ngrms = 1.0\n'
            "band_hz = [0.0, 50.0]\n",
        )
    )
    with pytest.raises(ScenarioError, match="band"):
        make_block(scenario, BlockModel())


def test_the_demo_is_what_the_job_description_says() -> None:
    scenario, model = demo_scenario(1), demo_model(1)
    terms = planted_terms(scenario, model)
    assert np.abs(terms.g_radps) == pytest.approx([2.4 * DEG_PER_H] * 3)
    assert np.abs(terms.f_mps2) == pytest.approx([0.3 * MG] * 3)
    assert (scenario.site.latitude_deg, scenario.reference.azimuth_deg) == (35.7, 40.0)
    assert (scenario.reference.azimuth_sigma_deg, scenario.reference.level_sigma_deg) == (0.1, 0.003)
    assert scenario.block.sample_rate_hz == 100.0
    assert model.noise.gyro_x.white == pytest.approx(0.01 * DEG / 60)
    assert model.noise.gyro_x.flicker == pytest.approx(0.02 * DEG_PER_H)
    assert model.noise.accel_z.white == pytest.approx(20e-6 * 9.80665)
    assert Coefficients.from_document(model.calibration).g_sensitivity.any()


def test_the_demo_s_signs_and_errors_are_drawn_from_the_seed() -> None:
    assert demo_scenario(3) == demo_scenario(3)
    signs = np.array(
        [np.sign([*(t := planted_terms(demo_scenario(seed), BlockModel())).f_mps2, *t.g_radps]) for seed in range(64)]
    )
    assert np.all(np.abs(signs.sum(axis=0)) < 5 * 8)  # five σ of 64 coins
    azimuths = [demo_scenario(seed).effect[0].parameters["error"].value for seed in range(200)]
    assert np.std(azimuths) == pytest.approx(0.1, rel=5 / math.sqrt(400))


def test_reference_errors_are_drawn_only_for_what_has_a_sigma() -> None:
    rng = generator(1)
    assert reference_errors(ReferenceMeta(azimuth_deg=1.0), rng) == []
    both = reference_errors(ReferenceMeta(azimuth_deg=1.0, azimuth_sigma_deg=0.1, roll_deg=0, pitch_deg=0), rng)
    assert [entry.effect for entry in both] == ["azimuth_error"]


def test_the_demo_s_block_has_settled_within_two_minutes() -> None:
    # What is left of the turn-on transients at 120 s must be nothing beside the terms' own σ.
    scenario = demo_scenario(2)
    quiet = demo_model(2).model_copy(update={"noise": Noise()})
    block, settled = make_block(scenario, quiet), make_block(scenario.warmed_up(), quiet)
    left = block.generate(12_100)[-100:]["dtheta"].mean(axis=0) - settled.generate(12_100)[-100:]["dtheta"].mean(axis=0)
    assert np.abs(left * 100.0).max() < 0.02 * DEG_PER_H
    assert abs(block.temperature_c - 35.0) < 0.2


def test_a_simulated_recording_is_what_a_real_one_would_be(tmp_path: Path) -> None:
    motion = [TurnMeta(kind="turn", start_s=2.0, end_s=4.0, rate_dps=10.0, axis=[0.0, 0.0, 1.0], frame="body")]
    scenario, model = demo_scenario(5).with_motion(motion, 6.0), demo_model(5)
    recording = read_recording(simulate_recording(scenario, tmp_path / "turn", model=model))
    assert len(recording.samples) == 600
    assert recording.meta.motion == motion
    assert recording.calibration_path is not None
    calibration = parse_document(Calibration, recording.calibration_path.read_text(), "calibration")
    accel, gyro = true_from_readings(
        recording.samples["dv"] * 100.0,
        recording.samples["dtheta"] * 100.0,
        Coefficients.from_document(calibration.coefficients),
    )
    assert accel[:, 2].mean() == pytest.approx(9.797, abs=0.01)
    assert gyro[:, 2].sum() / 100 == pytest.approx(20 * DEG + 6 * EARTH_RATE_RADPS * math.sin(35.7 * DEG), abs=1e-4)
    same = make_block(scenario, model).generate(600)
    for name in ("dv", "dtheta", "time", "sequence", "status"):
        assert np.array_equal(recording.samples[name], same[name])


def test_another_noise_seed_is_the_same_block() -> None:
    scenario = demo_scenario(5)
    other = scenario.with_seed(99)
    assert other.effect == scenario.effect
    assert not np.array_equal(
        make_block(scenario, demo_model(5)).generate(10)["dv"], make_block(other, demo_model(5)).generate(10)["dv"]
    )


def test_a_scheduled_move_and_stuck_sensor_happen_to_the_sample() -> None:
    faults = [
        Move(kind="move", at_s=1.0, duration_s=0.5, rate_dps=90.0, axis=[1.0, 0.0, 0.0]),
        StuckSensor(kind="stuck_sensor", channel="gyro_z", at_s=2.0, duration_s=1.0),
    ]
    scenario = demo_scenario(1).model_copy(update={"fault": faults}).with_motion([], 4.0)
    samples = make_block(scenario, demo_model(1)).generate(400)
    assert np.array_equal(np.flatnonzero(samples["dtheta"][:, 0] > 0.01), np.arange(100, 150))
    still = np.flatnonzero(np.diff(samples["dtheta"][:, 2]) == 0.0)
    assert set(range(199, 298)) <= set(still.tolist())
    assert len(still) < 110


def test_models_are_kept_by_content_and_know_their_parents(tmp_path: Path) -> None:
    store = ModelStore(tmp_path / "models")
    parent = store.add(ideal_model("laser"))
    shifted = ideal_model("laser").model_copy(
        update={"parent": parent, "effects": [effect("bias_shift", "gyro_x", shift=(1e-6, "rad/s"))]}
    )
    child = store.add(shifted)
    assert store.add(shifted) == child
    assert store.get(child[:12]) == shifted
    assert [digest for digest, _ in store.lineage(child)] == [child, parent]
    with pytest.raises(DocumentError, match="0 models are named"):
        store.get("f" * 64)


def test_a_damaged_model_is_refused_by_name(tmp_path: Path) -> None:
    store = ModelStore(tmp_path)
    path = tmp_path / f"{store.add(demo_model(1))}.json"
    path.write_text(path.read_text().replace("demo-1", "demo-2"))
    with pytest.raises(DocumentError, match="not what its name says"):
        load_model(path)
    path.write_text(path.read_text()[:100])
    with pytest.raises(DocumentError, match="not JSON"):
        load_model(path)
    with pytest.raises(DocumentError, match="cannot be read"):
        load_model(tmp_path / "nowhere.json")


def test_a_model_file_is_never_changed(tmp_path: Path) -> None:
    path = save_model(demo_model(1), tmp_path / "block.json")
    assert save_model(demo_model(1), path) == path
    with pytest.raises(DocumentError, match="do not change"):
        save_model(demo_model(2), path)
    assert load_model(path) == demo_model(1)


def test_an_ideal_model_reads_the_truth() -> None:
    model = ideal_model("mems", Noise(gyro_x=ChannelNoise(white=1e-4)))
    assert model.calibration == BlockModel().calibration
    assert model.noise.gyro_x.white == 1e-4
    assert ideal_model().noise.free


def test_a_scenario_knows_no_samples() -> None:
    assert "scenario" not in Scenario.model_validate(demo_scenario(1)).recording_meta().model_dump()
