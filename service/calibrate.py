"""Laboratory calibration from recordings: on a two-axis turntable, or by hand in many attitudes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from drivers.recording import Recording
from drivers.recording_meta import INCREMENT_COLUMNS, ColumnMeta, RecordingMeta
from inertial.attitude import body_to_tangent
from inertial.calibration import DTG_MOUNTING, CalibrationResult, Mounting, TableRun, calibrate_table
from inertial.documents import ChannelNoise, Noise
from inertial.earth import STANDARD_GRAVITY_MPS2
from inertial.multiposition import calibrate_by_hand
from inertial.table_plan import TablePlan, plan_table_run
from inertial.turntable import TableSetup, TableTurn
from service.errors import RefusedInput
from service.physical import Physical, site_of_meta

Array = NDArray[np.float64]
Way = Literal["turntable", "by hand"]
PLANNED_NOISE = Noise.model_validate(
    {f"accel_{axis}": ChannelNoise(white=20e-6 * STANDARD_GRAVITY_MPS2) for axis in "xyz"}
    | {f"gyro_{axis}": ChannelNoise(white=math.radians(0.01) / 60.0) for axis in "xyz"}
)
"""What a plan assumes of the block: 20 µg/√Hz, 0.01 deg/√h."""


def way_of(recordings: Sequence[Recording]) -> Way:
    """Return how recordings were made: on a table where their ``[[motion]]`` tells turns."""
    turns = [any(motion.kind == "turn" for motion in recording.meta.motion) for recording in recordings]
    if any(turns) and not all(turns):
        odd = recordings[turns.index(False)]
        raise RefusedInput(
            str(odd.meta_path), "it describes no turn, while others do.", "Calibrate table runs and others apart."
        )
    return "turntable" if all(turns) else "by hand"


def calibrate_recordings(
    recordings: Sequence[Recording], way: Way | None = None, mounting: Mounting | None = None
) -> tuple[CalibrationResult, Way]:
    """Estimate the coefficients of (1), (2).

    Parameters
    ----------
    way
        None: as the recordings' ``[[motion]]`` says.
    mounting
        Which accelerometers act on which gyro; None: two DTGs where ``gyro_kind`` says ``dtg``, else none.

    Raises
    ------
    RefusedInput, RecordingError
        They cannot be calibrated from: no usable rests, no site, no reference.
    """
    way = way or way_of(recordings)
    kind = recordings[0].meta.block.gyro_kind
    mounting = (DTG_MOUNTING if kind == "dtg" else {}) if mounting is None else mounting
    place = ", ".join(str(recording.path) for recording in recordings)
    try:
        if way == "turntable":
            return calibrate_table([_table_run(recording) for recording in recordings], mounting), way
        if len(recordings) > 1:
            raise ValueError("one recording holds all attitudes of a calibration by hand; give one at a time")
        return _by_hand(recordings[0], mounting), way
    except RefusedInput:
        raise
    except ValueError as error:
        raise RefusedInput(place, f"{error}.", "See docs/calibration.md for what a recording must hold.") from None


def _table_run(recording: Recording) -> TableRun:
    recording.require("reference.azimuth_deg")
    physical = Physical.of(recording)
    return TableRun(physical.span(physical.start_s, physical.end_s), setup_of(recording.meta))


def setup_of(meta: RecordingMeta) -> TableSetup:
    """Return how the block was mounted and what the table did; what the reference does not give is zero and exact."""
    reference = meta.reference
    angles = (reference.roll_deg or 0.0, reference.pitch_deg or 0.0, reference.heading_deg)
    return TableSetup(
        site=site_of_meta(meta),
        azimuth_rad=math.radians(reference.azimuth_deg or 0.0),
        C_tb=body_to_tangent(*(math.radians(angle) for angle in angles)),
        turns=tuple(
            TableTurn(
                turn.start_s,
                turn.end_s,
                math.radians(turn.rate_dps),
                (turn.axis[0], turn.axis[1], turn.axis[2]),
                turn.frame,
                math.radians(turn.angle_sigma_deg or 0.0),
            )
            for turn in meta.motion
            if turn.kind == "turn"
        ),
        level_sigma_rad=math.radians(reference.level_sigma_deg or 0.0),
        azimuth_sigma_rad=math.radians(reference.azimuth_sigma_deg or 0.0),
        level_frame=reference.level_frame,
    )


def _by_hand(recording: Recording, mounting: Mounting) -> CalibrationResult:
    physical = Physical.of(recording, needs_site=False)
    latitude = recording.meta.site.latitude_deg
    gravity = recording.meta.site.gravity_mps2
    if gravity is None:
        recording.require("site.latitude_deg")
        gravity = physical.site.gravity_mps2
    return calibrate_by_hand(
        physical.span(physical.start_s, physical.end_s),
        gravity,
        latitude_rad=None if latitude is None else math.radians(latitude),
        mounting=mounting,
    )


def plan_for(meta: RecordingMeta, steps: int, rest_s: float, mounting: Mounting | None = None) -> TablePlan:
    """Propose a table run for the site, reference and block that a TOML describes."""
    mounting = (DTG_MOUNTING if meta.block.gyro_kind in (None, "dtg") else {}) if mounting is None else mounting
    try:
        return plan_table_run(setup_of(meta), PLANNED_NOISE, mounting, steps=steps, rest_s=rest_s)
    except ValueError as error:
        raise RefusedInput("plan", f"{error}.", "Correct --steps, --rest or the reference.") from None


def plan_facts(plan: TablePlan) -> dict[str, Any]:
    """Return a plan as plain data: the steps, the turns as ``[[motion]]`` entries, and what they will show."""
    return {
        "duration_s": plan.duration_s,
        "steps": [
            {
                "inner_deg": math.degrees(step.inner_rad),
                "outer_deg": math.degrees(step.outer_rad),
                "kind": step.kind,
                "sense": step.sense,
            }
            for step in plan.steps
        ],
        "motion": [
            {
                "kind": "turn",
                "start_s": turn.start_s,
                "end_s": turn.end_s,
                "rate_dps": math.degrees(turn.rate_radps),
                "axis": list(turn.axis),
                "frame": turn.frame,
                "angle_sigma_deg": math.degrees(turn.angle_sigma_rad),
            }
            for turn in plan.setup.turns
        ],
        "coefficients": [
            {"name": name, "sigma": float(sigma), "conditioning": float(share)}
            for name, sigma, share in zip(plan.order, plan.sigma, plan.conditioning, strict=True)
        ],
        "unobservable": [one.model_dump(mode="json") for one in plan.unobservable],
    }


def calibration_facts(
    result: CalibrationResult, way: Way, recordings: Sequence[Recording], now: datetime | None = None
) -> dict[str, Any]:
    """Return a calibration as plain data: the document, its residuals, and the log's own counts where it has them."""
    at = (now or datetime.now(UTC)).date().isoformat()
    names = ", ".join(recording.path.name for recording in recordings)
    document = result.to_document(date=at, table_run=names, temperature_range_c=_temperatures(recordings))
    return {
        "way": way,
        "calibration": document.model_dump(mode="json", by_alias=True),
        "values": dict(zip(result.order, (float(value) for value in result.values), strict=True)),
        "sigma": dict(zip(result.order, (float(sigma) for sigma in result.sigma), strict=True)),
        "chi_square": result.chi_square,
        "degrees_of_freedom": result.degrees_of_freedom,
        "chi_square_probability": result.chi_square_probability,
        "filter_batch_disagreement_sigma": result.disagreement,
        "residuals": [vars(residual) for residual in result.residuals],
        "unobservable": [one.model_dump(mode="json") for one in result.unobservable],
        "refused": list(result.refused),
        "raw": _in_raw_units(result, recordings[0].meta.columns),
        "inputs": {path: digest for recording in recordings for path, digest in recording.inputs().items()},
    }


def _temperatures(recordings: Sequence[Recording]) -> tuple[float, float] | None:
    values = np.concatenate([recording.samples["temperature"].ravel() for recording in recordings])
    known = values[np.isfinite(values)]
    return (float(known.min()), float(known.max())) if len(known) else None


def _in_raw_units(result: CalibrationResult, columns: Mapping[str, ColumnMeta]) -> dict[str, Any] | None:
    """Return T, K and b of a = T·K·(raw − b) for a log in another maker's counts, both signs alike; else None."""
    by_target = {column.to: column for column in columns.values()}
    if any(name not in by_target for name in INCREMENT_COLUMNS):
        return None
    found = result.coefficients
    kinds = (
        ("accel", found.accel_positive, found.accel_bias_mps2),
        ("gyro", found.gyro_positive, found.gyro_bias_radps),
    )
    raw = {}
    for index, (kind, matrix, bias) in enumerate(kinds):
        used = [by_target[name] for name in INCREMENT_COLUMNS[3 * index : 3 * index + 3]]
        per_count = np.array([column.scale for column in used])
        offset = np.array([column.offset for column in used])
        scale = np.diag(matrix)
        raw[kind] = {
            "model": "a = T·K·(raw − b)",
            "T": (matrix / scale).tolist(),
            "K": (scale * per_count).tolist(),
            "b": (offset - np.linalg.solve(matrix, bias) / per_count).tolist(),
        }
    return raw
