"""Offline strapdown navigation along a recording: what the readings, with or without terms, make of a block's stay."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from drivers.recording import Recording
from inertial.alignment import Alignment, coarse_alignment
from inertial.documents import Calibration, Noise, Result
from inertial.error_model import Terms
from inertial.strapdown import navigate
from service.errors import RefusedInput
from service.physical import Physical
from service.still_spans import described_rest

LEVELLING_S = 30.0
SHORTEST_LEVELLING_S = 1.0
ROWS_PER_S = 10.0
"""The trajectory is handed out at no more than this; it is navigated at the block's own rate."""


def navigate_recording(
    recording: Recording,
    result: Result | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    *,
    calibration: Calibration | None = None,
) -> dict[str, Any]:
    """Navigate from rest at the origin along a span of a recording.

    The block stands, or turns about its own centre, so its true position is the origin and its true velocity zero: what
    is returned is the error, against the tangent frame at the azimuth of the reference.

    Parameters
    ----------
    recording
        Attitude at the start from its ``[reference]``, turned by the motions described before; without a level (or an
        azimuth) there, from the sensors over the first 30 s at rest.
    result
        Its final terms are applied, (8), (9); without it none are.
    start_s, end_s
        Device time to keep to [s].
    calibration
        In place of the recording's own.

    Returns
    -------
    dict
        ``time_s`` (device time), ``position_m``, ``velocity_mps`` (tangent axes) and ``radial_m`` (eq. 10), at no more
        than 10 rows a second, first and last row included.

    Raises
    ------
    RefusedInput, RecordingError, DocumentError
        Nothing lies in the span, or the attitude cannot be found.
    """
    physical = Physical.of(recording, calibration)
    low = physical.start_s if start_s is None else start_s
    high = physical.end_s if end_s is None else end_s
    span = physical.span(low, high)
    terms = Terms.zero() if result is None else _final(result)
    alignment = _attitude(physical, max(low, physical.start_s), high, terms)
    dv, dtheta = span.true(physical.coefficients, terms)
    motion = navigate(dv, dtheta, span.interval_s, alignment.C_tb, physical.site, alignment.azimuth_rad)
    step = max(1, round(1.0 / (ROWS_PER_S * float(np.median(span.interval_s)))))
    rows = np.unique(np.append(np.arange(0, len(motion.time_s), step), len(motion.time_s) - 1))
    return {
        "time_s": (span.start_s + motion.time_s[rows]).tolist(),
        "position_m": motion.position_m[rows].tolist(),
        "velocity_mps": motion.velocity_mps[rows].tolist(),
        "radial_m": motion.radial_m[rows].tolist(),
    }


def _final(result: Result) -> Terms:
    terms = result.terms["final"]
    return Terms(np.array(terms.f_mps2), np.array(terms.g_radps))


def _attitude(physical: Physical, start_s: float, end_s: float, terms: Terms) -> Alignment:
    """Return the attitude at the start, from the reference and, where that is silent, from the sensors at rest."""
    reference = physical.reference_at(start_s)
    rest = described_rest(physical, start_s, end_s)
    length = min(rest[0][1] - start_s, LEVELLING_S) if rest and rest[0][0] == start_s else 0.0
    given = reference.roll_rad is not None and reference.azimuth_rad is not None
    if not given and length < SHORTEST_LEVELLING_S:
        raise RefusedInput(
            f"{physical.recording.meta_path}: [reference]",
            f"the attitude at {start_s:.6g} s is not given and the block does not rest there to find it.",
            "Give azimuth_deg, roll_deg and pitch_deg, or start where the block stands still.",
        )
    # What is given is not averaged, so any stretch of the readings will do.
    window = physical.span(start_s, min(start_s + max(length, SHORTEST_LEVELLING_S), math.nextafter(end_s, math.inf)))
    try:
        return coarse_alignment(window, physical.coefficients, physical.site, reference, Noise(), terms=terms)
    except ValueError as error:
        raise RefusedInput(physical.name, f"{error}.", "Check its calibration, units and site.") from None
