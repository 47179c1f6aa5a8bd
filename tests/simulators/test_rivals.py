"""What these data cannot tell from a name: one other, or two together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import closed_form
import numpy as np
import pytest
from closed_form import DURATION_S, RATE_HZ, WHITE, Truth, model, recording
from hidden_case import hidden_case

from simulators.discrepancy import ranking
from simulators.discrepancy.adopt import Searcher
from simulators.discrepancy.candidates import Hypothesis, Library
from simulators.discrepancy.compare import compare
from simulators.discrepancy.evidence import Evidence, Fit
from simulators.discrepancy.margins import MARGIN
from simulators.discrepancy.report import discrepancy

ACCEL_SIGMA = WHITE["accel"] * np.sqrt(RATE_HZ)
SUPPLY_V = 28.0 - 4.0 * np.linspace(0.3, 1.0, round(RATE_HZ * DURATION_S)) ** 2
SENSITIVITY = 4e-4


@pytest.mark.parametrize("shift", [0.0, 8e-4])
def test_a_coefficient_from_an_unusual_voltage_may_be_one_from_the_usual_and_a_shift(shift: float) -> None:
    """8e-4 m/s² are what two volts make: counted from 26 V the coefficient alone explains both."""

    def change(_: Truth, readings: np.ndarray) -> None:
        readings[:, 0] += shift + SENSITIVITY * (SUPPLY_V - 28.0)

    case = recording(change, 91, moving=False)
    samples = case.samples.copy()
    samples["supply"] = SUPPLY_V
    report = discrepancy([replace(case, samples=samples)], model())
    (found,) = report.findings
    assert found["effect"] == "supply_sensitivity"
    coefficient, nominal = (found["parameters"][name] for name in ("coefficient", "nominal"))
    assert abs(coefficient["value"] - SENSITIVITY) < 3.3 * coefficient["sigma"]
    assert abs(nominal["value"] - (28.0 - shift / SENSITIVITY)) < 3.3 * nominal["sigma"]
    together = {one["effect"]: one.get("together_with", {}).get("effect") for one in found["alternatives"]}
    assert together.get("bias_shift") == ("supply_sensitivity" if shift else None)
    assert ("bias shift on accel_x with it counted from the usual" in report.document["text"]) == (shift != 0.0)
    assert report.document["next_recording"][0]["name"] == "supply"
    assert report.document["next_recording"][0]["expected_nats"] > 10.0 * found["evidence_nats"]


def test_what_says_the_same_in_other_words_ties_however_the_words_are_charged(tmp_path: Path) -> None:
    """A shift of d = 10 beside a coefficient of 80: the fitted voltage says it for less than a second name is charged.

    It was named alone; the shift was 3.5 nats behind by its charge, and by the data none.
    """
    case = hidden_case(90616, 390, tmp_path)
    found = next(
        one
        for one in discrepancy([case.recording], case.model).findings
        if one["effect"] == "supply_sensitivity" and one["channel"] == "accel_z"
    )
    (shift,) = (one for one in found["alternatives"] if one["effect"] == "bias_shift")
    assert shift["channel"] == "accel_z"
    assert shift["together_with"] == {"effect": "supply_sensitivity", "channel": "accel_z"}
    assert abs(shift["behind_nats"]) < 3.0


def test_where_a_shift_is_named_too_a_coefficient_is_counted_from_the_usual_voltage() -> None:
    def change(_: Truth, readings: np.ndarray) -> None:
        readings[:, 0] += 1.5e-3 + SENSITIVITY * (SUPPLY_V - 28.0)

    case = recording(change, 91, moving=False)
    samples = case.samples.copy()
    samples["supply"] = SUPPLY_V
    found = {
        one["effect"]: one["parameters"] for one in discrepancy([replace(case, samples=samples)], model()).findings
    }
    assert set(found) == {"bias_shift", "supply_sensitivity"}
    assert (found["supply_sensitivity"]["nominal"]["value"], found["supply_sensitivity"]["nominal"]["sigma"]) == (
        28.0,
        None,
    )
    shift = found["bias_shift"]["shift"]
    assert abs(shift["value"] - 1.5e-3) < 3.3 * shift["sigma"]


def test_that_one_of_several_names_is_there_is_surer_than_any_of_them() -> None:
    """What grows with the input in six attitudes may be of any order; that it is there at all is beyond chance."""

    def change(true: Truth, readings: np.ndarray) -> None:
        readings[:, 2] += 0.12 * ACCEL_SIGMA * (true["accel"][:, 2] / closed_form.GRAVITY_MPS2) ** 3

    (found,) = discrepancy([recording(change, 92)], model()).findings
    assert found["evidence_nats"] < MARGIN
    names = {found["effect"], *(one["effect"] for one in found["alternatives"])}
    assert {"scale_factor", "scale_quadratic", "scale_cubic"} <= names


@pytest.mark.parametrize(("start_s", "names"), [(50.1, []), (36.0, ["bias_step", "bias_step"])])
def test_two_steps_at_the_ends_of_a_turn_are_what_the_turn_does(start_s: float, names: list[str]) -> None:
    """What lasts as long as a turn does but is a tenth of a second late has a curve that fits less well than steps."""

    def change(true: Truth, readings: np.ndarray) -> None:
        readings[:, 0] += 8.0 * ACCEL_SIGMA * ((true["t"] > start_s) & (true["t"] < start_s + 10.0))

    report = discrepancy([recording(change, 95)], model())
    assert [one["effect"] for one in report.findings] == names, report.document["text"]
    assert report.verdict == ("named" if names else "unknown")


@pytest.mark.parametrize(("seed", "number"), [(90617, 105), (90618, 485)])
def test_two_names_of_one_sensor_are_no_curve_and_no_third_name_with_one(
    seed: int, number: int, tmp_path: Path
) -> None:
    """Curves of second and third order on one gyro: a limit and a wave, or a product, explained them as well."""
    case = hidden_case(seed, number, tmp_path)
    report = discrepancy([case.recording], case.model)
    told = {
        (one["effect"], one["channel"])
        for found in report.findings
        for one in (found, *(other for other in found["alternatives"] if other["behind_nats"] < 3.0))
    }
    assert {(one["effect"], one["channel"]) for one in case.truth["effects"]} <= told
    assert not report.document["remaining"]["empirical"]


@pytest.mark.parametrize(("seed", "number"), [(90625, 981), (90621, 5)])
def test_two_accelerometers_that_are_off_are_not_gravity_and_the_third(seed: int, number: int, tmp_path: Path) -> None:
    """Gravity goes best alone; with the third to undo it, it does worse than the two that are off."""
    case = hidden_case(seed, number, tmp_path)
    report = discrepancy([case.recording], case.model)
    told = [
        {(one["effect"], one["channel"]), *((a["effect"], a["channel"]) for a in one["alternatives"])}
        for one in report.findings
    ]
    hidden = {(one["effect"], one["channel"]) for one in case.truth["effects"]}
    assert len(told) == len(hidden)
    assert all(names & hidden for names in told)
    assert not any(("gravity_error", "all") in names for names in told)


def test_two_scale_factors_tie_with_gravity_and_the_third() -> None:
    """Two accelerometers read 48 ppm too little: so they do in more gravity, if the third reads as much too little."""

    def change(_: Truth, readings: np.ndarray) -> None:
        readings[:, [0, 2]] *= 1.0 - 4.8e-5

    report = discrepancy([recording(change, 5)], model())
    names = [(one["effect"], one["channel"]) for one in report.findings]
    assert sorted(names) == [("scale_factor", "accel_x"), ("scale_factor", "accel_z")]
    for found, other in zip(report.findings, reversed(names), strict=True):
        (gravity,) = (one for one in found["alternatives"] if one["effect"] == "gravity_error")
        assert gravity["together_with"] == {"effect": "scale_factor", "channel": "accel_y"}
        assert gravity["in_place_of_both"] == dict(zip(("effect", "channel"), other, strict=True))
        assert abs(gravity["behind_nats"]) < 1.0
        assert found["next_recording"][0]["expected_nats"] < 1.0  # nor would any other recording tell
    assert "gravity error on all with scale factor on accel_y in the place of it and the" in report.document["text"]


@pytest.mark.parametrize(("weak", "alone", "beside"), [(0.11, True, False), (0.2, True, True)])
def test_a_further_name_must_be_surer_than_a_first(weak: float, alone: bool, beside: bool) -> None:
    """The weaker drift has some 300 to 1 for it: enough where nothing else is found, not beside a shift that is."""

    def drifts(true: Truth, readings: np.ndarray) -> None:
        readings[:, 3] += weak * WHITE["gyro"] * np.sqrt(RATE_HZ) * true["t"] / DURATION_S

    def shifted_too(true: Truth, readings: np.ndarray) -> None:
        drifts(true, readings)
        readings[:, 1] += 0.5 * ACCEL_SIGMA

    found = {one["channel"] for one in discrepancy([recording(drifts, 2)], model()).findings}
    assert found == ({"gyro_x"} if alone else set())
    found = {one["channel"] for one in discrepancy([recording(shifted_too, 2)], model()).findings}
    assert found == ({"accel_y", "gyro_x"} if beside else {"accel_y"})


def test_a_search_in_which_two_names_put_each_other_out_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    names = [("bias_shift", "accel_x"), ("bias_shift", "accel_y")]
    evidence = Evidence(Library([compare(recording(None, 90), model())], only=set(names)))
    pair = [next(h for h in evidence.library.hypotheses if h.name == name) for name in names]
    rounds = []

    def with_the_other(self: Searcher, current: Fit, adopted: list[Hypothesis]) -> tuple[list[Hypothesis], Fit]:
        rounds.append(adopted)
        if len(rounds) > 10:
            pytest.fail("the search goes round and round")
        new = pair[1] if pair[0] in adopted else pair[0]
        return [*adopted, new], self.ranking.fit_of([*adopted, new], current)

    def without_the_first(
        self: Searcher, adopted: list[Hypothesis], current: Fit, judged: list[Hypothesis], share: float = 0.5
    ) -> tuple[list[Hypothesis], Fit]:
        left = [h for h in adopted if share > 0.5 or h not in judged]
        return left, self.ranking.fit_of(left, current)

    monkeypatch.setattr(Searcher, "_with_new", with_the_other)
    monkeypatch.setattr(Searcher, "_settle", without_the_first)
    assert len(Searcher(evidence).run().adopted) == 1


def test_names_that_are_one_and_the_same_at_rest_take_one_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nine of them are a constant; what is next in line must not be crowded out."""
    monkeypatch.setattr(ranking, "_LEADERS", 3)

    def change(_: Truth, readings: np.ndarray) -> None:
        readings[:, 5] += 1.5 * WHITE["gyro"]

    (found,) = discrepancy([recording(change, 99, moving=False)], model()).findings
    told = {(found["effect"], found["channel"]), *((a["effect"], a["channel"]) for a in found["alternatives"])}
    names = ("bias_shift", "scale_factor", "scale_asymmetry", "scale_quadratic", "scale_cubic")
    assert {(name, "gyro_z") for name in names} <= told
    assert {(name, "gyro_z<-accel_z") for name in ("g_sensitivity", "g2_sensitivity")} <= told
    assert {("misalignment", "gyro_z<-gyro_x"), ("misalignment", "gyro_z<-gyro_y")} <= told


def test_a_fit_shared_by_parallel_columns_is_the_fit_of_each() -> None:
    """At rest a gyro's scale factor is a constant, Earth's rate times smaller than a shift of bias."""

    def change(_: Truth, readings: np.ndarray) -> None:
        readings[:, 5] += 1.5 * WHITE["gyro"]

    case = recording(change, 99, moving=False)
    evidence = Evidence(Library([compare(case, model())], only={("bias_shift", "gyro_z"), ("scale_factor", "gyro_z")}))
    shift, scale = (
        next(h for h in evidence.library.hypotheses if h.effect == effect) for effect in ("bias_shift", "scale_factor")
    )
    ratio = evidence.library.ratio(scale, shift)
    assert ratio == pytest.approx(7.292115e-5 * np.sin(np.radians(closed_form.LATITUDE_DEG)), rel=1e-6)
    shared = evidence.fit(shift.columns).with_parallel(shift.columns[0], scale.columns[0], ratio)
    own = evidence.fit(scale.columns)
    assert shared.ids == own.ids
    np.testing.assert_allclose(shared.amplitude, own.amplitude, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(shared.covariance, own.covariance, rtol=1e-6, atol=1e-12 * own.covariance.max())


def test_a_turned_sign_that_a_shift_could_only_match_by_chance_has_no_alternative() -> None:
    """A shift of twice gravity, to the last of ten thousand σ, at a block that stands still."""

    def change(_: Truth, readings: np.ndarray) -> None:
        readings[:, 2] *= -1.0

    (found,) = discrepancy([recording(change, 96, moving=False)], model()).findings
    assert (found["effect"], found["channel"], found["alternatives"]) == ("sign_flip", "accel_z", [])


@pytest.mark.parametrize("exchanged", [True, False])
def test_axes_exchanged_at_rest_are_told_from_an_azimuth_that_does_nearly_the_same(exchanged: bool) -> None:
    """Of two gyros in the level plane that see little of Earth's rate; an exchange has no size to be found."""

    def change(true: Truth, readings: np.ndarray) -> None:
        noise = readings[:, 3:5] - true["gyro"][:, :2]
        rates = true["gyro"][:, 1::-1] if exchanged else true["gyro"][:, :2] @ np.array([[0.9, 0.44], [-0.44, 0.9]])
        readings[:, 3:5] = rates + 20.0 * noise

    noise = model().noise
    louder = {
        name: getattr(noise, name).model_copy(update={"white": 20.0 * getattr(noise, name).white})
        for name in ("gyro_x", "gyro_y")
    }
    believed = model().model_copy(update={"noise": noise.model_copy(update=louder)})
    (found,) = discrepancy([recording(change, 98, moving=False)], believed).findings
    assert (found["effect"] == "axis_swap") == exchanged, found


@pytest.mark.parametrize("turned", [-1.0, 0.4])
def test_a_shift_at_rest_may_be_a_sign_turned_where_it_is_twice_the_input(turned: float) -> None:
    """Earth's rate is 6 σ of this gyro's mean: too little for the signs to be checked before all else."""
    rng = np.random.default_rng(19)

    def change(_: Truth, readings: np.ndarray) -> None:
        readings[:, 4] *= turned
        readings[:, 4] += 30.0 * WHITE["gyro"] * np.sqrt(RATE_HZ) * rng.standard_normal(len(readings))

    believed = model()
    gyro_y = believed.noise.gyro_y.model_copy(update={"white": 30.0 * WHITE["gyro"]})
    believed = believed.model_copy(update={"noise": believed.noise.model_copy(update={"gyro_y": gyro_y})})
    (found,) = discrepancy([recording(change, 97, moving=False)], believed).findings
    told = {(found["effect"], found["channel"]), *((a["effect"], a["channel"]) for a in found["alternatives"])}
    assert ("bias_shift", "gyro_y") in told
    assert (("sign_flip", "gyro_y") in told) == (turned < 0.0)
