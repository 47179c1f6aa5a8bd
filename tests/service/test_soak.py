"""The soak's own judgement: growth is told from a level that wanders, and what was lost is found."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks._soak.page import write_page
from benchmarks._soak.records import Records
from benchmarks._soak.trend import spans, trend_of
from service.store import Store, TransitionRecord, utc_now

SPAN_S = 900.0
TRIALS = 600


def wandering(rng: np.random.Generator, count: int, correlation: float) -> np.ndarray:
    """Return a level that forgets slowly, of unit innovations."""
    level = np.empty(count)
    level[0] = rng.standard_normal() / math.sqrt(1 - correlation**2)
    for row in range(1, count):
        level[row] = correlation * level[row - 1] + rng.standard_normal()
    return level


@pytest.mark.parametrize("correlation", [0.0, 0.5])
def test_a_level_that_wanders_is_no_growth(correlation: float) -> None:
    rng = np.random.default_rng(5)
    found = 0
    for _ in range(TRIALS):
        trend = trend_of([(np.arange(90) * SPAN_S, 300.0 + wandering(rng, 90, correlation))])
        assert trend is not None
        found += trend.p_value < 0.05
    band = 3.29 * math.sqrt(0.05 * 0.95 / TRIALS)  # 99.9 % of a binomial of 5 %
    assert abs(found / TRIALS - 0.05) <= band


def test_growth_is_found_through_restarts_with_its_size() -> None:
    rng = np.random.default_rng(6)
    slope = 5.0 / 86_400.0  # 5 MB a day, lost in each restart's own level
    lives = []
    for count in (40, 25, 60):
        time = np.arange(count) * SPAN_S
        lives.append((time, rng.uniform(250, 350) + slope * time + 0.2 * wandering(rng, count, 0.5)))
    trend = trend_of(lives)
    assert trend is not None
    assert trend.p_value < 1e-3
    assert abs(trend.slope - slope) < 3.29 * trend.sigma
    assert trend.upper() > slope


def test_too_little_to_tell_is_told() -> None:
    assert trend_of([(np.arange(4.0), np.ones(4))]) is None
    time, level = spans(np.arange(0.0, 2_000.0, 10.0), np.ones(200), SPAN_S)
    assert (len(time), level.tolist()) == (2, [1.0, 1.0])


def test_what_the_service_lost_is_found(tmp_path: Path) -> None:
    store = Store(tmp_path / "inertrim.db")
    run, _ = store.create_run({}, "optimal", None)
    told = [TransitionRecord("OFFLINE", "POWER_UP", "start", "", 0.0, utc_now(), run.id) for _ in range(2)]
    store.add_transitions(told[:1])
    store.save_result(run.id, "{}", "fit")
    store.audit("soak", "start", run.id, "accepted")
    store.close()

    def records() -> Records:
        kept = Records()
        kept.begun(run.id)
        kept.accepted("start", run.id)
        kept.told(run.id, {"transitions": [vars(one) for one in told[:1]]})
        kept.result(run.id, b"{}")
        return kept

    whole = records()
    found = whole.check(tmp_path / "inertrim.db", set())
    assert (found["runs"], found["changes"], found["results"], found["commands"]) == (1, 1, 1, 1)
    assert whole.lost == [f"run {run.id} stands open in POWER_UP"]
    for spoil, lost in (
        (lambda kept: kept.begun("another"), "is not in the store"),
        (lambda kept: kept.accepted("start", run.id), "is missing"),
        (lambda kept: kept.told(run.id, {"transitions": [vars(one) for one in told]}), "are not in the store"),
        (lambda kept: kept.told(run.id, {"transitions": []}), "were told, now 0"),
        (lambda kept: kept.result(run.id, b"{ }"), "its result changed"),
    ):
        kept = records()
        spoil(kept)
        kept.check(tmp_path / "inertrim.db", set())
        assert any(lost in text for text in kept.lost), (lost, kept.lost)


def test_the_page_tells_what_was_tried_and_what_was_not(tmp_path: Path) -> None:
    page = tmp_path / "reliability.md"
    page.write_text("before\n<!-- soak -->\nold\n<!-- /soak -->\nafter\n")
    trouble = {"faults": ["kill"], "reaction": "ABORTED service_stopped", "recovered_s": 400.0, "same_run": False}
    kept = {"runs": 3, "changes": 20, "results": 2, "commands": 4, "recordings": 2}
    found = {"hours": 1.5, "speed": 20.0, "lives": 2, "troubles": [trouble], "stuck": ["at 5 s: HOLD"], "lost": []}
    found |= {"kept": kept, "growth": None, "largest_open_files": 40, "not_possible": ["disk_full"], "bad_ends": []}
    write_page(page, {**found, "false_fit": []}, seed=7)
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "old" not in text
    assert "1.5 simulated hours" in text
    assert "| `kill` |" in text
    assert "at 5 s: HOLD" in text
    assert "Not possible on the machine of this run: `disk_full`" in text
