"""A reference that gives no azimuth: the gyros find north, and its absence is no name."""

from __future__ import annotations

import math
from dataclasses import replace

import closed_form
import numpy as np
import pytest
from closed_form import EARTH_RADPS, LATITUDE_DEG, RATE_HZ, WHITE, Truth, model, recording

from drivers.recording import Recording, RecordingMeta
from simulators.discrepancy.compare import compare
from simulators.discrepancy.report import discrepancy

QUIET = 0.03  # times the noise of the small world, so that 4 minutes find north to some minutes of arc


def without_azimuth(case: Recording) -> Recording:
    meta = case.meta.model_dump(exclude_none=True)
    meta["reference"].pop("azimuth_deg")
    return replace(case, meta=RecordingMeta.model_validate(meta))


def quieter(_: Truth, readings: np.ndarray) -> None:
    """Take off all but a share of the noise that the recording will add."""
    noise = np.random.default_rng(23).standard_normal(readings.shape)
    readings[:, 3:] -= (1.0 - QUIET) * noise[:, 3:] * WHITE["gyro"] * math.sqrt(RATE_HZ)


@pytest.mark.parametrize("moving", [True, False])
@pytest.mark.parametrize("azimuth_deg", [-100.0, 40.0, 135.0, 180.0])
def test_north_is_found_by_the_gyros_and_nothing_is_named_for_its_absence(
    azimuth_deg: float, moving: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(closed_form, "AZIMUTH_DEG", azimuth_deg)
    case = without_azimuth(recording(quieter, 23, moving=moving))
    believed = model(factor=QUIET)
    noise = believed.noise.model_copy(
        update={f"accel_{axis}": getattr(model().noise, f"accel_{axis}") for axis in "xyz"}
    )
    believed = believed.model_copy(update={"noise": noise})
    found_deg = math.degrees(compare(case, believed).setup.azimuth_rad)
    level_radps = EARTH_RADPS * math.cos(math.radians(LATITUDE_DEG))
    sigma_deg = math.degrees(QUIET * WHITE["gyro"] / math.sqrt(closed_form.DURATION_S) / level_radps)
    off_deg = (found_deg - azimuth_deg + 180.0) % 360.0 - 180.0
    assert abs(off_deg) < 3.3 * sigma_deg
    report = discrepancy([case], believed)
    assert (report.verdict, report.findings) == ("none", []), report.document["text"]


def test_a_bias_larger_than_earths_rate_is_told_from_north_once_the_block_has_turned() -> None:
    """A hundred degrees an hour on one gyro: at rest it would pass for a north elsewhere."""
    shift = math.radians(100.0) / 3600.0

    def shifted(true: Truth, readings: np.ndarray) -> None:
        quieter(true, readings)
        readings[:, 3] += shift

    (found,) = discrepancy([without_azimuth(recording(shifted, 23))], model()).findings
    assert (found["effect"], found["channel"]) == ("bias_shift", "gyro_x")
    value = found["parameters"]["shift"]
    assert abs(value["value"] - shift) < 3.3 * value["sigma"]
