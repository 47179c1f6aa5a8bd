"""What terms are worth: one simulated block navigated with and without them, at rest and after a turn."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from drivers.recording import Recording, read_recording
from drivers.recording_meta import TurnMeta
from inertial.documents import BlockModel, Result
from service.navigate import navigate_recording
from simulators.scenarios import Scenario, planted_terms
from simulators.simulate import simulate_recording

NAVIGATION_S = 300.0
TURN = TurnMeta(kind="turn", start_s=0.0, end_s=90.0, rate_dps=1.0, axis=[0.0, 0.0, 1.0], frame="body")
"""90° at 1 deg/s about body z, from the start; rest for what remains."""
SEED_STEP = 1_000_003
"""Added to the demo's seed for each recording made beside its run: the same block, other noise."""


def record(scenario: Scenario, model: BlockModel, name: Path) -> Recording:
    """Simulate a recording, with the block's laboratory calibration beside it, and read it back."""
    return read_recording(simulate_recording(scenario, name, model=model))


def trials(scenario: Scenario, model: BlockModel, folder: Path) -> dict[str, Recording]:
    """Record the block of a run again, with other noise: 300 s at rest, and 300 s with a turn at the start."""
    warm = scenario.warmed_up()
    seed = scenario.scenario.seed
    rest = warm.with_motion([], NAVIGATION_S).with_seed(seed + SEED_STEP)
    turn = warm.with_motion([TURN], NAVIGATION_S).with_seed(seed + 2 * SEED_STEP)
    return {"rest": record(rest, model, folder / "rest"), "turn": record(turn, model, folder / "turn")}


def worth(recordings: dict[str, Recording], result: Result) -> dict[str, Any]:
    """Return the radial errors (10) at the end of each recording without and with the terms, and their ratio."""
    errors = {
        name: {
            "without": navigate_recording(recording)["radial_m"][-1],
            "with": navigate_recording(recording, result)["radial_m"][-1],
        }
        for name, recording in recordings.items()
    }
    improvement = {name: error["without"] / error["with"] for name, error in errors.items()}
    return {"radial_error_m": errors, "improvement": improvement}


def planted(scenario: Scenario, model: BlockModel) -> dict[str, list[float]]:
    """Return the terms that would exactly undo the shifts."""
    terms = planted_terms(scenario, model)
    return {"f_mps2": terms.f_mps2.tolist(), "g_radps": terms.g_radps.tolist()}


def distances(scenario: Scenario, model: BlockModel, result: Result) -> list[float]:
    """Return |term − planted| / σ of the six terms; infinite where nothing bounds one."""
    truth = planted(scenario, model)
    found, sigma = result.terms["final"], result.sigma
    pairs = zip(
        [*found.f_mps2, *found.g_radps],
        [*truth["f_mps2"], *truth["g_radps"]],
        [*sigma.f_mps2, *sigma.g_radps],
        strict=True,
    )
    return [math.inf if spread is None else abs(term - true) / spread for term, true, spread in pairs]
