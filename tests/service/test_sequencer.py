"""The sequencer in pure simulated time: what leads where, with which reason (docs/states.md)."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sequencer_bench import TERMS, Bench, result

from drivers.samples import Status
from inertial.documents import StageTerms
from service.orders import Reply
from service.sequencer import NotAllowed
from service.states import PATH, RESUMABLE, WINDOWS, Name

WINDOW_STEPS = list(WINDOWS)
STATUS_KEYS = {
    *("state", "since", "reason", "run_id", "stage", "progress", "elapsed_s", "remaining_s"),
    *("link", "age_s", "fit", "reasons", "allowed"),
}


def last(bench: Bench) -> tuple[str, str, str]:
    return bench.seen[-1]


def test_a_good_run_goes_the_whole_way_and_every_change_has_a_reason() -> None:
    bench = Bench().at(Name.READY)
    assert [target for _, target, _ in bench.seen] == [name.value for name in PATH]
    assert all(reason for _, _, reason in bench.seen)
    assert bench.core.fit
    assert bench.core.snapshot()["reasons"] == ["proved"]


def test_windows_follow_one_another_without_gap_and_have_their_lengths() -> None:
    bench = Bench(align_s=20.0, stage_s=40.0, verify_s=30.0).at(Name.READY)
    windows = bench.estimates[-1].windows
    assert [window.kind for window in windows] == ["align", "stage_1", "stage_2", "stage_3", "verify"]
    assert [window.end_s - window.start_s for window in windows] == pytest.approx([20, 40, 40, 40, 30])
    assert [window.end_s for window in windows[:-1]] == [window.start_s for window in windows[1:]]


def test_the_estimate_gets_every_sample_of_its_windows() -> None:
    bench = Bench().at(Name.READY)
    order = bench.estimates[-1]
    times = order.samples["time"]
    assert times[0] <= order.windows[0].start_s
    assert times[-1] >= order.windows[-1].end_s
    assert np.all(np.diff(order.samples["sequence"].astype(int)) == 1)


def test_progress_is_estimated_after_each_stage() -> None:
    bench = Bench().at(Name.READY)
    assert [len(order.windows) for order in bench.estimates] == [2, 3, 4, 5]
    assert [order.final for order in bench.estimates] == [False, False, False, True]


def test_ready_comes_only_after_terms_were_written_read_back_and_kept() -> None:
    bench = Bench()
    bench.answers["Conclude"] = lambda _order: None
    bench.at(Name.VERIFYING).run(40)
    assert bench.core.state is Name.VERIFYING
    assert bench.asked == ["identity", "read", "start", "self_test", "write", "read_back"]
    assert bench.written == TERMS


# ------------------------------------------------------------------ refusals


@pytest.mark.parametrize("state", PATH[:-1])
def test_a_run_under_way_refuses_another_and_says_what_is_allowed(state: Name) -> None:
    bench = Bench().at(state)
    with pytest.raises(NotAllowed) as refused:
        bench.start("run-2")
    assert refused.value.allowed == ["abort"]
    assert bench.core.run is not None
    assert bench.core.run.run_id == "run-1"


@pytest.mark.parametrize("state", PATH)
def test_abort_leads_out_of_every_step(state: Name) -> None:
    bench = Bench().at(state)
    bench.core.abort(bench.now_s)
    assert bench.core.state is Name.ABORTED
    assert bench.core.allowed() == ["start"]
    bench.start("run-2")
    bench.until(Name.READY)


def test_nothing_to_abort_or_acknowledge_when_offline() -> None:
    bench = Bench()
    for command in (bench.core.abort, bench.core.acknowledge):
        with pytest.raises(NotAllowed):
            command(bench.now_s)
    assert bench.core.allowed() == ["start"]


def test_a_fault_is_left_only_by_acknowledgement() -> None:
    bench = Bench()
    bench.answers["self_test"] = lambda order: Reply(order.token, "self_test", "SELF_TEST_FAILED")
    bench.at(Name.FAULT)
    assert last(bench)[2] == "self_test_failed"
    assert bench.core.allowed() == ["acknowledge"]
    bench.run(100)
    assert bench.core.state is Name.FAULT
    bench.core.acknowledge(bench.now_s)
    assert bench.core.state is Name.OFFLINE
    assert bench.core.allowed() == ["start"]


# ------------------------------------------------------------------ power-up and self-test


def test_power_up_waits_for_the_end_of_start_up() -> None:
    bench = Bench()
    bench.status = Status.START_UP
    bench.start()
    bench.run(5)
    assert bench.core.state is Name.POWER_UP
    bench.status = Status(0)
    bench.run(2)
    assert bench.core.state is Name.SETTLING


def test_a_silent_block_ends_in_power_up_timeout() -> None:
    bench = Bench()
    bench.alive, bench.line = False, "SYNCING"
    bench.answers["identity"] = lambda order: Reply(order.token, "identity", error="no answer")
    bench.start()
    bench.until(Name.FAULT)
    assert last(bench) == ("POWER_UP", "FAULT", "power_up_timeout")


def test_a_block_without_commands_runs_on_its_samples_alone() -> None:
    bench = Bench()
    for what in ("identity", "read", "start", "self_test", "write"):
        bench.answers[what] = lambda order: Reply(order.token, order.what, error="no such frame", unsupported=True)
    bench.at(Name.READY)
    assert "keeps no terms" in bench.details[-1]


def test_a_self_test_without_result_ends_in_its_time_out() -> None:
    bench = Bench()
    bench.answers["self_test"] = lambda _order: None
    bench.at(Name.FAULT)
    assert last(bench) == ("SELF_TEST", "FAULT", "self_test_timeout")


# ------------------------------------------------------------------ settling


def test_settling_ends_on_evidence_and_not_on_a_timer() -> None:
    bench = Bench()
    bench.warming_c_per_s = 0.05  # 3 °C/min
    bench.at(Name.SETTLING).run(200)
    assert bench.core.state is Name.SETTLING
    bench.warming_c_per_s = 0.0
    bench.until(Name.ALIGNING, limit_s=20.0)
    assert last(bench)[2] == "settled"


def test_settling_that_never_ends_is_a_fault_that_names_the_drift() -> None:
    bench = Bench(settling_max_s=60.0)
    bench.warming_c_per_s = 0.05
    bench.at(Name.FAULT)
    assert last(bench) == ("SETTLING", "FAULT", "settling_timeout")
    assert "temperature drifts +3 °C/min" in bench.details[-1]


def test_a_moving_block_does_not_settle() -> None:
    bench = Bench().at(Name.SETTLING)
    bench.judge.still = False
    bench.run(60)
    assert bench.core.state is Name.SETTLING


# ------------------------------------------------------------------ hold


@pytest.mark.parametrize("step", WINDOW_STEPS)
def test_motion_holds_and_the_step_begins_again_by_itself(step: Name) -> None:
    bench = Bench().at(step)
    bench.run(5)
    bench.judge.still = False
    bench.run(3)
    assert last(bench) == (step, "HOLD", "motion")
    assert bench.core.snapshot()["stage"] == step
    moved_until_s = bench.device_s
    bench.judge.still = True
    bench.run(4)
    assert bench.core.state is Name.HOLD  # still, but not yet for still_again_s
    bench.until(step, limit_s=10)
    bench.until(Name.READY)
    kind = WINDOWS[step]
    used = next(window for window in bench.estimates[-1].windows if window.kind == kind)
    assert used.start_s > moved_until_s
    before = [window for window in bench.estimates[-1].windows if window.end_s <= used.start_s]
    assert len(before) == WINDOW_STEPS.index(step)  # what was complete before the hold is kept


@pytest.mark.parametrize("step", RESUMABLE)
def test_a_stale_line_holds_and_the_step_begins_again(step: Name) -> None:
    bench = Bench()
    if step is Name.SELF_TEST:
        bench.answers["self_test"] = lambda _order: None
    bench.at(step)
    bench.line = "STALE"
    bench.run(3)
    assert last(bench) == (step, "HOLD", "link_stale")
    bench.answers.clear()
    bench.line = "STREAMING"
    bench.until(Name.READY)
    assert ("HOLD", step, "still_again") in bench.seen


def test_frames_lost_beyond_the_share_hold_and_fewer_do_not() -> None:
    bench = Bench(lost_fraction=0.05).at(Name.STAGE_1)
    bench.lose = 0.014
    bench.until(Name.STAGE_2)
    bench.lose = 0.2
    bench.until(Name.HOLD)
    assert last(bench) == ("STAGE_2", "HOLD", "frames_lost")
    bench.run(60)
    assert bench.core.state is Name.HOLD  # the line is no better yet
    bench.lose = 0.0
    bench.until(Name.READY)


def test_a_gap_that_swallows_a_whole_window_holds() -> None:
    bench = Bench().at(Name.STAGE_1)
    bench.lose = 1.0
    bench.run(200)
    bench.lose = 0.0
    bench.until(Name.HOLD)
    assert last(bench)[1:] == ("HOLD", "frames_lost")
    bench.until(Name.READY)


def test_a_hold_has_an_end() -> None:
    bench = Bench(hold_max_s=60.0).at(Name.STAGE_2)
    bench.judge.still = False
    bench.until(Name.FAULT)
    assert last(bench) == ("HOLD", "FAULT", "hold_timeout")


def test_holds_without_number_are_a_fault() -> None:
    bench = Bench(hold_max_count=3).at(Name.STAGE_1)
    for _ in range(4):
        bench.judge.still = False
        bench.run(2)
        bench.judge.still = True
        bench.run(8)
    assert bench.core.state is Name.FAULT
    assert last(bench)[2] == "too_many_holds"


def test_overrange_holds() -> None:
    bench = Bench().at(Name.STAGE_3)
    bench.status = Status.OVERLOAD
    bench.run(1)
    assert last(bench) == ("STAGE_3", "HOLD", "overrange")


def turn(bench: Bench, rate_dps: float, axis: int, seconds: float) -> None:
    bench.judge.still = False
    bench.turn(np.radians(rate_dps) * np.eye(3)[axis], seconds)


def test_a_shake_that_comes_back_costs_only_the_stage() -> None:
    bench = Bench().at(Name.STAGE_2)
    bench.run(5)
    turn(bench, 1.0, 0, 3)
    turn(bench, -1.0, 0, 3)
    bench.judge.still = True
    bench.until(Name.READY)
    assert ("HOLD", "STAGE_2", "still_again") in bench.seen
    assert bench.estimates[-1].turns == ()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_small_turn_is_carried_and_the_run_aligns_again(axis: int) -> None:
    bench = Bench().at(Name.STAGE_2)
    bench.run(5)
    turn(bench, 0.5, axis, 4)
    bench.judge.still = True
    bench.until(Name.READY)
    assert ("HOLD", "ALIGNING", "still_again") in bench.seen
    assert ("STAGE_1", "STAGE_2", "stage_complete") in bench.seen[
        bench.seen.index(("HOLD", "ALIGNING", "still_again")) :
    ]
    (carried,) = bench.estimates[-1].turns
    assert np.degrees(carried.rotation_rad) == pytest.approx(2.0 * np.eye(3)[axis], abs=2e-3)
    windows = bench.estimates[-1].windows
    assert carried.end_s <= windows[0].start_s


def test_a_turn_about_two_axes_is_carried_whole() -> None:
    bench = Bench().at(Name.STAGE_1)
    bench.run(5)
    turn(bench, 0.5, 0, 4)
    turn(bench, 0.5, 2, 4)
    bench.judge.still = True
    bench.until(Name.READY)
    (carried,) = bench.estimates[-1].turns
    wanted = Rotation.from_rotvec([np.radians(2), 0, 0]) * Rotation.from_rotvec([0, 0, np.radians(2)])
    assert np.degrees(carried.rotation_rad) == pytest.approx(np.degrees(wanted.as_rotvec()), abs=2e-3)


def test_a_large_turn_is_a_fault() -> None:
    bench = Bench(carry_deg=5.0).at(Name.STAGE_2)
    turn(bench, 3.0, 2, 3)
    bench.judge.still = True
    bench.until(Name.FAULT)
    assert last(bench) == ("HOLD", "FAULT", "attitude_changed")
    assert "9° from where it was aligned (limit 5°)" in bench.details[-1]


def test_a_turn_that_nobody_saw_is_a_fault() -> None:
    bench = Bench().at(Name.STAGE_2)
    bench.line = "STALE"
    turn(bench, 0.5, 1, 4)
    bench.judge.still, bench.line = True, "STREAMING"
    bench.until(Name.FAULT)
    assert last(bench) == ("HOLD", "FAULT", "attitude_changed")
    assert "frames were missing" in bench.details[-1]


# ------------------------------------------------------------------ block restarts, stuck sensors, flags


@pytest.mark.parametrize("step", RESUMABLE)
def test_a_block_restart_begins_the_run_again_from_power_up(step: Name) -> None:
    bench = Bench()
    if step is Name.SELF_TEST:
        bench.answers["self_test"] = lambda _order: None
    bench.at(step)
    bench.run(2)
    bench.answers.clear()
    bench.restart_block()
    bench.step()
    assert (step, "POWER_UP", "block_restart") in bench.seen
    bench.until(Name.READY)
    assert np.all(np.diff(bench.estimates[-1].samples["time"]) > 0)


def test_a_block_that_restarts_again_and_again_is_a_fault() -> None:
    bench = Bench(restart_max_count=2).at(Name.SETTLING)
    for _ in range(3):
        bench.run(4)
        bench.restart_block()
    bench.run(2)
    assert last(bench)[1:] == ("FAULT", "block_restarts")


def test_a_start_up_flag_in_mid_run_is_a_restart() -> None:
    bench = Bench().at(Name.STAGE_1)
    bench.status = Status.START_UP
    bench.run(1)
    assert last(bench) == ("STAGE_1", "POWER_UP", "block_restart")


@pytest.mark.parametrize("step", RESUMABLE[1:])
def test_a_stuck_sensor_is_a_fault_that_names_the_channel(step: Name) -> None:
    bench = Bench().at(step)
    bench.stuck = 1
    bench.run(4)
    assert last(bench) == (step, "FAULT", "stuck_sensor")
    assert "gyro_y" in bench.details[-1]
    assert bench.kept  # its samples are kept for whoever looks into it


def test_a_sensor_that_the_block_calls_invalid_is_a_fault() -> None:
    bench = Bench().at(Name.ALIGNING)
    bench.status = Status.INVALID_GYRO_Z
    bench.run(2)
    assert last(bench) == ("ALIGNING", "FAULT", "sensor_invalid")
    assert "INVALID_GYRO_Z" in bench.details[-1]


# ------------------------------------------------------------------ verification


def test_a_failed_verification_is_a_fault_and_nothing_is_written() -> None:
    bench = Bench()
    bench.answers["Estimate"] = lambda order: Reply(order.token, "final", result(fit=False)) if order.final else None
    bench.at(Name.FAULT)
    assert last(bench) == ("VERIFYING", "FAULT", "verification_failed")
    assert "chi-square" in bench.details[-1]
    assert "write" not in bench.asked
    assert [order.state for order in bench.concluded] == ["FAULT"]


def test_terms_that_read_back_otherwise_are_a_fault() -> None:
    bench = Bench()
    other = StageTerms(f_mps2=[0, 0, 0], g_radps=[0, 0, 0])
    bench.answers["read_back"] = lambda order: Reply(order.token, "read_back", other)
    bench.at(Name.FAULT)
    assert last(bench) == ("VERIFYING", "FAULT", "read_back_differs")


def test_a_write_that_fails_is_a_fault() -> None:
    bench = Bench()
    bench.answers["write"] = lambda order: Reply(order.token, "write", error="no acknowledgement in 3 tries")
    bench.at(Name.FAULT)
    assert last(bench) == ("VERIFYING", "FAULT", "write_failed")


def test_a_recording_that_cannot_be_estimated_is_a_fault() -> None:
    bench = Bench()
    bench.answers["Estimate"] = lambda order: Reply(order.token, "final", error="no span") if order.final else None
    bench.at(Name.FAULT)
    assert last(bench) == ("VERIFYING", "FAULT", "estimation_failed")


def test_a_result_that_cannot_be_kept_is_a_fault() -> None:
    bench = Bench()
    bench.answers["Conclude"] = lambda order: Reply(order.token, "conclude", error="No space left on device")
    bench.at(Name.FAULT)
    assert last(bench) == ("VERIFYING", "FAULT", "store_failed")


def test_a_reply_that_comes_after_its_step_changes_nothing() -> None:
    bench = Bench()
    late: list[Reply] = []
    bench.answers["Estimate"] = lambda order: (
        late.append(Reply(order.token, "final", result())) if order.final else None
    )
    bench.at(Name.VERIFYING).run(25)
    bench.core.abort(bench.now_s)
    for reply in late:
        bench.core.on_reply(reply)
    assert bench.core.state is Name.ABORTED
    assert not bench.core.orders or all(type(order).__name__ == "Keep" for order in bench.core.orders)


# ------------------------------------------------------------------ READY watches on


def moved(bench: Bench) -> None:
    bench.judge.still = False


def unplugged(bench: Bench) -> None:
    bench.line = "DISCONNECTED"


def warmed(bench: Bench) -> None:
    bench.temperature_c += 2.5


def restarted(bench: Bench) -> None:
    bench.restart_block()


def stuck(bench: Bench) -> None:
    bench.stuck = 0


def waited(bench: Bench) -> None:
    bench.run(130)


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        (moved, "motion"),
        (unplugged, "link_stale"),
        (warmed, "temperature_changed"),
        (restarted, "block_restart"),
        (stuck, "stuck_sensor"),
        (waited, "validity_expired"),
    ],
)
def test_ready_is_withdrawn_with_the_reason_and_waits_for_a_new_run(what, reason: str) -> None:
    bench = Bench(validity_s=120.0).at(Name.READY)
    bench.run(20)
    assert bench.core.fit
    what(bench)
    bench.run(4)
    assert last(bench) == ("READY", "HOLD", reason)
    assert not bench.core.fit
    bench.judge.still, bench.line, bench.stuck = True, "STREAMING", None
    bench.run(60)
    assert bench.core.state is Name.HOLD  # what READY vouched for does not come back by itself
    assert bench.core.allowed() == ["start", "abort"]
    bench.start("run-2")
    bench.until(Name.READY)
    assert bench.core.fit


def test_a_new_run_may_follow_ready_at_once() -> None:
    bench = Bench().at(Name.READY)
    bench.start("run-2")
    assert bench.core.snapshot()["run_id"] == "run-2"
    assert not bench.core.fit
    bench.until(Name.READY)


def test_the_status_has_the_keys_that_consoles_read() -> None:
    bench = Bench(stage_s=60.0).at(Name.STAGE_2)
    bench.run(20)
    status = bench.core.snapshot()
    assert set(status) >= STATUS_KEYS
    assert status["progress"] + status["remaining_s"] / 61.0 == pytest.approx(1.0, abs=1e-3)
    assert 0.3 < status["progress"] < 0.36
