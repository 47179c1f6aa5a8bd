"""Where a block in a recording points, found from its own sensors alone."""

from __future__ import annotations

import math
from typing import Any

from drivers.recording import Recording
from inertial.alignment import (
    ACCEL_BIAS_PRIOR_MPS2,
    GYRO_BIAS_PRIOR_RADPS,
    Reference,
    coarse_alignment,
)
from inertial.attitude import roll_pitch_heading
from inertial.documents import Noise
from inertial.earth import EARTH_RATE_RADPS, STANDARD_GRAVITY_MPS2
from inertial.inertial_alignment import inertial_alignment
from service.block_noise import noise_of_span
from service.errors import RefusedInput
from service.physical import Physical
from service.still_spans import movement, noise_to_judge_by

DEG_H_RADPS = math.radians(1.0) / 3600.0
MG_MPS2 = STANDARD_GRAVITY_MPS2 * 1e-3


def align_recording(
    recording: Recording,
    *,
    alignment: str | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    accel_bias_sigma_mps2: float = ACCEL_BIAS_PRIOR_MPS2,
    gyro_bias_sigma_radps: float = GYRO_BIAS_PRIOR_RADPS,
) -> dict[str, Any]:
    """Level and gyrocompass, whatever attitude the recording's reference gives.

    Parameters
    ----------
    alignment
        ``"rest"``: by averages over the span; ``"inertial"``: in an inertial frame, for a launcher that sways; the
        attitude is then that of the span's end. None: by averages where the span stands still, else in the inertial
        frame.
    start_s, end_s
        Device time to keep to [s]; the whole recording without them.
    accel_bias_sigma_mps2, gyro_bias_sigma_radps
        1σ of what the calibration may have lost: at one attitude it cannot be told from level and azimuth.

    Returns
    -------
    dict
        ``still``, or else how the block ``moved`` in the span; ``azimuth_deg`` of the forward axis with 1σ
        (``azimuth_sigma_deg`` in all, ``azimuth_noise_sigma_deg`` from noise and motion alone), ``roll_deg``,
        ``pitch_deg`` with theirs, and the azimuth that was given, if any.

    Raises
    ------
    RefusedInput, RecordingError, DocumentError
        The span is empty or too short, or its readings are not those of a block on the Earth.
    """
    physical = Physical.of(recording)
    low = physical.start_s if start_s is None else start_s
    high = physical.end_s if end_s is None else end_s
    span = physical.span(low, high)
    moved = movement(physical, noise_to_judge_by(physical, low, high), low, high)
    alignment = alignment or ("rest" if moved is None else "inertial")
    try:
        if alignment == "inertial":
            found = inertial_alignment(
                span,
                physical.coefficients,
                physical.site,
                Reference(),
                Noise(),
                accel_bias_sigma_mps2=0.0,
                gyro_bias_sigma_radps=0.0,
            )
        else:
            noise = noise_of_span(span, physical.name)
            found = coarse_alignment(
                span,
                physical.coefficients,
                physical.site,
                Reference(),
                noise,
                accel_bias_sigma_mps2=0.0,
                gyro_bias_sigma_radps=0.0,
            )
    except RefusedInput:
        raise
    except ValueError as error:
        raise RefusedInput(physical.name, f"{error}.", "Name another span, or give the attitude.") from None
    latitude = physical.site.latitude_rad
    level_sigma = accel_bias_sigma_mps2 / physical.site.gravity_mps2
    bias_sigma = math.hypot(
        gyro_bias_sigma_radps / (EARTH_RATE_RADPS * math.cos(latitude)), level_sigma * math.tan(latitude)
    )
    roll, pitch, _ = roll_pitch_heading(found.C_tb)
    given = physical.reference_at(low)
    believed = None if given.azimuth_rad is None else math.degrees(given.azimuth_rad + given.heading_rad) % 360.0
    return {
        "alignment": alignment,
        "still": moved is None,
        **({"moved": moved} if moved else {}),
        "span_s": [span.start_s, span.start_s + span.duration_s],
        "azimuth_deg": math.degrees(found.azimuth_rad),
        "azimuth_sigma_deg": math.degrees(math.hypot(found.azimuth_sigma_rad, bias_sigma)),
        "azimuth_noise_sigma_deg": math.degrees(found.azimuth_sigma_rad),
        "roll_deg": math.degrees(roll),
        "pitch_deg": math.degrees(pitch),
        "level_sigma_deg": math.degrees(math.hypot(found.level_sigma_rad, level_sigma)),
        "given_azimuth_deg": believed,
        "believed_bias_sigma": {
            "accel_mg": accel_bias_sigma_mps2 / MG_MPS2,
            "gyro_deg_h": gyro_bias_sigma_radps / DEG_H_RADPS,
        },
    }
