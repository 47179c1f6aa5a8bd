"""A schedule a little off, a level far off: what the reference is wrong by is no effect of the block."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.recording import Recording, RecordingMeta
from drivers.recording_meta import TurnMeta
from inertial.documents import BlockModel
from service.trials import record
from simulators.discrepancy.report import discrepancy
from simulators.scenarios import demo_model, demo_scenario

RATE_HZ = 50.0
AXES = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])


def turned(folder: Path, late_s: float) -> tuple[Recording, BlockModel]:
    """Return three turns, of which each was begun ``late_s`` after what the recording says, just beyond an edge."""
    motion = [
        TurnMeta(kind="turn", start_s=s, end_s=s + 9.005, rate_dps=20.0, axis=axis, frame="body")
        for s, axis in zip((20.0005, 60.0005, 100.0005), AXES, strict=True)
    ]
    scenario = demo_scenario(3).warmed_up().with_motion(list(motion), 150.0)
    block = scenario.block.model_copy(update={"sample_rate_hz": RATE_HZ})
    model = demo_model(3)
    true = record(scenario.model_copy(update={"block": block, "effect": []}), model, folder / "turned")
    said = [
        turn.model_copy(
            update={"start_s": turn.start_s - late_s, "rate_dps": 20.0 * 9.005 / (9.005 + late_s)},
        )
        for turn in motion
    ]
    return replace(true, meta=true.meta.model_copy(update={"motion": said})), model


@pytest.mark.parametrize("late_s", [0.0, 0.0015])
def test_a_turn_that_begins_in_the_next_sample_is_late_and_no_step_of_a_bias(tmp_path: Path, late_s: float) -> None:
    recording, model = turned(tmp_path, late_s)
    report = discrepancy([recording], model)
    assert (report.verdict, report.findings) == ("none", []), report.document["text"]


def test_a_level_that_is_far_off_is_one_error_and_no_second_for_its_square(tmp_path: Path) -> None:
    recording, model = turned(tmp_path, 0.0)
    reference = recording.meta.reference.model_dump(exclude_none=True)
    reference |= {"pitch_deg": reference.get("pitch_deg", 0.0) + 0.6, "roll_deg": reference.get("roll_deg", 0.0) - 0.3}
    reference |= {"level_sigma_deg": 0.005}
    meta = RecordingMeta.model_validate({**recording.meta.model_dump(exclude_none=True), "reference": reference})
    report = discrepancy([replace(recording, meta=meta)], model)
    assert [one["effect"] for one in report.findings] == ["level_error"], report.document["text"]
    assert report.document["remaining"]["empirical"] == []
