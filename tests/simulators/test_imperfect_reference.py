"""A schedule a little off, a level far off: what the reference is wrong by is no effect of the block."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import closed_form
import numpy as np
import pytest
from hidden_case import hidden_case

from drivers.recording import Recording, RecordingMeta
from drivers.recording_meta import TurnMeta
from inertial.documents import BlockModel
from inertial.earth import Site
from service.trials import record
from simulators.discrepancy.candidates import Library
from simulators.discrepancy.compare import compare
from simulators.discrepancy.evidence import Evidence
from simulators.discrepancy.report import discrepancy
from simulators.discrepancy.shaking import spans_as_shaken
from simulators.motion import Setup, Vibration
from simulators.scenarios import demo_model, demo_scenario

RATE_HZ = 50.0
AXES = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])


def turned(folder: Path, late_s: float) -> tuple[Recording, BlockModel]:
    """Return three turns, of which each was begun ``late_s`` after what the recording says, just beyond an edge."""
    motion = [
        TurnMeta(kind="turn", start_s=s, end_s=s + 9.005, rate_dps=20.0, axis=axis, frame="body")
        for s, axis in zip((20.0005, 60.0005, 100.0005), AXES, strict=True)
    ]
    scenario = demo_scenario(3).warmed_up().with_motion(list(motion), 150.0)
    block = scenario.block.model_copy(update={"sample_rate_hz": RATE_HZ})
    model = demo_model(3)
    true = record(scenario.model_copy(update={"block": block, "effect": []}), model, folder / "turned")
    said = [
        turn.model_copy(
            update={"start_s": turn.start_s - late_s, "rate_dps": 20.0 * 9.005 / (9.005 + late_s)},
        )
        for turn in motion
    ]
    return replace(true, meta=true.meta.model_copy(update={"motion": said})), model


@pytest.mark.parametrize("late_s", [0.0, 0.0015])
def test_a_turn_that_begins_in_the_next_sample_is_late_and_no_step_of_a_bias(tmp_path: Path, late_s: float) -> None:
    recording, model = turned(tmp_path, late_s)
    report = discrepancy([recording], model)
    assert (report.verdict, report.findings) == ("none", []), report.document["text"]


def test_a_level_that_is_far_off_is_one_error_and_no_second_for_its_square(tmp_path: Path) -> None:
    recording, model = turned(tmp_path, 0.0)
    reference = recording.meta.reference.model_dump(exclude_none=True)
    reference |= {"pitch_deg": reference.get("pitch_deg", 0.0) + 0.6, "roll_deg": reference.get("roll_deg", 0.0) - 0.3}
    reference |= {"level_sigma_deg": 0.005}
    meta = RecordingMeta.model_validate({**recording.meta.model_dump(exclude_none=True), "reference": reference})
    report = discrepancy([replace(recording, meta=meta)], model)
    assert [one["effect"] for one in report.findings] == ["level_error"], report.document["text"]
    assert report.document["remaining"]["empirical"] == []


def test_a_false_clock_is_told_from_errors_of_timing_in_the_last_digits(tmp_path: Path) -> None:
    """Turns of a laser block at 100 Hz, each known to 1 ms and shown to 0.1 µs: against a fit by QR."""
    case = hidden_case(90616, 13, tmp_path)
    samples = case.recording.samples.copy()
    samples["time"] *= 1.0 + 3e-6
    scene = compare(replace(case.recording, samples=samples), case.model)
    assert len(scene.turns()) > 5
    evidence = Evidence(Library([scene], only={("clock_scale", "all")}))
    clock = next(h for h in evidence.library.hypotheses if h.effect == "clock_scale")
    fit = evidence.fit(clock.columns)
    rows, right = [], []
    for slot in evidence.slots:
        weight = np.repeat(fit.noise[slot].power ** -0.5, evidence.basis[slot].counts.astype(int))
        nothing = np.zeros(len(weight))
        parts = [evidence.library.columns[i].parts.get(slot, nothing) for i in fit.ids]
        rows.append(weight[:, None] * np.column_stack(parts))
        right.append(weight * evidence.library.residual[slot])
    rows.append(np.diag([1.0 / evidence.prior[i] if i in evidence.prior else 0.0 for i in fit.ids]))
    right.append(np.zeros(len(fit.ids)))
    scale = np.linalg.norm(np.vstack(rows), axis=0)
    exact = np.linalg.lstsq(np.vstack(rows) / scale, np.concatenate(right), rcond=None)[0] / scale
    place = fit.ids.index(clock.columns[0])
    assert abs(fit.amplitude[place] - exact[place]) < 0.1 * math.sqrt(fit.covariance[place, place])
    # What is left of columns a hundred times as large that nearly cancel is as if nothing had been summed in bins.
    large = replace(fit, amplitude=100.0 * fit.amplitude)
    for slot in evidence.slots:
        bins = evidence.basis[slot].bounds[:-1]
        left = np.add.reduceat(evidence.library.left(slot, large.ids, large.amplitude) ** 2, bins)
        products = evidence.inner[slot].of(large.ids)
        size = large.amplitude[products.where]
        summed = np.add.reduceat(evidence.library.residual[slot] ** 2, bins)
        summed += products.within(np.outer(size, size)) - 2.0 * products.with_residual @ size
        assert np.max(np.abs(summed - left) / fit.noise[slot].power) < 0.01


def test_a_level_at_rest_beyond_its_own_sigma_is_named_though_no_block_held_out_can_contradict_it() -> None:
    """The reference's own columns take it on, in every block alike, at the price of their prior."""

    def lean(_: dict[str, np.ndarray], readings: np.ndarray) -> None:
        readings[:, :2] += closed_form.GRAVITY_MPS2 * np.array([8e-4, -5e-4])

    case = closed_form.recording(lean, 81, moving=False)
    meta = case.meta.model_dump(exclude_none=True)
    meta["reference"]["level_sigma_deg"] = 0.005
    stated = Recording(case.samples, RecordingMeta.model_validate(meta), case.path, case.meta_path)
    (found,) = discrepancy([stated], closed_form.model()).findings
    assert found["effect"] == "level_error"
    tilts = [found["parameters"][name] for name in ("tilt_1", "tilt_2")]
    for tilt, true in zip(tilts, (-5e-4, -8e-4), strict=True):
        assert abs(tilt["value"] - true) < 3.3 * tilt["sigma"]


@pytest.mark.parametrize("late_s", [-0.4, 0.4])
def test_a_shaker_that_is_switched_on_or_off_at_another_time_makes_no_jumps(late_s: float) -> None:
    """Half a g of shaking for a minute, 0.4 s before or after what is said of it."""
    rng = np.random.default_rng(17)
    hertz, phase = rng.uniform(3.0, 9.0, 12), rng.uniform(0.0, 2.0 * math.pi, 12)

    def change(true: closed_form.Truth, readings: np.ndarray) -> None:
        shaken = (true["t"] > 60.0 + late_s) & (true["t"] < 120.0 + late_s)
        course = np.sin(2.0 * math.pi * hertz * true["t"][:, None] + phase).sum(axis=1)
        readings[shaken, 2] += course[shaken] - course[shaken].mean()

    case = closed_form.recording(change, 83, moving=False)
    span = {"kind": "vibration", "start_s": 60.0, "end_s": 120.0, "grms": 0.25, "band_hz": [3.0, 9.0]}
    meta = {**case.meta.model_dump(exclude_none=True), "motion": [{**span, "axis": [0.0, 0.0, 1.0]}]}
    report = discrepancy([replace(case, meta=RecordingMeta.model_validate(meta))], closed_form.model())
    assert (report.verdict, report.findings) == ("none", []), report.document["text"]


@pytest.mark.parametrize("late_s", [-0.4, 0.0, 0.4])
@pytest.mark.parametrize("step", [0.0, 20.0])
def test_a_span_is_widened_to_where_it_was_felt_and_no_further(late_s: float, step: float) -> None:
    """Samples of a readout in steps of 20 σ read the same but for one in sixteen."""
    rng = np.random.default_rng(23)
    time_s = np.arange(1, 20001) / 100.0
    shaken = (time_s > 60.0 + late_s) & (time_s <= 120.0 + late_s)
    along = rng.standard_normal(20000) + 300.0 * shaken * np.sin(40.0 * time_s)
    if step:
        along = np.diff(np.rint(np.cumsum(along + step / 16.0) / step), prepend=0.0) * step
    along[5800:5950:7] *= 40.0  # some wild samples before it are no shaking
    missing = np.zeros(20000, dtype=np.bool_)
    missing[5850:5900] = True
    along[missing] = np.linspace(0.0, 300.0, 50)  # what bridges a gap is none either
    residual = np.zeros((20000, 3))
    residual[:, 1] = along
    span = Vibration(60.0, 120.0, (0.0, 2.0, 0.0), 200.0, (5.0, 7.0))
    setup = Setup(Site.at(0.6), 0.0, np.eye(3), (span,))
    (found,) = spans_as_shaken(setup, time_s, residual, missing).motions
    assert found.start_s == pytest.approx(60.0 + min(late_s, 0.0), abs=0.03)
    assert found.end_s == pytest.approx(120.0 + max(late_s, 0.0), abs=0.03)


@pytest.mark.parametrize("stated_s", [50.0, 50.0042])
def test_a_turn_that_begins_in_the_sample_before_the_stated_one_is_no_step(
    stated_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stated on a sample's edge or 4.2 ms after it, it begins 0.2 ms before: the rate jumps where none is foretold."""
    real_s, end_s, angle_deg = 49.9998, 60.0, 90.0
    real = (real_s, end_s, angle_deg / (end_s - real_s), 1)
    monkeypatch.setattr(closed_form, "TURNS", (closed_form.TURNS[0], real, *closed_form.TURNS[2:]))
    sample = round(50.0 * closed_form.RATE_HZ) - 1

    def begun(_: closed_form.Truth, readings: np.ndarray) -> None:
        readings[sample, 4] += math.radians(real[2]) * (50.0 - real_s) * closed_form.RATE_HZ

    case = closed_form.recording(begun, 88)
    meta = case.meta.model_dump(exclude_none=True)
    meta["motion"][1] |= {"start_s": stated_s, "rate_dps": angle_deg / (end_s - stated_s)}
    report = discrepancy([replace(case, meta=RecordingMeta.model_validate(meta))], closed_form.model())
    assert (report.verdict, report.findings) == ("none", []), report.document["text"]


@pytest.mark.parametrize("sigmas", [5.0, 12.0])
def test_a_shift_at_rest_that_the_stated_level_cannot_be_off_by_is_not_laid_to_the_level(sigmas: float) -> None:
    """At rest a tilt looks the same: no held-out block prefers the shift, but what is known of the tilt does."""
    level_sigma_deg = 0.02
    shift = sigmas * np.radians(level_sigma_deg) * closed_form.GRAVITY_MPS2

    def shifted(_: closed_form.Truth, readings: np.ndarray) -> None:
        readings[:, 1] += shift

    case = closed_form.recording(shifted, 5, moving=False)
    meta = case.meta.model_dump(exclude_none=True)
    meta["reference"]["level_sigma_deg"] = level_sigma_deg
    shown = Recording(case.samples, RecordingMeta.model_validate(meta), case.path, case.meta_path)
    report = discrepancy([shown], closed_form.model())
    (finding,) = report.findings
    names = {finding["effect"], *(one["effect"] for one in finding["alternatives"])}
    assert {"bias_shift", "level_error"} <= names
    assert report.document["rejected"] == []


def test_what_hides_in_large_residuals_is_looked_for_beside_all_that_the_reference_is_unsure_of(tmp_path: Path) -> None:
    """A case tilted by 0.15° of a block whose noise is free: held against the residual nothing seemed to be felt."""
    case = hidden_case(90623, 22, tmp_path)
    (hidden,) = case.truth["effects"]
    (found,) = discrepancy([case.recording], case.model).findings
    assert (found["effect"], found["channel"]) == (hidden["effect"], hidden["channel"]) == ("level_error", "all")
    for name in ("tilt_1", "tilt_2"):
        value = found["parameters"][name]
        assert abs(value["value"] - hidden["parameters"][name]) < 3.3 * value["sigma"]


def test_a_delay_that_is_known_from_the_schedule_is_one_number_and_charged_for_as_such(tmp_path: Path) -> None:
    """Seven σ, of which noise took two: five lengths of chord, which are one column there, cost what it lacked."""
    case = hidden_case(90622, 190, tmp_path)
    (hidden,) = case.truth["effects"]
    (found,) = discrepancy([case.recording], case.model).findings
    names = [found, *found["alternatives"]]
    assert (hidden["effect"], hidden["channel"]) in [(one["effect"], one["channel"]) for one in names]


def test_a_clock_is_told_though_nearly_all_it_does_is_done_by_turns_that_come_late(tmp_path: Path) -> None:
    """What it makes of gravity is less than a ten-millionth of what it does at the ends of a laser gyro's turns."""
    case = hidden_case(90629, 0, tmp_path)
    (found,) = discrepancy([case.recording], case.model).findings
    assert (found["effect"], found["channel"]) == ("clock_scale", "all")
    (true,) = case.truth["effects"]
    error = found["parameters"]["error"]
    assert abs(error["value"] - true["parameters"]["error"]) < 3.3 * error["sigma"]


def test_that_turns_are_at_other_times_than_stated_leaves_what_the_table_is_unsure_of_felt(tmp_path: Path) -> None:
    """A wrong clock: what 4 ms make of the ends of eight turns passed for noise beside which no angle is felt."""
    case = hidden_case(90625, 850, tmp_path)
    (hidden,) = case.truth["effects"]
    (found,) = discrepancy([case.recording], case.model).findings
    assert (found["effect"], found["alternatives"]) == ("clock_scale", [])
    error = found["parameters"]["error"]
    assert abs(error["value"] - hidden["parameters"]["error"]) < 3.3 * error["sigma"]
