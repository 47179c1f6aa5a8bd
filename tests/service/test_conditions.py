"""Go / no-go without HTTP: limits, persistence, severity, acknowledgement (service/conditions)."""

from __future__ import annotations

from dataclasses import replace

import pytest

from service.conditions import Board, CannotAcknowledge, Facts, UnknownCondition
from service.conditions.catalogue import CATALOGUE

GOOD = Facts(
    link="STREAMING",
    age_s=0.01,
    settled=True,
    still=True,
    temperature_c=20.0,
    temperature_range_c=(-10.0, 40.0),
    calibration_age_days=30.0,
    terms_share=0.4,
    worst_term="gyro x",
    chi_square=5.0,
    chi_square_limit=22.5,
    ready=True,
    valid_for_s=900.0,
    disk_free_mb=5_000.0,
    rate_error=1e-5,
    rate_sigma=1e-6,
)
BROKEN = {
    "frames_fresh": {"link": "STALE", "age_s": 2.0},
    "settled": {"settled": False},
    "still": {"still": False},
    "temperature_in_range": {"temperature_c": 41.0},
    "calibration_age": {"calibration_age_days": 366.0},
    "terms_expected": {"terms_share": 1.01},
    "verification": {"chi_square": 22.6},
    "validity": {"valid_for_s": 0.0},
    "clock": {"wall_jump_s": -3.0},
    "disk_space": {"disk_free_mb": 199.0},
    "sample_rate": {"rate_error": -1.2e-3},
}
UNKNOWABLE = {
    "settled": {"settled": None},
    "still": {"still": None},
    "temperature_in_range": {"temperature_range_c": None},
    "calibration_age": {"calibration_age_days": None},
    "terms_expected": {"terms_share": None},
    "verification": {"chi_square": None},
    "validity": {"valid_for_s": None},
    "disk_space": {"disk_free_mb": None},
    "sample_rate": {"rate_error": None},
}
SEVERITY = {one.name: one.severity for one in CATALOGUE}
PERSISTENCE_S = {one.name: one.persistence_s for one in CATALOGUE}


class Watch:
    """A board with a clock of its own."""

    def __init__(self) -> None:
        self.ticks = 0
        self.board = Board(self._utc)
        self.now_s = 0.0
        self.look(GOOD)
        self.look(GOOD, 60.0)

    def _utc(self) -> str:
        self.ticks += 1
        return f"tick {self.ticks}"

    def look(self, facts: Facts, after_s: float = 0.0) -> list[str]:
        self.now_s += after_s
        return self.board.update(facts, self.now_s)

    def entry(self, name: str) -> dict:
        return self.board.entry(name)


def test_all_good_is_all_ok() -> None:
    watch = Watch()
    assert {one["name"]: one["state"] for one in watch.board.listing()} == dict.fromkeys(SEVERITY, "ok")
    assert watch.board.against() == []
    assert set(BROKEN) == set(SEVERITY)


@pytest.mark.parametrize("name", BROKEN)
def test_each_is_broken_by_its_own_measure_alone_and_only_once_that_has_lasted(name: str) -> None:
    watch, broken = Watch(), replace(GOOD, **BROKEN[name])
    watch.look(broken)
    if PERSISTENCE_S[name] > 0:
        assert watch.entry(name)["state"] == "pending"
        assert watch.board.against() == []
        watch.look(broken, PERSISTENCE_S[name] - 0.1)
        assert watch.entry(name)["state"] == "pending"
        watch.look(broken, 0.1)
    states = {one["name"]: one["state"] for one in watch.board.listing()}
    assert states == {**dict.fromkeys(SEVERITY, "ok"), name: "failed"}
    (words,) = watch.board.against()
    assert words.startswith(f"{name}: ")
    entry = watch.entry(name)
    assert entry["cause"]
    assert entry["remedy"]
    assert entry["text"] in words


@pytest.mark.parametrize("name", [name for name in BROKEN if PERSISTENCE_S[name] > 0])
def test_a_short_breach_is_none(name: str) -> None:
    watch = Watch()
    watch.look(replace(GOOD, **BROKEN[name]))
    watch.look(GOOD, PERSISTENCE_S[name] / 2)
    assert watch.entry(name)["state"] == "ok"
    watch.look(replace(GOOD, **BROKEN[name]), PERSISTENCE_S[name])  # begins anew
    assert watch.entry(name)["state"] == "pending"


@pytest.mark.parametrize("name", UNKNOWABLE)
def test_what_cannot_be_told_is_unknown_and_speaks_neither_for_nor_against(name: str) -> None:
    watch = Watch()
    watch.look(replace(GOOD, **UNKNOWABLE[name]), 60.0)
    assert watch.entry(name)["state"] == "unknown"
    assert watch.board.against() == []


def test_the_time_of_a_state_is_that_of_its_change() -> None:
    watch, broken = Watch(), replace(GOOD, still=False)
    assert watch.look(broken) == ["still"]
    since = watch.entry("still")["since"]
    assert watch.look(broken, 10.0) == []
    assert watch.entry("still")["since"] == since
    assert watch.look(GOOD, 1.0) == ["still"]
    assert watch.entry("still")["since"] != since


@pytest.mark.parametrize("name", BROKEN)
def test_a_warning_that_somebody_takes_on_lets_go_and_stays_in_the_reasons_but_nothing_critical_does(name: str) -> None:
    watch, broken = Watch(), replace(GOOD, **BROKEN[name])
    watch.look(broken)
    watch.look(broken, 60.0)
    watch.board.acknowledge(name, "Ada", "seen")
    if SEVERITY[name] == "critical":
        assert watch.entry(name)["state"] == "failed"
        assert watch.board.against()
    else:
        assert watch.entry(name)["state"] == "acknowledged"
        assert watch.board.against() == []
        (noted,) = watch.board.noted()
        assert noted.startswith(f"{name}: ")
        assert noted.endswith("; acknowledged by Ada: seen")
    assert watch.entry(name)["acknowledgement"]["by"] == "Ada"
    watch.look(broken, 60.0)  # it goes on being broken: the note holds
    assert watch.entry(name)["acknowledgement"]["reason"] == "seen"
    watch.look(GOOD, 60.0)
    watch.look(GOOD, 60.0)
    assert watch.entry(name)["state"] == "ok"
    assert watch.entry(name)["acknowledgement"] is None
    watch.look(broken, 1.0)
    watch.look(broken, 60.0)  # broken anew: nobody has taken note of this
    assert watch.entry(name)["state"] == "failed"
    assert watch.board.noted() == []


def test_only_what_is_broken_can_be_acknowledged() -> None:
    watch = Watch()
    with pytest.raises(CannotAcknowledge, match="clock is ok"):
        watch.board.acknowledge("clock", "Ada", "why not")
    with pytest.raises(UnknownCondition):
        watch.board.acknowledge("weather", "Ada", "rain")


def test_a_noisy_clock_estimate_does_not_count_as_a_wrong_rate() -> None:
    watch = Watch()
    watch.look(replace(GOOD, rate_error=2e-3, rate_sigma=1e-3), 0.0)
    watch.look(replace(GOOD, rate_error=2e-3, rate_sigma=1e-3), 60.0)
    assert watch.entry("sample_rate")["state"] == "ok"
