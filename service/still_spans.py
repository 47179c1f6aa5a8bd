"""Where a recording stands still, by what its description says and by what its data show."""

from __future__ import annotations

import math

from inertial.documents import Noise
from inertial.standstill import first_disturbance, learn_noise
from inertial.standstill import still_spans as still_in_data
from service.errors import RefusedInput
from service.physical import Physical

Span = tuple[float, float]


def described_rest(physical: Physical, start_s: float, end_s: float) -> list[Span]:
    """Return the parts of a span that no described motion covers, in time order."""
    spans, begin = [], start_s
    for motion in physical.recording.meta.motion:
        if motion.kind == "rest":
            continue
        if motion.start_s > begin:
            spans.append((begin, min(motion.start_s, end_s)))
        begin = max(begin, motion.end_s)
    spans.append((begin, end_s))
    return [span for span in spans if span[1] > span[0]]


def still_spans(physical: Physical, start_s: float = -math.inf, end_s: float = math.inf) -> list[Span]:
    """Return the spans of device time [s] in which the block is said to rest and did stand still, in time order."""
    low, high = max(start_s, physical.start_s), min(end_s, physical.end_s)
    if not low < high:
        raise RefusedInput(
            physical.name,
            f"its data, {physical.start_s:g} to {physical.end_s:g} s, hold nothing of the span asked for.",
            "Name a span within the data.",
        )
    noise = noise_to_judge_by(physical, low, high)
    found: list[Span] = []
    for begin, end in described_rest(physical, low, high):
        rows = physical.rows(begin, end)
        if rows.stop - rows.start < 2:
            continue
        span = physical.span(begin, end)
        time_s = span.start_s + span.interval_s.cumsum()
        still = still_in_data(time_s, span.dv_mps, span.dtheta_rad, span.interval_s, noise)
        found += [(max(first, begin), min(last, end)) for first, last in still]
    return found


def movement(physical: Physical, noise: Noise, start_s: float, end_s: float) -> str | None:
    """Return how the block moved within a span, None where it stood still."""
    moved = first_disturbance(physical.span(start_s, end_s), noise)
    return None if moved is None else str(moved)


def noise_to_judge_by(physical: Physical, start_s: float, end_s: float) -> Noise:
    """Return the block's own noise as its quietest quarter of a span shows it."""
    span = physical.span(start_s, end_s)
    try:
        return learn_noise(span.dv_mps, span.dtheta_rad, span.interval_s)
    except ValueError as error:
        raise RefusedInput(physical.name, f"{error}.", "Record the block standing still for longer.") from None
