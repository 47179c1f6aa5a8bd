"""Which part of a recording aligns, which estimates, which verifies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

from inertial.documents import WindowRecord
from service.errors import RefusedInput

Kind = Literal["align", "stage_1", "stage_2", "stage_3", "verify"]
KINDS: tuple[Kind, ...] = get_args(Kind)
STAGES: tuple[Kind, ...] = ("stage_1", "stage_2", "stage_3")
NOMINAL_S: dict[Kind, float] = {"align": 30.0, "stage_1": 60.0, "stage_2": 60.0, "stage_3": 60.0, "verify": 60.0}
SHORTEST_S = 90.0
"""Below a third of the nominal 270 s (10 s to align, 20 s a stage) noise alone exceeds what a run is for."""

Span = tuple[float, float]


def automatic_windows(spans: Sequence[Span], place: str) -> list[WindowRecord]:
    """Return the five windows one after the other in the first span that is long enough for all of them.

    Where no span holds the nominal 270 s, the longest one is shared in the same proportions, on whole seconds, so
    that a stage's ten nodes stay equal.

    Raises
    ------
    RefusedInput
        No span holds even a third of the nominal times.
    """
    nominal = sum(NOMINAL_S.values())
    if not spans:
        raise RefusedInput(place, "no part of it is at rest by its [[motion]].", "Record the block standing still.")
    span = next((span for span in spans if span[1] - span[0] >= nominal), max(spans, key=_length))
    if _length(span) < SHORTEST_S:
        raise RefusedInput(
            place,
            f"the longest still span lasts {_length(span):.1f} s; compensation takes {nominal:.0f} s, not less "
            f"than {SHORTEST_S:.0f} s.",
            "Record the block standing still for longer, or name another span by --start and --end.",
        )
    share = min(1.0, _length(span) / nominal)
    windows, start = [], span[0]
    for kind in KINDS:
        length = NOMINAL_S[kind] if share == 1.0 else float(int(NOMINAL_S[kind] * share))
        windows.append(WindowRecord(kind=kind, start_s=start, end_s=start + length))
        start += length
    return windows


def _length(span: Span) -> float:
    return span[1] - span[0]


def recorded_windows(windows: Sequence[WindowRecord], place: str) -> list[WindowRecord]:
    """Return a recording's own windows; the recording's reader has checked their order and that they hold data.

    Raises
    ------
    RefusedInput
        A kind is missing, as where a run was cut short.
    """
    missing = [kind for kind in KINDS if kind not in [window.kind for window in windows]]
    if missing:
        raise RefusedInput(
            place,
            f"its [[window]] entries lack {', '.join(missing)}; the run that used them was not finished.",
            "Add them, or take all out (or give --start and --end) to have windows chosen.",
        )
    return list(windows)
