"""The noise of a block in a recording at rest: Allan deviation and identified terms of all six sensors."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from drivers.recording import Recording
from inertial.allan import overlapping_allan
from inertial.documents import CHANNELS
from inertial.earth import STANDARD_GRAVITY_MPS2
from inertial.increments import Increments
from inertial.noise import NoiseTerm, identify_noise
from service.errors import RefusedInput
from service.physical import Physical
from service.still_spans import described_rest

TERMS = ("quantisation", "white", "flicker", "random_walk", "ramp")
DEG_H = math.pi / 180.0 / 3600.0
FACES = {
    "accel": {
        "quantisation": ("ug·s", 1e-6 * STANDARD_GRAVITY_MPS2),
        "white": ("ug/sqrt(Hz)", 1e-6 * STANDARD_GRAVITY_MPS2),
        "flicker": ("ug", 1e-6 * STANDARD_GRAVITY_MPS2),
        "random_walk": ("ug/sqrt(s)", 1e-6 * STANDARD_GRAVITY_MPS2),
        "ramp": ("ug/h", 1e-6 * STANDARD_GRAVITY_MPS2 / 3600.0),
    },
    "gyro": {
        "quantisation": ("arcsec", DEG_H),
        "white": ("deg/sqrt(h)", 60.0 * DEG_H),
        "flicker": ("deg/h", DEG_H),
        "random_walk": ("deg/h/sqrt(h)", DEG_H / 60.0),
        "ramp": ("deg/h/h", DEG_H / 3600.0),
    },
}
"""Units that people read, and what one of them is in SI."""


def noise_of_recording(
    recording: Recording, start_s: float | None = None, end_s: float | None = None
) -> dict[str, Any]:
    """Identify the noise of all six sensors over the longest rest that a recording describes.

    Parameters
    ----------
    start_s, end_s
        Device time to keep to [s].

    Returns
    -------
    dict
        ``span_s``, ``interval_s`` and by channel ``terms`` (SI value, 1σ, 95 % interval, whether the record shows it,
        and value and 1σ in the unit people read), ``misfit`` of the spectrum and the ``allan`` curve.

    Raises
    ------
    RefusedInput
        No rest in the span, or one too short to tell.
    """
    physical = Physical.of(recording, needs_site=False)
    low = physical.start_s if start_s is None else start_s
    high = physical.end_s if end_s is None else end_s
    rests = described_rest(physical, low, high)
    if not rests:
        raise RefusedInput(physical.name, "it is at rest nowhere in the span.", "Name another span.")
    span = physical.span(*max(rests, key=lambda rest: rest[1] - rest[0]))
    interval_s = float(np.median(span.interval_s))
    try:
        channels = {name: _channel(span, index, interval_s) for index, name in enumerate(CHANNELS)}
    except ValueError as error:
        raise RefusedInput(physical.name, f"{error}.", "Record the block at rest for longer.") from None
    return {
        "span_s": [span.start_s, span.start_s + span.duration_s],
        "interval_s": interval_s,
        "samples": len(span),
        "repaired": span.repaired,
        "channels": channels,
    }


def _channel(span: Increments, index: int, interval_s: float) -> dict[str, Any]:
    readings = np.ascontiguousarray(span.readings()[index // 3][:, index % 3])
    fit, curve = identify_noise(readings, interval_s), overlapping_allan(readings, interval_s)
    low, high = curve.interval()
    faces = FACES[CHANNELS[index].partition("_")[0]]
    return {
        "terms": {name: _term(getattr(fit, name), *faces[name]) for name in TERMS},
        "misfit": fit.misfit,
        "allan": {
            "averaging_s": curve.averaging_s.tolist(),
            "deviation": curve.deviation.tolist(),
            "low95": low.tolist(),
            "high95": high.tolist(),
            "fitted": fit.allan_deviation(curve.averaging_s).tolist(),
        },
    }


def _term(term: NoiseTerm, unit: str, size: float) -> dict[str, Any]:
    return {
        "seen": term.seen,
        "value": term.value,
        "sigma": _finite(term.sigma),
        "interval95": [_finite(end) for end in term.interval95],
        "unit": unit,
        "value_in_unit": term.value / size,
        "sigma_in_unit": _finite(term.sigma / size),
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
