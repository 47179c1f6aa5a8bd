"""What hides in noise: readout effects smaller than it, jumps and waves that a wide noise model would swallow."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import closed_form
import numpy as np
import pytest
from closed_form import DURATION_S, RATE_HZ, WHITE, Change, Truth, model, recording
from hidden_case import hidden_case

from drivers.recording import Recording, RecordingMeta
from inertial.documents import BlockModel, EffectEntry
from simulators.discrepancy.candidates import Library
from simulators.discrepancy.compare import compare
from simulators.discrepancy.evidence import Evidence
from simulators.discrepancy.report import discrepancy
from simulators.discrepancy.sparse import find_sparse
from simulators.discrepancy.unsteady import level_spread
from simulators.effects import get_effect
from simulators.effects.base import SampleEffect

GYRO_SIGMA = WHITE["gyro"] * np.sqrt(RATE_HZ)
DRAWS = 40_000


@pytest.mark.parametrize("sigma", [0.02, 0.5, 3.0])
@pytest.mark.parametrize(("name", "parameter"), [("dead_band", "half_width"), ("saturation", "limit")])
def test_mean_change_is_the_mean_of_what_becomes_of_noisy_readings(name: str, parameter: str, sigma: float) -> None:
    """Against DRAWS simulated readings: within 5σ of their mean, of which 42 are looked at."""
    effect, values = get_effect(name), {parameter: 1.0}
    assert isinstance(effect, SampleEffect)
    rng = np.random.default_rng(5)
    for reading in (-2.1, -1.0, -0.3, 0.0, 0.7, 1.02, 1.9):
        noisy = reading + sigma * rng.standard_normal(DRAWS)
        change = effect.changed(noisy, values) - noisy
        said = float(effect.mean_change(np.array([reading]), sigma, values)[0])
        assert abs(change.mean() - said) <= 5.0 * change.std() / np.sqrt(DRAWS) + 1e-12


@pytest.mark.parametrize("sigmas", [2.0, 3.0, 4.0])
def test_a_dead_band_of_the_noises_own_width_is_named_and_nothing_of_the_noise_that_it_makes(sigmas: float) -> None:
    """Earth's rate along a gyro is up to 5 σ of a sample; the band takes input and noise together."""
    case = recording(None, 41)
    samples = case.samples.copy()
    half_width = sigmas * GYRO_SIGMA
    silent = np.abs(samples["dtheta"][:, 2]) < half_width / RATE_HZ
    samples["dtheta"][silent, 2] = 0.0
    report = discrepancy([replace(case, samples=samples)], model())
    found = {(one["effect"], one["channel"]): one["parameters"] for one in report.findings}
    assert set(found) == {("dead_band", "gyro_z")}, report.document["text"]
    width = found["dead_band", "gyro_z"]["half_width"]
    assert abs(width["value"] - half_width) < 3.3 * width["sigma"]


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("sigmas", [0.5, 1.0, 2.0])
def test_a_fine_readout_at_rest_that_is_often_zero_and_never_a_little_more_has_a_dead_band(
    sigmas: float, *, free: bool
) -> None:
    """No mean tells it: the input is next to nothing, and so is what the band makes of it."""
    case, half_width = recording(None, 43, moving=False), sigmas * GYRO_SIGMA
    samples = case.samples.copy()
    samples["dtheta"][np.abs(samples["dtheta"][:, 1]) < half_width / RATE_HZ, 1] = 0.0
    (found,) = discrepancy([replace(case, samples=samples)], model(free=free)).findings
    assert (found["effect"], found["channel"], found["alternatives"]) == ("dead_band", "gyro_y", [])
    width = found["parameters"]["half_width"]
    assert abs(width["value"] - half_width) < 3.3 * width["sigma"]


@pytest.mark.parametrize("channel", ["gyro_y", "accel_z"])
def test_zeros_of_steps_that_the_model_does_not_know_or_of_a_sensor_that_drops_out_are_no_dead_band(
    channel: str,
) -> None:
    """A gyro that reads in steps of its noise, and an accelerometer that reads nothing of g for seconds."""
    case = recording(None, 44, moving=False)
    samples = case.samples.copy()
    if channel == "gyro_y":
        samples["dtheta"] = np.rint(samples["dtheta"] / (GYRO_SIGMA / RATE_HZ)) * GYRO_SIGMA / RATE_HZ
    else:
        samples["dv"][1000:1100, 2] = 0.0
    report = discrepancy([replace(case, samples=samples)], model())
    assert "dead_band" not in {one["effect"] for one in report.findings}, report.document["text"]


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("sigmas", [7.0, 40.0])
def test_a_dead_band_wider_than_the_noise_leaves_no_sample_that_is_known_without_any(
    monkeypatch: pytest.MonkeyPatch, sigmas: float, *, free: bool
) -> None:
    """Nine tenths of all samples are silent. One turn just beyond the band speaks, and a scale error in all turns."""
    half_width = sigmas * GYRO_SIGMA
    creep = (205.0, 225.0, float(np.degrees(1.3 * half_width)), 2)
    monkeypatch.setattr(closed_form, "TURNS", (*closed_form.TURNS, creep))

    def more(_: Truth, readings: np.ndarray) -> None:
        readings[:, 5] *= 1.002

    case = recording(more, 47)
    samples = case.samples.copy()
    samples["dtheta"][np.abs(samples["dtheta"][:, 2]) < half_width / RATE_HZ, 2] = 0.0
    report = discrepancy([replace(case, samples=samples)], model(free=free))
    found = {(one["effect"], one["channel"]): one["parameters"] for one in report.findings}
    assert set(found) == {("dead_band", "gyro_z"), ("scale_factor", "gyro_z")}, report.document["text"]
    width, error = found["dead_band", "gyro_z"]["half_width"], found["scale_factor", "gyro_z"]["error"]
    assert abs(width["value"] - half_width) < 3.3 * width["sigma"]
    assert abs(abs(error["value"]) - 0.002) < 3.3 * error["sigma"]


def test_a_telegraph_is_not_sold_as_a_random_walk() -> None:
    """Twenty flips between two levels make up the power of a random walk, not its kind."""
    rng = np.random.default_rng(7)
    flips = np.sort(rng.uniform(0.05, 0.95, 20)) * DURATION_S

    def change(true: Truth, readings: np.ndarray) -> None:
        readings[:, 3] += 0.6 * GYRO_SIGMA * np.where(np.searchsorted(flips, true["t"]) % 2, 1.0, -1.0)

    report = discrepancy([recording(change, 42)], model())
    assert report.verdict == "unknown"
    terms = report.document["remaining"]["empirical"]
    assert [term["channel"] for term in terms] == ["gyro_x"]
    assert "jumps" in terms[0]["term"], terms


def test_a_sawtooth_is_lines_that_belong_together_and_no_name() -> None:
    def change(true: Truth, readings: np.ndarray) -> None:
        phase = (true["t"] / 17.3) % 1.0
        readings[:, 4] += 4.0 * GYRO_SIGMA * (np.exp(-phase / 0.1) - 0.1)

    report = discrepancy([recording(change, 43, moving=False)], model(free=True))
    assert report.verdict == "unknown"
    assert report.findings == []


def walk(column: int, sigmas: float, seed: list[int]) -> Change:
    """Return a random walk of a gyro by so many σ of a sample each sample."""
    rng = np.random.default_rng(seed)

    def change(true: Truth, readings: np.ndarray) -> None:
        readings[:, column] += sigmas * GYRO_SIGMA * np.cumsum(rng.standard_normal(len(true["t"])))

    return change


@pytest.mark.parametrize("seed", range(4))
def test_a_random_walk_is_one(seed: int) -> None:
    report = discrepancy([recording(walk(3, 0.1, [44, seed]), 45 + seed)], model())
    assert {(one["effect"], one["channel"]) for one in report.findings} == {("rate_random_walk", "gyro_x")}
    assert report.document["remaining"]["empirical"] == []


def test_small_walks_are_never_taken_for_a_few_jumps() -> None:
    """Held against noise with a name, jumps that are none win by nine nats once in eight thousand walks."""
    for seed in range(24):
        case = recording(walk(4, 0.01, [seed, 7]), 1000 + seed, moving=False)
        evidence = Evidence(Library([compare(case, model())], only=[], plain=True))
        assert find_sparse(evidence, evidence.fit([])) == []


def test_a_few_jumps_are_no_walk() -> None:
    rng = np.random.default_rng(31)

    def change(true: Truth, readings: np.ndarray) -> None:
        for jump_s in (37.0, 62.0, 111.0, 118.0, 160.0, 203.0):
            readings[true["t"] > jump_s, 4] += rng.choice([-1.0, 1.0]) * GYRO_SIGMA

    evidence = Evidence(Library([compare(recording(change, 91, moving=False), model())], only=[], plain=True))
    (found,) = find_sparse(evidence, evidence.fit([]))
    assert (found.slot, len(found.steps)) == ((0, 4), 6)


@pytest.mark.parametrize("seed", [9, 10, 11])
def test_a_random_walk_of_one_sensor_is_no_mount_that_sways_beside_what_grows_with_temperature(seed: int) -> None:
    """A mount that swayed would do so on more than one sensor; less a smooth course a walk looks as if it swayed."""
    report = discrepancy([recording(walk(3, 0.05, [58, seed]), 160 + seed, warming=True)], model())
    assert [(one["effect"], one["channel"]) for one in report.findings] == [("rate_random_walk", "gyro_x")]


def test_one_sensor_that_walks_in_two_recordings_is_no_mount_that_sways() -> None:
    cases = [recording(walk(3, 0.1, [44, seed]), 45 + seed) for seed in range(2)]
    evidence = Evidence(Library([compare(case, model()) for case in cases], only=set()))
    assert evidence.stand(evidence.fit([]))
    assert not evidence.sways


def test_a_false_clock_is_not_sold_as_a_delay() -> None:
    """At 50 ppm the end of the record is 12 ms late, which a delay of half of it explains in part."""
    case = recording(None, 49)
    samples = case.samples.copy()
    samples["time"] *= 1.0 + 5e-5
    report = discrepancy([replace(case, samples=samples)], model())
    first = report.findings[0]
    assert first["effect"] == "clock_scale", report.document["text"]
    error = first["parameters"]["error"]
    assert abs(error["value"] - 5e-5) < 3.3 * error["sigma"]


def test_a_register_that_stands_still_for_five_samples_of_a_turn_is_named() -> None:
    case = recording(None, 50)
    samples = case.samples.copy()
    start = round(21.0 * RATE_HZ)
    samples["dv"][start : start + 5, 1] = samples["dv"][start - 1, 1]
    report = discrepancy([replace(case, samples=samples)], model())
    assert {(one["effect"], one["channel"]) for one in report.findings} == {("stuck_samples", "accel_y")}


def test_what_one_turn_shows_is_not_refused_for_what_the_rest_cannot_tell(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The turn lies in one of the blocks that are held out: the others say nothing of the misalignment."""
    monkeypatch.setattr(closed_form, "TURNS", ((20.5, 23.5, 9.0, 2),))

    def change(true: Truth, readings: np.ndarray) -> None:
        readings[:, 3] += 4e-4 * true["gyro"][:, 2]

    report = discrepancy([recording(change, 51)], model())
    names = {(name["effect"], name["channel"]) for one in report.findings for name in (one, *one["alternatives"])}
    assert ("misalignment", "gyro_x<-gyro_z") in names, report.document["text"]


def test_a_few_outliers_are_no_larger_random_walk() -> None:
    """Sixteen make up a sixth of all power, which of Gaussian noise is eight σ more than stated."""

    def change(_: Truth, readings: np.ndarray) -> None:
        readings[150:4800:300, 3] += 7.0 * GYRO_SIGMA * np.resize([1.0, -1.0], 16)

    report = discrepancy([recording(change, 52, moving=False)], model())
    assert (report.verdict, report.findings) == ("none", []), report.document["text"]


def test_what_depends_on_the_attitude_is_no_noise_of_turns() -> None:
    """Noise that is larger while the block turns is weighed down; what a turn does to a sensor is not noise."""

    def change(true: Truth, readings: np.ndarray) -> None:
        readings[:, 5] += 1e-5 * true["accel"][:, 0] ** 2

    scene = compare(recording(change, 55), model())
    assert np.all(level_spread(scene, 5)[1] == 1.0)
    noisy = recording(change, 55)
    turning = np.any([(noisy.samples["time"] > a) & (noisy.samples["time"] <= b) for a, b, *_ in closed_form.TURNS], 0)
    samples = noisy.samples.copy()
    samples["dtheta"][turning, 2] += (
        3.0 * WHITE["gyro"] / np.sqrt(RATE_HZ) * np.random.default_rng(56).standard_normal(turning.sum())
    )
    spread = level_spread(compare(replace(noisy, samples=samples), model()), 5)[1]
    assert 2.5 < spread.max() < 4.0  # √10


def test_two_names_that_only_together_leave_quiet_noise_are_found() -> None:
    """A drift and a step back, of one gyro: with either alone what is left looks like slow noise."""

    def change(true: Truth, readings: np.ndarray) -> None:
        readings[:, 4] += 0.95 * GYRO_SIGMA * (true["t"] / 120.0 - (true["t"] > 120.0))

    report = discrepancy([recording(change, 57, moving=False)], model())
    names = {(name["effect"], name["channel"]) for one in report.findings for name in (one, *one["alternatives"])}
    assert {("bias_step", "gyro_y"), ("drift", "gyro_y")} <= names, report.document["text"]


def test_a_dead_band_is_met_where_the_tilted_block_really_came_to_it() -> None:
    """A tilt within its σ turns a part of every turn onto the sensor, two or three σ of it."""
    tilt, half_width = 1e-4, 4e-5

    def hide(true: Truth, readings: np.ndarray) -> None:
        lean = closed_form.rotation(0, tilt).T
        readings[:, :3], readings[:, 3:] = true["accel"] @ lean.T, true["gyro"] @ lean.T

    case = recording(hide, 120)
    samples = case.samples.copy()
    rates = samples["dtheta"][:, 1] * RATE_HZ
    samples["dtheta"][:, 1] = np.where(np.abs(rates) < half_width, 0.0, rates) / RATE_HZ
    given = case.meta.model_dump(exclude_none=True)
    given["reference"] |= {"level_sigma_deg": math.degrees(tilt), "level_frame": "body"}
    meta = RecordingMeta.model_validate(given)
    report = discrepancy([Recording(samples, meta, case.path, case.meta_path)], model())
    found = [(one["effect"], one["channel"]) for one in report.findings]
    assert set(found) - {("random_walk", "gyro_y")} == {("dead_band", "gyro_y")}  # noise is silenced in part
    width = report.findings[found.index(("dead_band", "gyro_y"))]["parameters"]["half_width"]
    assert abs(width["value"] - half_width) < 3.3 * width["sigma"]


@pytest.mark.parametrize("free", [False, True])
def test_a_line_that_sweeps_is_structure_and_no_larger_noise(free: bool) -> None:
    """From 0.02 to 2 Hz: as flat a spectrum as noise of that band."""

    def hide(true: Truth, readings: np.ndarray) -> None:
        hertz = 0.02 + 0.5 * 1.98 * true["t"] / DURATION_S
        readings[:, 1] += 2.4 * WHITE["accel"] * np.sin(2.0 * np.pi * hertz * true["t"])

    report = discrepancy([recording(hide, 121, moving=False)], model(free=free))
    assert (report.verdict, report.findings) == ("unknown", []), report.document["text"]
    terms = [(one["channel"], one["term"]) for one in report.document["remaining"]["empirical"]]
    assert [channel for channel, term in terms if "sweeps" in term] == ["accel_y"]


def test_a_wave_that_repeats_is_structure_and_no_larger_noise() -> None:
    """A relaxation oscillation: some ten harmonics, each of them small."""

    def hide(true: Truth, readings: np.ndarray) -> None:
        phase = (true["t"] / 17.3) % 1.0
        readings[:, 4] += 10.0 * WHITE["gyro"] * (1.0 - np.exp(-phase / 0.1) - 0.9)

    report = discrepancy([recording(hide, 122, moving=False)], model(free=True))
    assert (report.verdict, report.findings) == ("unknown", []), report.document["text"]
    assert {one["channel"] for one in report.document["remaining"]["empirical"]} == {"gyro_y"}


def test_what_the_model_is_unsure_of_is_no_finding() -> None:
    def hide(_: Truth, readings: np.ndarray) -> None:
        readings[:, 0] += 4e-3

    known = {"value": 3e-3, "sigma": 7e-4, "unit": "m/s^2"}
    entry = {"effect": "bias_shift", "channel": "accel_x", "parameters": {"shift": known}}
    believed = BlockModel.model_validate({**model().model_dump(), "effects": [entry]})
    report = discrepancy([recording(hide, 123)], believed)
    assert (report.verdict, report.findings) == ("none", []), report.document["text"]
    sure = {**entry, "parameters": {"shift": {**known, "sigma": 1e-6}}}
    report = discrepancy([recording(hide, 123)], believed.model_copy(update={"effects": [EffectEntry(**sure)]}))
    assert [(one["effect"], one["channel"]) for one in report.findings] == [("bias_shift", "accel_x")]


@pytest.mark.parametrize("seed", [3, 11, 12])
def test_where_a_small_walk_has_wandered_to_is_no_shift(seed: int) -> None:
    """At rest the mean of a random walk is off by what its other coefficients foretell, and so is its course."""
    report = discrepancy([recording(walk(5, 0.03, [57, seed]), 60 + seed, moving=False)], model())
    assert {(one["effect"], one["channel"]) for one in report.findings} == {("rate_random_walk", "gyro_z")}


def test_a_strong_line_is_one_and_leaves_what_else_its_sensor_does_a_name() -> None:
    """Beside 700 σ of a line a thousandth of its evidence is a drift, which no error of the line's form could be."""

    def change(true: Truth, readings: np.ndarray) -> None:
        readings[:, 3] += 15.0 * GYRO_SIGMA * np.sin(2.0 * math.pi * 1.2345678 * true["t"] + 0.3)
        readings[:, 3] += 0.7 * GYRO_SIGMA * true["t"] / DURATION_S

    report = discrepancy([recording(change, 67)], model())
    found = {(one["effect"], one["channel"]): one["parameters"] for one in report.findings}
    assert set(found) == {("sinusoid", "gyro_x"), ("drift", "gyro_x")}, report.document["text"]
    frequency = found["sinusoid", "gyro_x"]["frequency"]
    assert abs(frequency["value"] - 1.2345678) < 3.3 * frequency["sigma"]
    assert report.document["remaining"]["empirical"] == []


def test_a_steady_supply_off_its_nominal_may_be_what_a_bias_comes_from() -> None:
    def change(_: Truth, readings: np.ndarray) -> None:
        readings[:, 0] += 1e-3

    case = recording(change, 73, moving=False)
    samples = case.samples.copy()
    samples["supply"] = 27.5
    (found,) = discrepancy([replace(case, samples=samples)], model()).findings
    assert found["effect"] == "bias_shift"
    assert ("supply_sensitivity", "accel_x") in {(one["effect"], one["channel"]) for one in found["alternatives"]}


def test_a_limit_a_little_below_a_steady_turn_is_a_limit_and_no_curve(tmp_path: Path) -> None:
    """One turn of eight, 2 % and 150 steps a sample beyond it: a power of the input does nearly as well."""
    case = hidden_case(90614, 271, tmp_path)
    (hidden,) = case.truth["effects"]
    report = discrepancy([case.recording], case.model)
    (found,) = report.findings
    assert (found["effect"], found["channel"]) == ("saturation", hidden["channel"])
    assert found["parameters"]["limit"]["value"] == pytest.approx(hidden["parameters"]["limit"], rel=1e-4)


@pytest.mark.parametrize("free", [False, True])
def test_noise_of_a_sample_is_found_beside_what_jumps_and_beside_a_line(*, free: bool) -> None:
    """A gyro that reads 26σ too much in each turn, and one with a line of 3σ."""

    def off(true: Truth, readings: np.ndarray) -> None:
        turning = np.abs(true["gyro"]).max(axis=1) > 1e-2
        readings[turning, 3] += 7e-6 * 50.0
        readings[:, 4] += 7e-6 * 6.0 * np.sin(2.0 * math.pi * 1.3 * np.arange(len(readings)) / RATE_HZ)

    found = compare(recording(off, 31), model(free=free)).noise_sigma[3:]
    assert found == pytest.approx([GYRO_SIGMA] * 3, rel=0.25)


@pytest.mark.parametrize("number", [239, 474])
def test_an_input_times_the_size_of_another_is_no_sensitivity_to_the_first(number: int, tmp_path: Path) -> None:
    """A force that nearly keeps its size does for it what the first alone does, but for what noise takes in."""
    case = hidden_case(90617, number, tmp_path)
    assert case.truth["strange"] == "product"
    report = discrepancy([case.recording], case.model)
    assert report.verdict == "unknown"
    assert not report.findings
