"""A coarse readout repeats values by itself; a register that stands still does not carry on what it rounds off."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from closed_form import GRAVITY_MPS2, RATE_HZ, model, recording
from hidden_case import hidden_case
from scipy.stats import binom

from drivers.recording import Recording, RecordingMeta
from simulators.discrepancy.compare import compare
from simulators.discrepancy.report import discrepancy
from simulators.discrepancy.standing import find_stuck, longest_by_rounding, longest_off_zero

STEP_MPS = 1.5e-4  # the noise of a sample is 0.3 of it


def coarse(case: Recording, *, mean_steps: float) -> Recording:
    """Return the recording with accel_x read in whole steps, what was rounded off carried on to the next sample."""
    samples = case.samples.copy()
    rates = samples["dv"][:, 0] - samples["dv"][:, 0].mean() + mean_steps * STEP_MPS
    total = np.rint(np.cumsum(rates) / STEP_MPS)
    samples["dv"][:, 0] = np.diff(total, prepend=0.0) * STEP_MPS
    return dataclasses.replace(case, samples=samples)


@pytest.mark.parametrize("mean_steps", [7.0, 7.02, 7.3, 7.5])
def test_repeats_by_rounding_are_no_stuck_register(mean_steps: float) -> None:
    for seed in range(5):
        case = coarse(recording(None, seed, moving=False), mean_steps=mean_steps)
        runs = np.diff(np.flatnonzero(np.diff(case.samples["dv"][:, 0]) != 0.0))
        assert runs.max() >= 6  # as short as a stuck register may be: there is something to be fooled by
        assert find_stuck(compare(case, model()))[1] == []


def test_zeros_of_a_small_input_that_comes_and_goes_are_no_stuck_register() -> None:
    """A vehicle that people lean on: a coarse readout is at zero for a second now and then, as often before."""
    for seed in range(5):
        case = recording(None, 60 + seed, moving=False)
        samples, rng = case.samples, np.random.default_rng(seed)
        lean = np.full(len(samples), 0.8)
        for first in range(150, 4600, 350):
            lean[first : first + rng.integers(20, 36)] = 0.0
        total = np.rint(np.cumsum(lean + 0.3 * rng.standard_normal(len(samples))))
        samples["dv"][:, 0] = np.diff(total, prepend=0.0) * STEP_MPS
        assert find_stuck(compare(case, model()))[1] == []


@pytest.mark.parametrize(("seed", "number"), [(90617, 135), (90619, 190)])
def test_repeats_that_chance_makes_once_in_a_thousand_channels_are_no_stuck_register(
    seed: int, number: int, tmp_path: Path
) -> None:
    """There are six a record: 84 readings alike where 80 were one in a thousand, and ten that were 5.2 σ off."""
    case = hidden_case(seed, number, tmp_path)
    assert find_stuck(compare(case.recording, case.model))[1] == []


@pytest.mark.parametrize("samples", [100, 200, 400])
def test_few_inputs_of_any_size_are_read_alike_for_long(samples: int) -> None:
    """Of inputs of any size no more stay within a step than two in as many samples, by the walk of their noise."""
    steps, draws = 0.04, 40_000
    rng = np.random.default_rng(samples)
    total = np.zeros((draws, samples)) + rng.uniform(0.0, 1.0, (draws, 1))
    total += np.cumsum(rng.uniform(-0.5, 0.5, (draws, 1)) + rng.normal(0.0, steps, (draws, samples)), axis=1)
    stayed = np.count_nonzero(np.ptp(np.floor(total), axis=1) == 0.0)
    leaving = 0.5 * (np.pi * steps / (1.0 + 1.166 * steps)) ** 2
    assert 0 < stayed < binom.ppf(0.999, draws, 2.0 / samples * np.exp(-leaving * samples))


@pytest.mark.parametrize("steps", [0.02, 0.1, 0.5, 3.0])
def test_a_reading_other_than_zero_stays_for_no_longer_than_zero(steps: float) -> None:
    assert longest_off_zero(steps, 30_000) <= longest_by_rounding(steps, 30_000)


def test_a_reading_of_few_samples_stays_as_long_whatever_it_is() -> None:
    assert longest_off_zero(5.0, 30_000) == longest_by_rounding(5.0, 30_000)


@pytest.mark.parametrize("mean_steps", [7.0, 7.4, 0.38])
def test_a_register_that_stands_still_is_found_where_it_stands(mean_steps: float) -> None:
    case = coarse(recording(None, 9, moving=False), mean_steps=mean_steps)
    first = int(np.flatnonzero(case.samples["dv"][2000:, 0] < 7.5 * STEP_MPS)[0]) + 2001
    count = 120
    case.samples["dv"][first : first + count, 0] = case.samples["dv"][first - 1, 0]
    scene, found = find_stuck(compare(case, model()))
    assert [one.channel for one in found] == ["accel_x"]
    # Neighbours may by chance have the same value and belong to the run.
    assert found[0].start_s == pytest.approx(first / RATE_HZ, abs=10 / RATE_HZ)
    assert found[0].duration_s == pytest.approx(count / RATE_HZ, abs=20 / RATE_HZ)
    assert scene.data.missing[first : first + count, 0].all()
    assert not scene.data.missing[:, 1:].any()


@pytest.mark.parametrize(
    ("seed", "number", "lasts_s"),
    [
        # Zeros where half a step a sample goes on. Across Earth's rate the gyro reads five times as many in a row ...
        (90613, 295, 0.0909),
        # ... and so it does as it turns about an axis that is not quite the stated one, and reads other than is said.
        (90620, 330, 0.153),
        # Five readings alike in a turn that began 0.08 s before, after which gravity leaps: a turn that comes late
        # leaves the attitude late, and here it is right again at once.
        (90621, 220, 0.056),
        # Among runs of three samples; turns on either side, about axes that are not the stated ones, make those far
        # about it uncertain witnesses.
        (90622, 355, 7.05),
        # At rest, a second before a turn of which the same is true ...
        (90625, 962, 0.370),
        # ... and a tenth of a second behind one, in a mount that sways.
        (90624, 450, 1.321),
        # In a turn about another axis, of which as much is felt as half a step a sample, and nothing soon after it.
        (90633, 131, 0.528),
        # Eleven seconds, as long as rounding could make them of an input of whole steps: of three, which it is not.
        (90641, 222, 11.06),
    ],
)
def test_a_register_that_stood_still_is_found_though_what_goes_on_about_it_looks_like_it(
    seed: int, number: int, lasts_s: float, tmp_path: Path
) -> None:
    case = hidden_case(seed, number, tmp_path)
    (hidden,) = case.truth["effects"]
    assert hidden["effect"] == "stuck_samples"
    assert hidden["parameters"]["duration"] == pytest.approx(lasts_s, rel=0.01)
    (found,) = find_stuck(compare(case.recording, case.model))[1]
    assert found.channel == hidden["channel"]
    assert abs(found.start_s - hidden["parameters"]["start"]) < 3.0 * found.sigma_s
    assert abs(found.duration_s - hidden["parameters"]["duration"]) < 3.0 * found.sigma_s


@pytest.mark.parametrize(("seed", "number"), [(90614, 66), (90614, 286), (90614, 421), (90617, 241)])
def test_zeros_of_an_input_that_passes_a_dead_band_are_no_stuck_register(
    seed: int, number: int, tmp_path: Path
) -> None:
    """Bands that a turn passes in some samples, of a thousand steps and of ten, and one of less than a step."""
    case = hidden_case(seed, number, tmp_path)
    assert [hidden["effect"] for hidden in case.truth["effects"]] == ["dead_band"]
    assert find_stuck(compare(case.recording, case.model))[1] == []


@pytest.mark.parametrize(("noise_steps", "count"), [(0.15, 30), (0.2, 60), (0.3, 60)])
def test_a_register_that_stands_still_for_no_longer_than_rounding_may_is_found_by_its_sum(
    noise_steps: float, count: int
) -> None:
    """Rounding is off a sum by one step at most; this one by five and more, where the reading stood to one side."""
    case, step = recording(None, 21, moving=False), 0.3 * STEP_MPS / noise_steps
    samples = case.samples.copy()
    rates = samples["dv"][:, 0] - samples["dv"][:, 0].mean() + 7.27 * step
    samples["dv"][:, 0] = np.diff(np.rint(np.cumsum(rates) / step), prepend=0.0) * step
    coarse_case = dataclasses.replace(case, samples=samples)
    assert find_stuck(compare(coarse_case, model()))[1] == []
    first = int(np.flatnonzero(samples["dv"][2000:, 0] < 7.5 * step)[0]) + 2001
    samples["dv"][first : first + count, 0] = samples["dv"][first - 1, 0]
    (found,) = find_stuck(compare(coarse_case, model()))[1]
    assert found.channel == "accel_x"
    assert found.start_s == pytest.approx(first / RATE_HZ, abs=5 / RATE_HZ)
    assert found.duration_s == pytest.approx(count / RATE_HZ, abs=10 / RATE_HZ)


def test_a_knock_that_some_readings_share_is_no_stuck_register_at_rest() -> None:
    """Steps so coarse that the noise never shows: five readings a step up now and then, as somebody walks past."""
    case = recording(None, 12, moving=False)
    step = 100.0 * STEP_MPS
    case.samples["dv"][:, 0] = 80.0 * step
    for first in range(200, 4600, 400):
        case.samples["dv"][first : first + 5, 0] += step
    assert find_stuck(compare(case, model()))[1] == []


def test_a_register_that_stands_still_under_vibration_is_found_though_nobody_knows_its_course() -> None:
    case = recording(None, 13, moving=False)
    shaken = {"kind": "vibration", "start_s": 60.0, "end_s": 200.0, "grms": 0.01, "band_hz": [1.0, 9.0]}
    meta = RecordingMeta.model_validate(
        {**case.meta.model_dump(exclude_none=True), "motion": [{**shaken, "axis": [1.0, 0.0, 0.0]}]}
    )
    samples = case.samples.copy()
    rows = (samples["time"] > 60.0) & (samples["time"] <= 200.0)
    samples["dv"][rows, 0] += 0.1 * np.random.default_rng(13).standard_normal(int(rows.sum())) / RATE_HZ
    case = coarse(Recording(samples, meta, case.path, case.meta_path), mean_steps=7.0)
    assert find_stuck(compare(case, model()))[1] == []
    case.samples["dv"][2400:2412, 0] = case.samples["dv"][2399, 0]
    found = find_stuck(compare(case, model()))[1]
    assert [(one.channel, round(one.start_s * RATE_HZ)) for one in found] == [("accel_x", 2400)]


def test_readings_at_a_limit_are_no_stuck_register() -> None:
    """Gravity a little beyond the limit in one attitude: the noise is gone there, and the reading stands still."""
    case = recording(None, 14)
    limit = 3263.0 * STEP_MPS
    total = np.rint(np.cumsum(np.minimum(case.samples["dv"][:, 2], limit)) / STEP_MPS)
    case.samples["dv"][:, 2] = np.diff(total, prepend=0.0) * STEP_MPS
    assert find_stuck(compare(case, model()))[1] == []


def test_zeros_of_a_dead_band_are_no_stuck_register_however_long() -> None:
    """Noise lifts one reading in twenty over the band; in between zeros last longer than rounding makes them last."""
    turn = {"kind": "turn", "start_s": 20.0, "end_s": 230.0, "rate_dps": 9.0, "axis": [0.0, 0.0, 1.0], "frame": "body"}
    step = 1.5e-5
    for seed in range(4):
        case = recording(None, 80 + seed, moving=False)
        meta = RecordingMeta.model_validate({**case.meta.model_dump(exclude_none=True), "motion": [turn]})
        samples = case.samples.copy()
        turning = (samples["time"] > 20.0) & (samples["time"] <= 230.0)
        inputs = samples["dtheta"][:, 2] / step + 0.45 * np.random.default_rng(seed).standard_normal(len(samples))
        inputs[turning] += np.radians(9.0) / RATE_HZ / step
        sent = np.where(np.abs(inputs) < 1.0, 0.0, inputs)
        samples["dtheta"][:, 2] = np.diff(np.rint(np.cumsum(sent)), prepend=0.0) * step
        scene = compare(Recording(samples, meta, case.path, case.meta_path), model(factor=10.0))
        assert find_stuck(scene)[1] == []


def test_the_crest_of_a_swing_in_coarse_steps_is_no_stuck_register() -> None:
    """There the reading repeats, and the swing itself is off what goes on all the time; but so are its neighbours."""
    for seed in range(8):
        begins_s = np.random.default_rng(seed).uniform(5.0, 220.0, 6)

        def swing(true: dict[str, np.ndarray], readings: np.ndarray, begins_s: np.ndarray = begins_s) -> None:
            lag_s = np.clip(true["t"][:, None] - begins_s, 0.0, None)
            bursts = np.exp(-lag_s / 10.0) * np.sin(2.0 * np.pi * lag_s / 2.5)
            readings[:, 0] += 1.7 * STEP_MPS * RATE_HZ * bursts.sum(axis=1)

        case = coarse(recording(swing, 79 + seed, moving=False), mean_steps=7.3)
        assert find_stuck(compare(case, model()))[1] == []


def test_a_coarse_reading_of_a_turn_that_ends_late_is_no_stuck_register() -> None:
    """The rate is whole steps, so that readings repeat; only in the last of them did more come than the stated turn."""
    step = np.radians(18.0) / RATE_HZ / 2344.0
    for seed in range(4):
        case = recording(None, 90 + seed)
        samples = case.samples
        steps = samples["dtheta"][:, 2] / step
        steps += 2344.0 - steps[(samples["time"] > 81.0) & (samples["time"] < 99.0)].mean()
        samples["dtheta"][:, 2] = np.diff(np.rint(np.cumsum(steps)), prepend=0.0) * step
        meta = case.meta.model_dump(exclude_none=True)
        for turn in meta["motion"]:
            turn["end_s"] -= 0.012
        late = Recording(samples, RecordingMeta.model_validate(meta), case.path, case.meta_path)
        assert find_stuck(compare(late, model()))[1] == []


@pytest.mark.parametrize("stuck", [True, False])
def test_an_accelerometer_that_stands_still_into_a_turn_is_told_from_a_turn_that_comes_late(*, stuck: bool) -> None:
    """A fast turn begins at 50 s: three readings before and eight behind stay the same, or it begins 50 ms late."""
    case = recording(None, 44, moving=False)
    rate, start_s = np.radians(60.0), 50.0
    turn = {"kind": "turn", "start_s": start_s, "end_s": 53.0, "rate_dps": 60.0, "axis": [0.0, 1.0, 0.0]}
    meta = RecordingMeta.model_validate(
        {**case.meta.model_dump(exclude_none=True), "motion": [{**turn, "frame": "body"}]}
    )
    samples = case.samples.copy()
    late_s = 0.0 if stuck else 0.05
    middle_s = samples["time"] - 0.5 / RATE_HZ
    angle = rate * np.clip(middle_s - start_s - late_s, 0.0, 3.0)
    samples["dv"][:, 0] -= GRAVITY_MPS2 * np.sin(angle) / RATE_HZ
    samples["dv"][:, 2] -= GRAVITY_MPS2 * (1.0 - np.cos(angle)) / RATE_HZ
    samples["dtheta"][:, 1] += rate / RATE_HZ * ((angle > 0.0) & (angle < rate * 3.0))
    moved = coarse(Recording(samples, meta, case.path, case.meta_path), mean_steps=7.0)
    first = round(start_s * RATE_HZ)
    if stuck:
        moved.samples["dv"][first - 3 : first + 8, 0] = moved.samples["dv"][first - 4, 0]
    found = [one.channel for one in find_stuck(compare(moved, model()))[1]]
    assert found == (["accel_x"] if stuck else [])


@pytest.mark.parametrize(
    ("seed", "hertz", "size_steps", "lasts_s", "late_s", "mean_steps"),
    [
        (52, 0.36373358, 1.0487629, 14.025079, 0.47532028, 7.4963298),
        (51, 0.39565763, 1.450951, 13.926907, 0.28563874, 7.262199),
    ],
)
def test_a_reading_at_the_crest_of_a_swing_is_no_stuck_register(
    seed: int, hertz: float, size_steps: float, lasts_s: float, late_s: float, mean_steps: float
) -> None:
    """A slow ringing dies out; two of five thousand drawn at random whose crests passed for registers."""
    case, step = recording(None, seed, moving=False), 2.0 * STEP_MPS
    samples = case.samples.copy()
    since_s = np.clip(samples["time"] - 80.0 - late_s, 0.0, None)
    ringing = size_steps * step * np.exp(-since_s / lasts_s) * np.sin(2.0 * np.pi * hertz * since_s)
    rates = samples["dv"][:, 0] - samples["dv"][:, 0].mean() + mean_steps * step + ringing
    samples["dv"][:, 0] = np.diff(np.rint(np.cumsum(rates) / step), prepend=0.0) * step
    assert find_stuck(compare(dataclasses.replace(case, samples=samples), model()))[1] == []


def test_a_step_and_its_undoing_between_which_the_reading_stood_still_are_a_stuck_register(tmp_path: Path) -> None:
    """Across the end of a turn about an axis that is not the stated one nothing tells before the axis is fitted."""
    case = hidden_case(90621, 476, tmp_path)
    (hidden,) = case.truth["effects"]
    assert find_stuck(compare(case.recording, case.model))[1] == []
    (found,) = discrepancy([case.recording], case.model).findings
    assert (found["effect"], found["channel"]) == ("stuck_samples", hidden["channel"])
    for name, value in hidden["parameters"].items():
        assert abs(found["parameters"][name]["value"] - value) < 3.3 * found["parameters"][name]["sigma"]


def test_a_step_and_its_undoing_between_which_the_reading_went_on_are_two_steps() -> None:
    def knocked(true: dict[str, np.ndarray], readings: np.ndarray) -> None:
        readings[(true["t"] > 100.0) & (true["t"] < 130.0), 0] += 2e-3

    found = discrepancy([recording(knocked, 31, moving=False)], model()).findings
    assert [(f["effect"], f["channel"]) for f in found] == [("bias_step", "accel_x")] * 2


def test_what_a_turns_end_does_beside_a_register_that_stood_still_does_not_hide_it(tmp_path: Path) -> None:
    """Half a second at zero, ten steps missing: a turn that ended within its neighbours made them witness nothing."""
    case = hidden_case(90616, 30, tmp_path)
    (hidden,) = case.truth["effects"]
    (found,) = find_stuck(compare(case.recording, case.model))[1]
    assert found.channel == hidden["channel"]
    assert abs(found.start_s - hidden["parameters"]["start"]) < 3.3 * found.sigma_s


@pytest.mark.parametrize("lengths", [(10,), (61,), (40, 60, 80)])
def test_a_register_that_repeats_what_a_readout_without_steps_never_would_is_found_however_rare(
    lengths: tuple[int, ...],
) -> None:
    """Ten equal doubles of a gyro at rest: what they are of a longer record is no custom of it."""
    case = recording(None, 31, moving=False)
    samples = case.samples.copy()
    starts = [1000 * (place + 1) for place in range(len(lengths))]
    for start, length in zip(starts, lengths, strict=True):
        samples["dtheta"][start + 1 : start + 1 + length, 1] = samples["dtheta"][start, 1]
    _, found = find_stuck(compare(dataclasses.replace(case, samples=samples), model()))
    assert [one.channel for one in found] == ["gyro_y"] * len(lengths)
    for one, start, length in zip(found, starts, lengths, strict=True):
        assert one.start_s == pytest.approx((start + 1) / RATE_HZ, abs=1.5 / RATE_HZ)
        assert one.duration_s == pytest.approx(length / RATE_HZ, abs=1.5 / RATE_HZ)
