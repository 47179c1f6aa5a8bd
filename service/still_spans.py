"""Where a recording stands still, by what its description says and by what its data show."""

from __future__ import annotations

import math

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
    low, high = max(start_s, physical.start_s), min(end_s, physical.end_s)
    return described_rest(physical, low, high)


def movement(physical: Physical, start_s: float, end_s: float) -> str | None:
    return None
