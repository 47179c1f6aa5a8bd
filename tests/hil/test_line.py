"""Runs over a real pseudo-terminal, with everything that can happen to a line and a block (docs/states.md)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from line_service import SEED, Bench, Console

from drivers.capture import replay
from drivers.protocols import get_protocol
from drivers.recording import read_recording
from inertial.documents import Result, parse_document
from service.compensate import compensate
from service.states import PATH
from simulators.scenarios import demo_model, demo_scenario, planted_terms

LINE_ERRORS = {"bit_flips": 0.01, "cuts": 0.002, "garbage": 0.002}


@pytest.fixture
def console(bench: Bench) -> Iterator[Console]:
    made = Console(bench)
    yield made
    made.close()


def result_of(console: Console) -> Result:
    document = console.controller.store.result(console.run_id)
    assert document is not None
    return parse_document(Result, document, "result")


def assert_terms_are_the_planted_ones(result: Result) -> None:
    """Each term within 4 of its own σ: six terms pass so by chance in all but one of 2600 runs."""
    planted = planted_terms(demo_scenario(SEED), demo_model(SEED))
    found, sigma = result.terms["final"], result.sigma
    left = np.concatenate([np.subtract(found.f_mps2, planted.f_mps2), np.subtract(found.g_radps, planted.g_radps)])
    assert np.all(np.abs(left) < 4 * np.array([*sigma.f_mps2, *sigma.g_radps], dtype=float))


def test_a_run_on_a_bad_line_ends_ready_and_its_recording_gives_the_same_terms(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    console = Console(bench)
    for kind, probability in LINE_ERRORS.items():
        bench.inject(kind, probability=probability)
    run_id = console.start()
    facts = console.until("READY")
    assert facts["fit"]
    assert [target for _, target, _ in console.recorded("READY")] == [state.value for state in PATH]

    result = result_of(console)
    found = result.terms["final"]
    assert_terms_are_the_planted_ones(result)

    folder = console.controller.folder(run_id)
    again = compensate(read_recording(folder.recording))
    assert again.terms == result.terms  # bit for bit: these are the same doubles
    assert again.covariance == result.covariance
    assert [window.kind for window in again.windows] == ["align", "stage_1", "stage_2", "stage_3", "verify"]
    assert result.block["identity"]["serial"] == f"demo-{SEED}"
    assert parse_document(Result, folder.result.read_bytes(), "result.json") == result
    assert "<html" in folder.report.read_text()

    # The block holds what was found: read back over the line, as anyone after us would.
    assert console.controller.line is not None
    assert console.controller.line.ask("read_back", None) == found

    # No untouched frame was lost on the way into the recording.
    rows = read_recording(folder.recording).samples
    captured = np.concatenate([batch.samples for batch in replay(folder.capture, get_protocol("native"))])
    assert np.isin(rows["sequence"], captured["sequence"]).all()
    console.close()
    ledger = bench.close()
    touched = {int(sequence) for sequence in ledger["cycles"][0]["touched"]}
    missing = set(range(int(rows["sequence"][0]), int(rows["sequence"][-1]))) - set(rows["sequence"].tolist())
    assert missing <= touched
    assert len(missing) > 0.005 * len(rows)  # the line really was bad


def test_a_three_second_unplug_in_each_state_is_survived(bench: Bench, console: Console) -> None:
    bench.inject("unplug", duration_s=3.0)  # OFFLINE
    console.start()
    bench.inject("unplug", duration_s=3.0)  # POWER_UP
    for state in PATH[1:-1]:
        console.until(state.value)
        if state.value.startswith(("ALI", "STA", "VER", "SET")):
            bench.wait_s(2.0)
        bench.inject("unplug", duration_s=3.0)
        console.until_recorded((state.value, "HOLD", "link_stale"))
        console.until_recorded(("HOLD", state.value, "still_again"))
    console.until("READY")
    changes = console.recorded("READY")
    assert [target for source, target, _ in changes if source != "HOLD" and target != "HOLD"] == list(PATH)
    assert result_of(console).fit
    bench.inject("unplug", duration_s=3.0)
    facts = console.until("HOLD")
    assert (facts["reason"], facts["fit"], facts["allowed"]) == ("link_stale", False, ["start", "abort"])


def test_restart_and_shake_begin_again_by_themselves(bench: Bench, console: Console) -> None:
    console.start()
    console.until("STAGE_1")
    bench.inject("restart")
    console.until("POWER_UP")
    console.until("STAGE_2")
    bench.wait_s(3.0)
    bench.inject("move", duration_s=2.0, rate_dps=1.0)
    console.until("HOLD")
    bench.wait_s(4.0)
    bench.inject("move", duration_s=2.0, rate_dps=-1.0)  # back to where it stood
    console.until("READY")
    changes = console.recorded("READY")
    assert ("STAGE_1", "POWER_UP", "block_restart") in changes
    assert ("STAGE_2", "HOLD", "motion") in changes
    assert ("HOLD", "STAGE_2", "still_again") in changes
    assert result_of(console).fit

    bench.inject("restart")
    facts = console.until("HOLD")
    assert (facts["reason"], facts["fit"]) in (("block_restart", False), ("link_stale", False))


def test_a_small_turn_is_carried_into_the_result_and_a_large_one_is_a_fault(bench: Bench, console: Console) -> None:
    console.start()
    console.until("STAGE_2")
    bench.wait_s(3.0)
    bench.inject("move", duration_s=2.0, rate_dps=1.0, axis=[0.6, 0.0, 0.8])
    console.until("READY")
    assert ("HOLD", "ALIGNING", "still_again") in console.recorded("READY")
    assert_terms_are_the_planted_ones(result_of(console))
    recording = read_recording(console.controller.folder(console.run_id).recording)
    (turn,) = recording.meta.motion
    assert turn.kind == "turn"
    assert turn.rate_dps * (turn.end_s - turn.start_s) == pytest.approx(2.0, abs=2e-3)
    assert turn.axis == pytest.approx([0.6, 0.0, 0.8], abs=2e-3)
    assert compensate(recording).terms == result_of(console).terms

    console.start()
    console.until("STAGE_2")
    bench.wait_s(3.0)
    bench.inject("move", duration_s=2.0, rate_dps=4.0)
    facts = console.until("FAULT")
    assert facts["reason"] == "attitude_changed"
    assert "8° from" in facts["detail"]
    assert console.controller.store.result(console.run_id) is None


def test_a_stuck_sensor_is_a_fault_and_is_found_by_the_next_self_test(bench: Bench, console: Console) -> None:
    run_id = console.start()
    console.until("STAGE_3")
    bench.inject("stuck_sensor", channel="gyro_z", duration_s=10_000.0)
    facts = console.until("FAULT")
    assert facts["reason"] == "stuck_sensor"
    assert "gyro_z" in facts["detail"]
    assert console.controller.store.result(run_id) is None
    console.recorded("FAULT")
    assert len(console.kept_samples()) > 500
    console.controller.acknowledge_run(run_id, "test", "looked at")
    console.until("OFFLINE")
    console.start()
    facts = console.until("FAULT")
    assert facts["reason"] == "self_test_failed"
    assert "INVALID_GYRO_Z" in facts["detail"]
    audit = [(one["command"], one["outcome"], one["detail"]) for one in console.controller.store.audit_log()]
    assert ("acknowledge", "accepted", "looked at") in audit


def test_a_result_never_stands_without_its_data(bench: Bench, console: Console) -> None:
    """Abort at the worst moment: while the result is being made."""
    run_id = console.start()
    console.until(lambda facts: facts["state"] == "VERIFYING" and facts["progress"] == 1.0)
    console.controller.abort_run(run_id, "test")
    console.recorded("ABORTED")
    bench.wait_s(60.0)
    folder = console.controller.folder(run_id)
    assert console.controller.store.result(run_id) is None
    assert not folder.result.exists()
    assert len(console.kept_samples()) > 500
