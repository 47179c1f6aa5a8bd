"""Facts of a result that stand beside its numbers: where, from which reference, in which conditions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from inertial.alignment import Alignment
from inertial.attitude import roll_pitch_heading
from inertial.documents import WindowRecord
from inertial.verification import Verification
from service.physical import Physical
from service.verdict import SIGNIFICANT_SIGMA, Window


def reference_facts(physical: Physical, noise_source: str, alignment: str) -> dict[str, Any]:
    """Return what was known from outside, and how the rest was found."""
    given = physical.recording.meta.reference.model_dump(exclude_none=True)
    gravity = "normal gravity" if physical.recording.meta.site.gravity_mps2 is None else "surveyed"
    found = {"gravity": gravity, "noise": noise_source, "significant_sigma": SIGNIFICANT_SIGMA}
    return {**given, **found, "alignment": alignment}


def site_facts(physical: Physical) -> dict[str, float]:
    """Return where the block stood."""
    site = physical.site
    return {
        "latitude_deg": math.degrees(site.latitude_rad),
        "height_m": site.height_m,
        "gravity_mps2": site.gravity_mps2,
    }


def alignment_facts(alignment: Alignment) -> dict[str, Any]:
    """Return an attitude and where it is from."""
    roll, pitch, heading = (math.degrees(angle) for angle in roll_pitch_heading(alignment.C_tb))
    return {
        "level_source": alignment.level_source,
        "azimuth_source": alignment.azimuth_source,
        "azimuth_deg": math.degrees(alignment.azimuth_rad),
        "azimuth_sigma_deg": math.degrees(alignment.azimuth_sigma_rad),
        "roll_deg": roll,
        "pitch_deg": pitch,
        "heading_deg": heading,
        "level_sigma_deg": math.degrees(alignment.level_sigma_rad),
        "C_tb": alignment.C_tb.tolist(),
    }


def verification_facts(verification: Verification) -> dict[str, Any]:
    """Return the proof on fresh data."""
    return {
        "passed": verification.passed,
        "chi_square": verification.statistic,
        "limit": verification.limit,
        "degrees_of_freedom": 6,
        "duration_s": verification.duration_s,
        "velocity_mps": verification.velocity_mps.tolist(),
        "attitude_rad": verification.attitude_rad.tolist(),
        "sigma_velocity_mps": verification.sigma[:3].tolist(),
        "sigma_attitude_rad": verification.sigma[3:].tolist(),
    }


def condition_facts(
    physical: Physical, windows: Sequence[WindowRecord], checked: Mapping[str, Window]
) -> dict[str, Any]:
    """Return rate, losses and temperature over the windows."""
    rows = physical.rows(windows[0].start_s, windows[-1].end_s)
    samples = physical.recording.samples[rows]
    facts: dict[str, Any] = {
        "sample_rate_hz": float(1.0 / np.median(physical.interval_s[rows])),
        "samples": len(samples),
        "frames_repaired": sum(window.span.repaired for window in checked.values()),
    }
    temperature = np.asarray(samples["temperature"][:, 0], dtype=np.float64)
    if np.any(np.isfinite(temperature)):
        facts["temperature_mean_c"] = float(np.nanmean(temperature))
        facts["temperature_range_c"] = [float(np.nanmin(temperature)), float(np.nanmax(temperature))]
    return facts


def block_facts(physical: Physical) -> dict[str, Any]:
    """Return what block it was."""
    block = physical.recording.meta.block
    return {"gyro_kind": block.gyro_kind or "", "calibration": physical.calibration}
