"""A run whose alignment takes the launcher's motion for what it is, and how it is offered."""

from __future__ import annotations

import pytest
from sequencer_bench import Bench

from service.sequencer import SWAY_OFFER
from service.states import Name
from service.windows import INERTIAL_ALIGN_S


def swaying(bench: Bench) -> Bench:
    """Start a run for a launcher that sways, and let it sway."""
    bench.core.start("run-1", bench.now_s, swaying=True)
    bench.answer()
    bench.judge.still = False
    return bench


def test_it_settles_and_aligns_while_the_launcher_sways_then_waits_for_stillness() -> None:
    bench = swaying(Bench())
    bench.until(Name.ALIGNING)
    begun_s = bench.now_s
    bench.until(Name.STAGE_1)
    assert bench.now_s - begun_s == pytest.approx(INERTIAL_ALIGN_S, abs=3.0)
    bench.until(Name.HOLD, 30.0)
    assert bench.seen[-1] == ("STAGE_1", "HOLD", "motion")
    bench.judge.still = True
    bench.until(Name.READY)


def test_a_plain_run_offers_it_where_motion_keeps_it_waiting() -> None:
    bench = Bench().at(Name.SETTLING)
    assert SWAY_OFFER not in bench.core.snapshot()["reasons"]
    bench.judge.still = False
    bench.run(3.0)
    assert SWAY_OFFER in bench.core.snapshot()["reasons"]
    bench.judge.still = True
    bench.until(Name.ALIGNING)
    bench.judge.still = False
    bench.until(Name.HOLD, 30.0)
    assert SWAY_OFFER in bench.core.snapshot()["reasons"]


def test_a_stage_that_is_held_does_not_offer_it() -> None:
    bench = Bench().at(Name.STAGE_1)
    bench.judge.still = False
    bench.until(Name.HOLD, 30.0)
    assert SWAY_OFFER not in bench.core.snapshot()["reasons"]


def test_frames_lost_while_it_sways_hold_it_no_longer_than_the_line_needs() -> None:
    bench = swaying(Bench())
    bench.until(Name.ALIGNING)
    bench.line = "STALE"
    bench.run(3.0)
    assert bench.core.state is Name.HOLD
    bench.line = "STREAMING"
    bench.until(Name.ALIGNING, 60.0)
