"""Data that agree with the model to the rounding of numbers: there is nothing to find in what that leaves."""

from __future__ import annotations

import closed_form
import numpy as np
import pytest
from closed_form import model, recording

from simulators.discrepancy.report import discrepancy

STEP_MPS2 = 2e-6


@pytest.fixture
def noiseless(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make recordings without noise."""
    for kind in ("accel", "gyro"):
        monkeypatch.setitem(closed_form.WHITE, kind, 0.0)


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("stated", [closed_form.WHITE.copy(), {"accel": 0.0, "gyro": 0.0}])
@pytest.mark.usefixtures("noiseless")
def test_rounding_of_numbers_is_nothing(
    stated: dict[str, float], moving: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = recording(None, 1, moving=moving)
    monkeypatch.setattr(closed_form, "WHITE", stated)
    report = discrepancy([case], model())
    assert (report.verdict, report.findings) == ("none", []), report.document["text"]


@pytest.mark.usefixtures("noiseless")
def test_what_noise_would_hide_shows_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A step a tenth of what noise as stated leaves unknown of it."""

    def shifted(true: dict[str, np.ndarray], readings: np.ndarray) -> None:
        readings[true["t"] > 100.0, 0] += STEP_MPS2

    case = recording(shifted, 1, moving=False)
    monkeypatch.undo()
    (found,) = discrepancy([case], model()).findings
    assert (found["effect"], found["channel"]) == ("bias_step", "accel_x")
