"""Readings in steps coarser than the noise, and vibration that hides it: noise as stated is nothing to find."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import closed_form
import numpy as np
import pytest
from closed_form import RATE_HZ, WHITE, model, recording
from hidden_case import hidden_case
from scipy.fft import dct

from drivers.recording import Recording, RecordingMeta
from inertial.documents import BlockModel, ChannelNoise, Noise
from simulators.discrepancy.candidates import Library
from simulators.discrepancy.compare import compare
from simulators.discrepancy.evidence import Evidence
from simulators.discrepancy.nonstationarity import find_unsteady
from simulators.discrepancy.report import discrepancy
from simulators.discrepancy.unsteady import level_spread
from simulators.discrepancy.whitening import ROUNDED_AT, cosine_basis, whittle

STEP_RAD = 5.0 * WHITE["gyro"] / np.sqrt(RATE_HZ)
RECORDS, COUNT, INTERVAL_S = 24, 16384, 0.01


def in_steps(increments: np.ndarray, step: float) -> np.ndarray:
    """Return increments read from an integral that is rounded to whole steps."""
    total = np.cumsum(increments, axis=0)
    return np.diff(np.rint(total / step), axis=0, prepend=0.0) * step


def model_in_steps(step: float, *, free: bool = False) -> BlockModel:
    """Return an ideal block that states the noise, and that its gyros read in steps [rad]."""
    channels = {f"accel_{axis}": ChannelNoise(white=WHITE["accel"]) for axis in "xyz"}
    channels |= {f"gyro_{axis}": ChannelNoise(white=WHITE["gyro"], quantisation=step) for axis in "xyz"}
    return BlockModel(noise=Noise(**channels, free=free))


@pytest.mark.parametrize("noise_steps", [0.15, 0.3, 1.0])
@pytest.mark.parametrize("rate_steps", [0.07, 0.31, 0.5])
def test_power_of_rounding_errors_is_that_of_simulated_ones(noise_steps: float, rate_steps: float) -> None:
    """Per bin the mean of RECORDS periodograms: σ of its ratio to the truth is √(2 / coefficients)."""
    noise = ChannelNoise(white=noise_steps * np.sqrt(INTERVAL_S), quantisation=INTERVAL_S)
    basis = cosine_basis(COUNT, INTERVAL_S)
    rng = np.random.default_rng(int(100 * noise_steps + 1000 * rate_steps))
    found, said = np.zeros(len(basis.counts)), np.zeros(len(basis.counts))
    for _ in range(RECORDS):
        rates = rate_steps + noise_steps * rng.standard_normal(COUNT)
        read = in_steps(rates * INTERVAL_S, INTERVAL_S) / INTERVAL_S
        power = dct(read - read.mean(), norm="ortho") ** 2
        found += np.add.reduceat(power, basis.bounds[:-1]) / basis.counts / RECORDS
        said += basis.stated(noise, 0.0, np.full(COUNT, rate_steps)) / RECORDS
    high = basis.frequency_hz > 1.0
    off = (found / said - 1.0)[high] * np.sqrt(0.5 * RECORDS * basis.counts[high])
    assert np.mean(off**2) < 4.0  # 1 by χ²; twice the σ for what the bins average over
    if noise_steps < 0.2:  # as if every error were by itself: the bound would find it
        white = basis.stated(noise, 0.0)
        assert np.mean(((found / white - 1.0)[high] * np.sqrt(0.5 * RECORDS * basis.counts[high])) ** 2) > 100.0


@pytest.mark.parametrize("free", [False, True])
def test_a_gyro_that_reads_in_coarse_steps_hides_nothing(free: bool) -> None:
    case = recording(None, 31)
    samples = case.samples.copy()
    samples["dtheta"] = in_steps(samples["dtheta"], STEP_RAD)
    believed = model_in_steps(STEP_RAD, free=free)
    report = discrepancy([replace(case, samples=samples)], believed)
    assert (report.verdict, report.findings) == ("none", []), report.document["text"]


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("steps", [1.0, 3.0, 10.0])
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_readout_finer_than_stated_is_a_better_sensor(share: float, steps: float, free: bool) -> None:
    """Its step is a share of that of so many σ of a sample's noise which the model states, or there is none."""
    step = steps * WHITE["gyro"] / np.sqrt(RATE_HZ)
    case = recording(None, 32)
    samples = case.samples.copy()
    if share:
        samples["dtheta"] = in_steps(samples["dtheta"], share * step)
    report = discrepancy([replace(case, samples=samples)], model_in_steps(step, free=free))
    assert (report.verdict, report.findings) == ("none", []), report.document["text"]


@pytest.mark.parametrize("effect", ["bias_shift", "random_walk", "rate_random_walk"])
def test_what_a_sensor_with_a_finer_readout_has_beside_is_found(effect: str) -> None:
    """On gyro_x: a shift, white noise as large again, or a walk of its rate."""
    rng, step = np.random.default_rng(5), 5.0 * WHITE["gyro"] / np.sqrt(RATE_HZ)

    def disturbed(true: dict[str, np.ndarray], readings: np.ndarray) -> None:
        white = rng.standard_normal(true["t"].size)
        readings[:, 3] += {
            "bias_shift": np.full_like(white, 5e-6),
            "random_walk": WHITE["gyro"] * np.sqrt(RATE_HZ) * white,
            "rate_random_walk": 2e-6 / np.sqrt(RATE_HZ) * np.cumsum(white),
        }[effect]

    report = discrepancy([recording(disturbed, 5)], model_in_steps(step))
    assert report.verdict == "named", report.document["text"]
    assert [(one["effect"], one["channel"]) for one in report.findings] == [(effect, "gyro_x")]


def remainder(samples: np.ndarray, seed: int) -> list[str]:
    """Return the channels whose remainder comes and goes, of a recording with these samples."""
    case = replace(recording(None, seed), samples=samples)
    evidence = Evidence(Library([compare(case, model_in_steps(STEP_RAD))], only=[], plain=True))
    return [one.channel for one in find_unsteady(evidence, evidence.fit([]))]


def test_rounding_errors_that_come_and_go_with_turns_are_nothing_unsteady() -> None:
    """Three gyros of eight recordings, each at a risk of a thousandth of itself in noise that is steady."""
    for seed in range(8):
        samples = recording(None, 200 + seed).samples.copy()
        samples["dtheta"] = in_steps(samples["dtheta"], STEP_RAD)
        assert remainder(samples, 200 + seed) == []


def test_bursts_smaller_than_the_steps_they_are_read_in_come_and_go() -> None:
    samples = recording(None, 210).samples.copy()
    for start_s in (37.0, 66.0, 112.0, 149.0, 205.0):
        since_s = np.clip(samples["time"] - start_s, 0.0, None)
        burst = np.exp(-since_s / 2.0) * np.sin(2.0 * np.pi * 1.3 * since_s)
        samples["dtheta"][:, 1] += 0.6 * STEP_RAD * burst
    samples["dtheta"] = in_steps(samples["dtheta"], STEP_RAD)
    assert remainder(samples, 210) == ["gyro_y"]


def test_vibration_along_one_axis_and_then_another_is_no_noise_of_either() -> None:
    case = recording(None, 32, moving=False)
    shaken = [
        {
            "kind": "vibration",
            "start_s": start,
            "end_s": start + 60.0,
            "grms": 1e-4,
            "band_hz": [1.0, 9.0],
            "axis": axis,
        }
        for start, axis in ((40.0, [0.0, 1.0, 0.0]), (140.0, [1.0, 0.0, 0.0]))
    ]
    meta = RecordingMeta.model_validate({**case.meta.model_dump(exclude_none=True), "motion": shaken})
    report = discrepancy([Recording(case.samples, meta, case.path, case.meta_path)], model())
    assert report.verdict == "none", report.document["text"]


def test_a_clipped_channel_is_named_with_its_limit_and_no_other_course_is_seen_in_it() -> None:
    """Half of its samples are gone so, in long gaps; what bridges them may pass for a random walk of 3σ."""
    case = recording(None, 33)
    samples = case.samples.copy()
    samples["dv"][:, 1] = np.clip(samples["dv"][:, 1], -5.0 / RATE_HZ, 5.0 / RATE_HZ)
    report = discrepancy([replace(case, samples=samples)], model())
    found = {(one["effect"], one["channel"]): one["parameters"] for one in report.findings}
    assert set(found) - {("rate_random_walk", "accel_y")} == {("saturation", "accel_y")}
    limit = found["saturation", "accel_y"]["limit"]
    assert abs(limit["value"] - 5.0) < 3.0 * limit["sigma"]


@pytest.mark.parametrize(("step", "beyond"), [(0.0, 9e-3), (STEP_RAD, 9e-3), (STEP_RAD, 8e-5)])
def test_a_limit_met_by_a_turn_at_one_rate_is_told_by_the_noise_that_is_gone(step: float, beyond: float) -> None:
    """No other turn is as fast: any curve that bends beyond 9 deg/s explains the mean, and keeps the noise.

    The input is beyond the limit [rad/s] by so many steps, or by one and six σ.
    """
    case, limit = recording(None, 34), np.radians(18.0) - beyond
    samples = case.samples.copy()
    samples["dtheta"][:, 2] = np.clip(samples["dtheta"][:, 2] * RATE_HZ, -limit, limit) / RATE_HZ
    if step:
        samples["dtheta"] = in_steps(samples["dtheta"], step)
    believed = model_in_steps(step)
    report = discrepancy([replace(case, samples=samples)], believed)
    assert [(one["effect"], one["channel"]) for one in report.findings] == [("saturation", "gyro_z")]
    assert abs(report.findings[0]["parameters"]["limit"]["value"] - limit) < 1e-3 * limit


def test_bursts_under_rounding_at_rest_are_no_larger_white_noise() -> None:
    case = recording(None, 35, moving=False)
    samples, rng = case.samples.copy(), np.random.default_rng(35)
    for start in rng.uniform(0.0, 220.0, 8):
        lag = np.clip(samples["time"] - start, 0.0, None)
        wave = np.exp(-lag / 2.0) * np.sin(2.0 * np.pi * rng.uniform(0.8, 2.2) * lag)
        samples["dtheta"][:, 1] += 5.0 * WHITE["gyro"] / np.sqrt(RATE_HZ) * rng.choice([-1.0, 1.0]) * wave
    samples["dtheta"] = in_steps(samples["dtheta"], 2.0 * STEP_RAD)
    believed = model_in_steps(2.0 * STEP_RAD)
    report = discrepancy([replace(case, samples=samples)], believed)
    assert (report.verdict, report.findings) == ("unknown", []), report.document["text"]
    assert {term["channel"] for term in report.document["remaining"]["empirical"]} == {"gyro_y"}


def test_a_limit_that_the_input_passes_by_one_sigma_leaves_no_lines(tmp_path: Path) -> None:
    """The noise above the limit is gone, most of it, and what is left is rounded to lines where there were none."""
    case = hidden_case(90611, 477, tmp_path)
    report = discrepancy([case.recording], case.model)
    assert [(one["effect"], one["channel"]) for one in report.findings] == [("saturation", "accel_x")]
    assert report.document["remaining"]["empirical"] == []
    found = report.findings[0]["parameters"]["limit"]
    (true,) = case.truth["effects"]
    assert abs(found["value"] - true["parameters"]["limit"]) < 3.3 * found["sigma"]


def test_a_limit_met_with_a_third_of_the_stated_noise_is_no_scale_that_differs_by_sign(tmp_path: Path) -> None:
    """Of the noise that is stated the input passes it by two σ, of the noise that is there by seven."""
    case = hidden_case(90626, 241, tmp_path)
    report = discrepancy([case.recording], case.model)
    (found,) = report.findings
    assert (found["effect"], found["channel"], found["alternatives"]) == ("saturation", "gyro_x", [])
    (true,) = case.truth["effects"]
    limit = found["parameters"]["limit"]
    assert abs(limit["value"] - true["parameters"]["limit"]) < 3.3 * limit["sigma"]


@pytest.mark.parametrize("noise_in_steps", [0.1, 0.2])
def test_a_line_where_the_motion_makes_none_is_named_though_smaller_than_rounding_makes_elsewhere(
    noise_in_steps: float,
) -> None:
    """Earth's rate is not whole steps a sample: its rounding errors are lines, but not at every frequency."""
    step, hertz = WHITE["gyro"] / np.sqrt(RATE_HZ) / noise_in_steps, 1.31

    def hum(true: dict[str, np.ndarray], readings: np.ndarray) -> None:
        readings[:, 4] += 4e-6 * np.cos(2.0 * np.pi * hertz * true["t"])

    case = recording(hum, 43, moving=False)
    samples = case.samples.copy()
    samples["dtheta"] = in_steps(samples["dtheta"], step)
    believed = model_in_steps(step, free=True)
    report = discrepancy([replace(case, samples=samples)], believed)
    assert [(one["effect"], one["channel"]) for one in report.findings] == [("sinusoid", "gyro_y")]
    found = report.findings[0]["parameters"]["frequency"]
    assert abs(found["value"] - hertz) < 4.5 * found["sigma"]


def test_the_largest_of_many_lines_beside_each_other_is_none(tmp_path: Path) -> None:
    """Noise of a third of the stated jolts a readout in steps less: its errors are a higher hump than is reckoned with.

    The largest in it was named, 31 nats above the noise as fitted and none above what was beside it.
    """
    case = hidden_case(90618, 68, tmp_path)
    assert case.truth["effects"] == []
    report = discrepancy([case.recording], case.model)
    assert report.findings == [], report.document["text"]


@pytest.mark.parametrize(("number", "names"), [(730, ["latitude_error"]), (768, [])])
def test_noise_of_a_third_of_what_is_stated_leaves_lines_of_rounding_and_nothing_else(
    number: int, names: list[str], tmp_path: Path
) -> None:
    """At rest: thirty lines that no name explains hid a latitude of 80 σ; the largest of them was a pick-up."""
    case = hidden_case(90625, number, tmp_path)
    assert case.truth["family"] == "noise_level"
    report = discrepancy([case.recording], case.model)
    assert [one["effect"] for one in report.findings] == names, report.document["text"]
    assert report.document["remaining"]["empirical"] == []


def test_sensors_exchanged_are_found_though_one_of_them_was_violently_shaken() -> None:
    """What shakes the other sensor has no mean of nought over two seconds: the blocks without it tell."""
    case = recording(None, 37)
    samples, rng = case.samples.copy(), np.random.default_rng(37)
    shaken = (samples["time"] > 205.0) & (samples["time"] <= 235.0)
    course = rng.standard_normal(int(shaken.sum()))
    samples["dv"][shaken, 1] += 150.0 / RATE_HZ * (course - course.mean())
    samples["dv"] = samples["dv"][:, [1, 0, 2]]
    motion = {"kind": "vibration", "start_s": 205.0, "end_s": 235.0, "grms": 15.0, "band_hz": [0.1, 10.0]}
    meta = case.meta.model_dump(exclude_none=True)
    meta["motion"].append({**motion, "axis": [0.0, 1.0, 0.0]})
    wrong = Recording(samples, RecordingMeta.model_validate(meta), case.path, case.meta_path)
    report = discrepancy([wrong], model())
    assert [(one["effect"], one["channel"]) for one in report.findings] == [("axis_swap", "accel_x<-accel_y")]


def test_gyros_exchanged_that_hardly_feel_it_have_each_their_own_noise_and_steps(tmp_path: Path) -> None:
    """Only Earth's rate tells, by 13 σ, after all else has been looked at; the steps of the two are not the same."""
    case = hidden_case(90612, 277, tmp_path)
    report = discrepancy([case.recording], case.model)
    on_gyros = [(one["effect"], one["channel"]) for one in report.findings if one["channel"].startswith("gyro")]
    assert on_gyros == [("axis_swap", "gyro_y<-gyro_z")]


def test_sensors_exchanged_while_shaken_have_each_their_own_course_and_noise() -> None:
    case = recording(None, 36)
    samples, rng = case.samples.copy(), np.random.default_rng(36)
    shaken = (samples["time"] > 205.0) & (samples["time"] <= 235.0)
    course = rng.standard_normal(int(shaken.sum()))
    samples["dv"][shaken] += 0.2 / RATE_HZ * (course - course.mean())[:, None] * np.array([0.28, 0.0, 0.96])
    exchanged = samples.copy()
    exchanged["dv"] = samples["dv"][:, [2, 1, 0]]
    motion = {"kind": "vibration", "start_s": 205.0, "end_s": 235.0, "grms": 0.02, "band_hz": [0.1, 10.0]}
    meta = case.meta.model_dump(exclude_none=True)
    meta["motion"].append({**motion, "axis": [0.28, 0.0, 0.96]})
    shaken_meta = RecordingMeta.model_validate(meta)
    right, wrong = (Recording(s, shaken_meta, case.path, case.meta_path) for s in (samples, exchanged))
    report = discrepancy([wrong], model())
    assert [(one["effect"], one["channel"]) for one in report.findings] == [("axis_swap", "accel_x<-accel_z")]
    assert report.verdict == "named"
    np.testing.assert_allclose(report.scenes[0].shaken, compare(right, model()).shaken, atol=1e-12)


@pytest.mark.parametrize("seed", [37, 38])
def test_heavy_tails_under_rounding_are_noise_as_stated(seed: int) -> None:
    """Of the same variance, but with a smaller core: lines of rounding are sharper at the top and wider at the foot."""
    case = recording(None, seed, moving=False)
    samples, rng = case.samples.copy(), np.random.default_rng(seed)
    sigma = WHITE["gyro"] * np.sqrt(1.0 / RATE_HZ)
    n = len(samples)
    tails = rng.standard_normal((n, 3)) * np.where(rng.random((n, 3)) < 0.01, 6.0, 1.0) / np.sqrt(1.35)
    samples["dtheta"] = in_steps(closed_form.truth(False, False)["gyro"] / RATE_HZ + sigma * tails, 2.0 * sigma)
    believed = model_in_steps(2.0 * sigma)
    report = discrepancy([replace(case, samples=samples)], believed)
    assert (report.verdict, report.findings) == ("none", []), report.document["text"]


def test_frames_lost_from_a_coarse_readout_leave_no_larger_noise() -> None:
    """What the lost frames had rounded off nobody takes back, so that slow noise is a little more than with all."""
    names = set()
    for seed in range(3):
        case = recording(None, 40 + seed, moving=False)
        samples = case.samples.copy()
        samples["dtheta"] = in_steps(samples["dtheta"], 2.0 * STEP_RAD)
        kept = np.random.default_rng(seed).random(len(samples)) > 0.03
        believed = model_in_steps(2.0 * STEP_RAD)
        report = discrepancy([replace(case, samples=samples[kept])], believed)
        names |= {one["effect"] for one in report.findings}
    assert names == {"lost_samples"}


@pytest.mark.parametrize("white", [0.0, 1e-7, 1e-6])
def test_rounding_of_a_channel_that_says_nothing_is_as_stated(white: float) -> None:
    """A residual of zeros, and noise of none, leave every power a number."""
    noise, steady = ChannelNoise(white=white, quantisation=5e-7), np.full(4096, 4e-5)
    basis = cosine_basis(4096, INTERVAL_S).rounded(noise, steady)
    stated = basis.stated(noise, 1e-12, steady)
    for rss in (np.zeros_like(stated), stated * basis.counts):
        assert np.all(np.isfinite(basis.likeliest(stated, noise, rss)))


@pytest.mark.parametrize("rate_steps", [0.0023, 0.07, 0.31])
@pytest.mark.parametrize("jolt", ROUNDED_AT)
def test_no_mean_of_roundings_is_likelier_than_the_likeliest(jolt: float, rate_steps: float) -> None:
    """The power of a record scatters as χ² about that at one share of the white noise; what was found beats it."""
    noise = ChannelNoise(white=0.15 * np.sqrt(INTERVAL_S), quantisation=INTERVAL_S)
    moved = np.full(COUNT, rate_steps)
    plain = cosine_basis(COUNT, INTERVAL_S)
    basis, stated = plain.rounded(noise, moved), plain.stated(noise, 0.0, moved)
    only_white = plain.stated(noise.model_copy(update={"quantisation": 0.0}), 0.0)
    roundings = [plain.stated(noise.model_copy(update={"white": s * noise.white}), 0.0, moved) for s in ROUNDED_AT]
    less = [s**2 * only_white for s in ROUNDED_AT]
    powers = [only_white + one - own for one, own in zip(roundings, less, strict=True)]
    true = powers[ROUNDED_AT.index(jolt)]
    rss = true * np.random.default_rng(int(100 * jolt)).chisquare(basis.counts)
    found = whittle(rss, basis.counts, basis.likeliest(stated, noise, rss))
    assert found > max(whittle(rss, basis.counts, power) for power in powers) - 0.01


@pytest.mark.parametrize("steps", [4.0, 8.0, 20.0])
def test_rounding_errors_that_come_in_swarms_are_nothing_to_find(steps: float) -> None:
    """The integral hardly moves, so it crosses a step often near a threshold, and elsewhere not for a long time."""
    step = steps * WHITE["gyro"] / np.sqrt(RATE_HZ)
    bias = closed_form.truth(moving=False, warming=False)["gyro"][0] - 0.005 * step * RATE_HZ
    believed = model_in_steps(step)
    for axis, value in zip("xyz", bias, strict=True):
        calibration = getattr(believed.calibration, f"gyro_{axis}").model_copy(update={"bias_radps": float(value)})
        shifted = believed.calibration.model_copy(update={f"gyro_{axis}": calibration})
        believed = believed.model_copy(update={"calibration": shifted})
    for seed in range(3):
        case = recording(None, 90 + seed, moving=False)
        samples = case.samples.copy()
        samples["dtheta"] = in_steps(samples["dtheta"] - bias / RATE_HZ, step)
        report = discrepancy([replace(case, samples=samples)], believed)
        assert report.verdict == "none", (seed, report.document["text"])


def test_lines_of_rounding_lie_where_the_table_really_turned(monkeypatch: pytest.MonkeyPatch) -> None:
    """An angle error of a tenth of a degree moves them anywhere in the band, and is none of the block's."""
    nominal, off = closed_form.TURNS, np.random.default_rng(110).normal(0.0, 0.1, len(closed_form.TURNS))
    turned = [(a, b, r + error / (b - a), axis) for (a, b, r, axis), error in zip(nominal, off, strict=True)]
    monkeypatch.setattr(closed_form, "TURNS", tuple(turned))
    for seed in range(3):
        case = recording(None, 110 + seed)
        samples, meta = case.samples.copy(), case.meta.model_dump(exclude_none=True)
        step = 10.0 * WHITE["gyro"] / np.sqrt(RATE_HZ)
        samples["dtheta"] = in_steps(samples["dtheta"], step)
        for motion, (_, _, rate_dps, _) in zip(meta["motion"], nominal, strict=True):
            motion |= {"rate_dps": rate_dps, "angle_sigma_deg": 0.1}
        stated = Recording(samples, RecordingMeta.model_validate(meta), case.path, case.meta_path)
        report = discrepancy([stated], model_in_steps(step))
        assert report.verdict == "none", (seed, report.document["text"])


def test_rounding_is_no_noise_of_turns_where_a_free_model_overstates_the_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stated at half a step, noise hides rounding; at the quarter that it is, a gyro at rest hardly ever rounds up."""
    white = 20.0 * WHITE["gyro"]
    monkeypatch.setitem(closed_form.WHITE, "gyro", white)
    case = recording(None, 37)
    samples = case.samples.copy()
    step = 4.0 * white / np.sqrt(RATE_HZ)
    samples["dtheta"] = in_steps(samples["dtheta"], step)
    doubled = {f"gyro_{axis}": ChannelNoise(white=2.0 * white, quantisation=step) for axis in "xyz"}
    noise = model_in_steps(step, free=True).noise.model_copy(update=doubled)
    scene = compare(replace(case, samples=samples), BlockModel(noise=noise))
    for column in (3, 4, 5):
        assert np.all(level_spread(scene, column)[1] == 1.0)


def test_a_coarser_step_has_errors_of_a_colour_of_its_own() -> None:
    """At rest they are lines, and not those of the step that the model states."""
    step = 4.0 * WHITE["gyro"] / np.sqrt(RATE_HZ)
    case = recording(None, 82, moving=False)
    samples = case.samples.copy()
    coarser = in_steps(samples["dtheta"][:, 0], 1.6 * step)
    samples["dtheta"] = in_steps(samples["dtheta"], step)
    samples["dtheta"][:, 0] = coarser
    report = discrepancy([replace(case, samples=samples)], model_in_steps(step))
    assert report.verdict == "named", report.document["text"]
    (found,) = report.findings
    assert (found["effect"], found["channel"]) == ("quantisation", "gyro_x")
    assert found["parameters"]["step"]["value"] == pytest.approx(1.6 * step, rel=1e-3)


def test_beside_a_coarser_step_than_a_free_model_states_a_shift_is_found() -> None:
    step, case = 4.0 * WHITE["gyro"] / np.sqrt(RATE_HZ), recording(None, 82, moving=False)
    samples = case.samples.copy()
    coarser = in_steps(samples["dtheta"][:, 0] + 3e-6 / RATE_HZ, 1.6 * step)
    samples["dtheta"] = in_steps(samples["dtheta"], step)
    samples["dtheta"][:, 0] = coarser
    report = discrepancy([replace(case, samples=samples)], model_in_steps(step, free=True))
    (found,) = report.findings
    assert (found["effect"], found["channel"]) == ("bias_shift", "gyro_x")
    assert found["parameters"]["shift"]["value"] == pytest.approx(3e-6, abs=3.3 * found["parameters"]["shift"]["sigma"])


def test_larger_white_noise_takes_its_rounding_along() -> None:
    """Noise of 1.28 times the stated size jolts a readout in steps of 3 σ: its errors are whiter than stated.

    The mean of RUNS errors over their σ is standard normal over √RUNS, 99.9 %.
    """
    step, more, runs = 3.0 * WHITE["gyro"] / np.sqrt(RATE_HZ), 0.8 * WHITE["gyro"], 10
    off = []
    for run in range(runs):
        case = recording(None, 83 + run)
        samples = case.samples.copy()
        samples["dtheta"][:, 0] += more / np.sqrt(RATE_HZ) * np.random.default_rng(run).standard_normal(len(samples))
        samples["dtheta"] = in_steps(samples["dtheta"], step)
        (found,) = discrepancy([replace(case, samples=samples)], model_in_steps(step)).findings
        assert (found["effect"], found["channel"]) == ("random_walk", "gyro_x")
        coefficient = found["parameters"]["coefficient"]
        off.append((coefficient["value"] - more) / coefficient["sigma"])
    assert abs(np.mean(off)) < 3.29 / np.sqrt(runs), off


def test_a_limit_that_two_recordings_meet_is_one_finding_known_the_better_for_it() -> None:
    limit, cases = 5.0, []
    for seed in (33, 34):
        case = recording(None, seed)
        samples = case.samples.copy()
        samples["dv"][:, 1] = np.clip(samples["dv"][:, 1], -limit / RATE_HZ, limit / RATE_HZ)
        cases.append(replace(case, samples=samples))
    one, both = (discrepancy(some, model()) for some in (cases[:1], cases))
    (alone,), (together,) = (
        [found["parameters"]["limit"] for found in report.findings if found["effect"] == "saturation"]
        for report in (one, both)
    )
    assert together["sigma"] < alone["sigma"]
    assert abs(together["value"] - limit) < 3.3 * together["sigma"]
    assert sum(entry.effect == "saturation" for entry in both.model.effects) == 1
