"""The generator of hidden cases is right by itself: its motion, its noise, its sizes, and the truth stays sealed."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hidden_case import hidden_case
from scipy.fft import dct
from scipy.stats import chi2

from drivers.recording import read_recording
from inertial.attitude import body_to_tangent
from inertial.documents import CHANNELS, BlockModel, parse_document
from inertial.earth import Site
from simulators.motion import Setup as SimulatorSetup
from simulators.motion import Trajectory
from simulators.motion import Turn as SimulatorTurn

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))  # benchmarks are no installed package
from benchmarks._blind import hidden, motion, oracle, plans, strange  # noqa: E402
from benchmarks._blind.cases import _best_pair, _Draft, category_of, make  # noqa: E402
from benchmarks._blind.noise import Spectrum, quantise  # noqa: E402
from benchmarks._blind.world import World  # noqa: E402
from benchmarks._scoring import score  # noqa: E402

TURNS = (
    (3.004, 7.006, 0.4, (0.0, 0.0, 1.0), "body"),
    (9.003, 12.005, -0.7, (1.0, 0.0, 0.0), "body"),
    (13.0055, 17.0, 0.3, (0.6, 0.0, 0.8), "tangent"),
)


def test_its_motion_is_the_simulators_though_written_apart() -> None:
    stated = motion.Setup(0.6, 9.8, 1.1, 0.02, -0.03, 0.5, tuple(motion.Turn(*turn) for turn in TURNS))
    other = SimulatorSetup(
        Site.at(0.6, 0.0, 9.8), 1.1, body_to_tangent(0.02, -0.03, 0.5), tuple(SimulatorTurn(*turn) for turn in TURNS)
    )
    edges = np.arange(2001) * 0.01
    dv, dtheta, _ = motion.increments(stated, edges)
    expected_dv, expected_dtheta = Trajectory(other).smooth_increments(edges)
    np.testing.assert_allclose(dv, expected_dv, atol=1e-11)
    np.testing.assert_allclose(dtheta, expected_dtheta, atol=1e-13)


def test_its_noise_has_the_spectrum_by_which_sizes_are_reckoned() -> None:
    rng, count, dt, runs = np.random.default_rng(1), 4000, 0.01, 40
    spectrum = Spectrum(white=1e-3, flicker=2e-3, random_walk=3e-4, quantisation=1.5e-4)
    frequency = np.arange(1, count) / (2 * count * dt)
    power = np.zeros(count - 1)
    for _ in range(runs):
        rate = quantise(spectrum.sample(rng, count, dt) + 0.0123, dt, spectrum.quantisation, rng.random())
        power += dct(rate, norm="ortho")[1:] ** 2
    ratio = power / runs / (spectrum.density(frequency, dt) / dt)
    for low, high in ((8, 60), (60, 500), (500, 3999)):
        lines = high - low
        slack = 0.04  # DCT leakage of the random walk, four processes a decade for the flicker
        band = np.array(chi2.interval(0.999, lines * runs)) / (lines * runs)
        assert band[0] - slack < ratio[low:high].mean() < band[1] + slack


def test_its_flicker_goes_on_as_one_over_f() -> None:
    """To half of the highest frequency: what a coefficient means must not hang on where it rises above white noise."""
    rng, count, dt, runs = np.random.default_rng(4), 4000, 0.01, 40
    spectrum = Spectrum(flicker=1.0)
    frequency = np.arange(1, count) / (2 * count * dt)
    power = sum(dct(spectrum.sample(rng, count, dt), norm="ortho")[1:] ** 2 for _ in range(runs))
    ratio = power / runs / (spectrum.density(frequency, dt) / dt)
    for low, high in ((8, 60), (60, 500), (500, 1000), (1000, 2000)):
        band = np.array(chi2.interval(0.999, (high - low) * runs)) / ((high - low) * runs)
        assert band[0] - 0.06 < ratio[low:high].mean() < band[1] + 0.06  # four processes a decade, and leakage


def test_a_limit_is_met_by_what_is_read() -> None:
    """Calibration stands between input and readout: a limit beneath the input alone may never be reached."""
    rng = np.random.default_rng(5)
    plan = plans.plan(rng, kind="laser", motion="tour", climate="steady")
    setup, _, _ = plans.stated_setup(rng, plan, 100.0)
    world = plans.world_of(rng, plan, setup, 100.0)
    reading = world.inputs / 1.002
    for _ in range(12):
        effect = hidden.with_limit(hidden.draw(rng, "saturation", world), reading)
        assert np.any(hidden.read_out(effect, world, reading) != reading), effect


def test_the_best_pair_is_the_best_of_all_pairs() -> None:
    rng = np.random.default_rng(6)
    basis = rng.standard_normal((7, 30))
    basis[3] = basis[1] + 0.3 * rng.standard_normal(30)
    basis /= np.linalg.norm(basis, axis=1, keepdims=True)
    target = rng.standard_normal(30)
    target /= np.linalg.norm(target)
    explained = []
    for pair in combinations(range(7), 2):
        left = target - basis[list(pair)].T @ np.linalg.lstsq(basis[list(pair)].T, target, rcond=None)[0]
        explained.append(1.0 - left @ left)
    assert _best_pair(basis, target) == pytest.approx(max(explained))


def test_a_size_is_the_oracles_signal_to_noise() -> None:
    """The oracle's statistic is standard normal where nothing is hidden, reference errors and all."""
    rng = np.random.default_rng(2)
    plan = plans.plan(rng, kind="fibre", motion="positions", climate="ramp")
    setup, _, _ = plans.stated_setup(rng, plan, 60.0)
    world = plans.world_of(rng, plan, setup, 60.0)
    spectra = plans.noise_of(rng, "fibre")
    metric = oracle.Metric(world, spectra).beside(oracle.nuisance(world, plan.sigma, False, []))
    effect = hidden.draw(rng, "scale_factor", world)
    shift = metric.project(metric.whiten(hidden.sensor_shift(effect, world)))
    shift = metric.project(shift / np.linalg.norm(shift))  # the projection is symmetric: it may stand on either side
    weights = metric.nuisance
    runs = 60
    statistic = []
    for _ in range(runs):
        noise = np.column_stack([s.sample(rng, world.count, world.dt) for s in spectra])
        noise = np.column_stack([quantise(noise[:, i], world.dt, s.quantisation, 0.5) for i, s in enumerate(spectra)])
        doubts = rng.standard_normal(len(weights)) @ weights
        statistic.append(shift @ (metric.whiten(noise) + doubts))
    low, high = chi2.interval(0.999, runs)
    assert 0.9 * low < np.sum(np.square(statistic)) < 1.1 * high  # a tenth for the DCT's being nearly diagonal only


@pytest.mark.parametrize("late", [(4e-3, 0.0), (8.3e-2, 0.0), (0.0, -8e-5)])
def test_what_a_late_schedule_explains_has_no_more_size_than_that_costs(late: tuple[float, float]) -> None:
    """A delay of all is no larger than its σ as a delay of the schedule, whatever samples the turns' ends pass into.

    And a clock's error no larger than all ends late by as much: each by 1 ms (σ) at the cost of its own square, and all
    of them together once more.
    """
    rng = np.random.default_rng(7)
    plan = plans.plan(rng, kind="dtg", motion="positions", climate="steady")
    setup, _, _ = plans.stated_setup(rng, plan, 100.0)
    world = plans.world_of(rng, plan, setup, 100.0)
    metric = oracle.Metric(world, plans.noise_of(rng, "dtg")).beside(
        oracle.nuisance(world, plan.sigma, False, [], late)
    )
    ends_s = np.array([end_s for turn in setup.turns for end_s in (turn.start_s, turn.end_s)])
    constant, growing = late
    if growing:  # a false clock makes forces smaller too, which no schedule does: left out
        factor = np.where(np.arange(6) < 3, 1.0, 1.0 + growing)
        shift = world.inputs * factor - world.inputs_of(setup, world.edges * (1.0 - growing))
        late_s = growing * ends_s
        together_s = np.sum(late_s) / (len(ends_s) + 1)  # the least sum of squares of it and of what each is beside it
        bound = math.hypot(float(np.linalg.norm(late_s - together_s)), together_s) / oracle.TIMING_SIGMA_S
    else:
        shift = hidden.delayed(hidden.Effect("latency", "all", {"delay": constant}, ("delay",)), world) - world.inputs
        bound = constant / oracle.TIMING_SIGMA_S
    assert np.linalg.norm(metric.whiten(shift)) > 20.0 * bound
    assert 0.1 * bound < metric.size(shift) < 1.01 * bound


@pytest.mark.parametrize("number", [0, 3])
def test_a_case_is_drawn_from_its_seed_and_can_be_read(number: int, tmp_path: Path) -> None:
    first = make(77, number)
    assert first.truth["category"] == category_of(number)
    cases, truth = tmp_path / "cases", tmp_path / "truth"
    where = ["--cases", str(cases), "--truth", str(truth)]
    command = [sys.executable, "-m", "benchmarks._blind", "--seed", "77", "--first", str(number), *where]
    subprocess.run(command, check=True, cwd=ROOT)
    folder = cases / f"{number:05d}"
    assert sorted(path.name for path in folder.iterdir()) == ["block.json", "recording.parquet", "recording.toml"]
    recording = read_recording(folder / "recording")
    np.testing.assert_array_equal(recording.samples["dv"], first.readings[:, :3] * first.intervals[:, None])
    model = parse_document(BlockModel, (folder / "block.json").read_text(), "block.json")
    hidden_names = {(e["effect"], e["channel"]) for e in first.truth["effects"]}
    assert not hidden_names & {(e.effect, e.channel) for e in model.effects if e.effect != "bias_shift"}
    written = json.loads((truth / f"{number:05d}.json").read_text())
    for entry, drawn in zip(written.pop("effects"), first.truth.pop("effects"), strict=True):
        for key in (
            "parameters",
            "d",
            "d_got",
        ):  # found by sums, in two orders by two processes
            assert entry.pop(key) == pytest.approx(drawn.pop(key), rel=1e-9)
        assert entry == drawn
    assert written == json.loads(json.dumps(first.truth))


def test_what_an_oracle_gets_of_a_recording_scatters_about_the_size_by_one_sigma() -> None:
    """Twice ln of the likelihood ratio of what is known is normal about d², its σ twice d; 99.9 % of mean and χ²."""
    spread = {*hidden.NOISE, "quantisation"} - {"random_walk"}  # lies in a few coefficients, or in its rounding
    off = []
    for number in (n for n in range(60) if category_of(n) == "inside"):
        for one in make(90624, number).truth["effects"]:
            if one["effect"] not in spread and 10.0 <= one["d"] <= 200.0:
                off.append((one["d_got"] ** 2 - one["d"] ** 2) / (2.0 * one["d"]))
    low, high = chi2.interval(0.999, len(off))
    assert len(off) > 24
    assert abs(np.mean(off)) < 3.29 / np.sqrt(len(off)), off
    assert low < np.sum(np.square(off)) < high, off


def test_the_truth_may_not_lie_among_the_recordings(tmp_path: Path) -> None:
    where = ["--cases", str(tmp_path), "--truth", str(tmp_path / "truth")]
    ended = subprocess.run(
        [sys.executable, "-m", "benchmarks._blind", "--seed", "1", *where], capture_output=True, cwd=ROOT
    )
    assert ended.returncode == 2
    assert b"truth" in ended.stderr


def test_the_generator_uses_nothing_of_the_simulator() -> None:
    code = "import sys, benchmarks._blind.__main__; sys.exit(any(m.startswith('simulators') for m in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0


def test_every_effect_and_strange_effect_can_be_drawn() -> None:
    rng = np.random.default_rng(3)
    plan = plans.plan(rng, kind="dtg", motion="tour", climate="up_down", supply="steps")
    setup, _, _ = plans.stated_setup(rng, plan, 60.0)
    world: World = plans.world_of(rng, plan, setup, 60.0)
    for name in hidden.SENSOR:
        if name != "vibration_rectification":
            assert np.any(hidden.sensor_shift(hidden.draw(rng, name, world), world)), name
    for name in strange.STRANGE:
        assert np.ptp(strange.shape(name, "gyro_y", world, rng)) > 0, name


def test_scoring_tells_named_tied_missed_and_false() -> None:
    truth = {
        "number": 0,
        "category": "inside",
        "family": "plain",
        "motion": "rest",
        "climate": "steady",
        "kind": "dtg",
        "free": False,
        "length_s": 60.0,
        "effects": [
            {"effect": "bias_shift", "channel": "gyro_x", "parameters": {"shift": 1.0}, "d": 12.0, "d_got": 12.0},
            {"effect": "axis_swap", "channel": "accel_y<-accel_x", "parameters": {}, "d": 99.0, "d_got": 99.0},
            {"effect": "drift", "channel": "gyro_z", "parameters": {"rate": 1.0}, "d": 10.0, "d_got": 10.0},
        ],
        "allowed": [["random_walk", "accel_x"]],
    }

    def finding(
        effect: str, channel: str, alternatives: list[dict[str, object]], **parameters: object
    ) -> dict[str, object]:
        return {"effect": effect, "channel": channel, "alternatives": alternatives, "parameters": parameters}

    near = {"effect": "bias_shift", "channel": "gyro_x", "behind_nats": 2.0}
    far = {"effect": "drift", "channel": "gyro_z", "behind_nats": 3.5}
    findings = [
        finding("g_sensitivity", "gyro_x<-accel_z", [near, far]),
        finding("axis_swap", "accel_x<-accel_y", []),
        finding("random_walk", "accel_x", []),
        finding("sinusoid", "gyro_y", []),
    ]
    scored = score(truth, {"report": {"verdict": "named", "findings": findings}, "seconds": 1.0})
    assert [e["outcome"] for e in scored["effects"]] == ["tied", "named", "missed"]
    assert scored["false"] == [["sinusoid", "gyro_y"]]
    assert [e["outcome"] for e in score(truth, {"error": "it broke"})["effects"]] == ["missed"] * 3


@pytest.mark.parametrize("channel", ["accel", "all"])
def test_of_a_vibration_whose_course_nobody_knows_nobody_knows_how_late_it_is(channel: str) -> None:
    """A block that is shaken and else at rest: two hundredths of a second were 78 σ of its accelerometers."""
    nulls = (number for number in range(500) if category_of(number) == "null")
    drafts = (_Draft(np.random.default_rng(n), np.random.default_rng(n), 7, n, 0) for n in nulls)
    draft = next(one for one in drafts if one.plan.motion == "vibration")
    late = hidden.Effect("latency", channel, {"delay": 0.02}, ("delay",))
    assert np.ptp((hidden.delayed(late, draft.world) - draft.world.inputs)[:, :3]) > 1.0
    assert draft._measure(late, np.zeros((draft.world.count, 6)))(late) < 1e-3


@pytest.mark.parametrize(("seed", "number"), [(90620, 461), (90620, 265), (90619, 477)])
def test_a_stuck_register_is_as_large_as_what_it_held_makes_it(seed: int, number: int, tmp_path: Path) -> None:
    """At rest, from the files: what came meanwhile by its neighbours, over white noise and the roundings at both ends.

    How the readout rounded is part of what it held: of another remainder it holds a step more or less, half to twice d.
    The mean of 800 neighbours tells what came of 78 to 0.3 of 15 σ, and of fewer better: a twentieth is twice that.
    """
    case = hidden_case(seed, number, tmp_path)
    (stuck,), samples = case.truth["effects"], case.recording.samples
    increments = np.hstack([samples["dv"], samples["dtheta"]])[:, CHANNELS.index(stuck["channel"])]
    start_s = stuck["parameters"]["start"]
    held = np.flatnonzero((samples["time"] >= start_s) & (samples["time"] < start_s + stuck["parameters"]["duration"]))
    assert np.ptp(increments[held]) == 0.0
    beside = [*range(held[0] - 401, held[0] - 1), *range(held[-1] + 2, held[-1] + 402)]
    lost = np.sum(increments[held]) - held.size * np.mean(increments[beside])
    noise = getattr(case.model.noise, stuck["channel"])
    sigma = math.hypot(noise.white * math.sqrt(held.size * 0.01), noise.quantisation / math.sqrt(6.0))
    assert stuck["d"] == pytest.approx(abs(lost) / sigma, rel=0.05)
