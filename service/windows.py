"""Which part of a recording aligns, which estimates, which verifies."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Literal, get_args

from inertial.documents import WindowRecord
from service.errors import RefusedInput

Kind = Literal["align", "stage_1", "stage_2", "stage_3", "verify"]
KINDS: tuple[Kind, ...] = get_args(Kind)
STAGES: tuple[Kind, ...] = ("stage_1", "stage_2", "stage_3")
NOMINAL_S: dict[Kind, float] = {"align": 30.0, "stage_1": 60.0, "stage_2": 60.0, "stage_3": 60.0, "verify": 60.0}
INERTIAL_ALIGN_S = 60.0
"""To align while the launcher sways: half the time leaves a third of a degree of azimuth on a real vehicle."""
SHORTEST_S = 90.0
"""Below a third of the nominal 270 s (10 s to align, 20 s a stage) noise alone exceeds what a run is for."""

Span = tuple[float, float]


def automatic_windows(
    spans: Sequence[Span], place: str, nominal_s: Mapping[Kind, float] = NOMINAL_S
) -> list[WindowRecord]:
    """Return the five windows one after the other in the first span that is long enough for all of them.

    Where no span holds the nominal 270 s, the longest one is shared in the same proportions, on whole seconds, so
    that a stage's ten nodes stay equal.

    Raises
    ------
    RefusedInput
        No span holds even a third of the nominal times.
    """
    nominal = sum(nominal_s.values())
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
    return _laid(KINDS, span[0], nominal_s, min(1.0, _length(span) / nominal))


def attitude_windows(
    still: Sequence[Span], turns: Sequence[Span], nominal_s: Mapping[Kind, float] = NOMINAL_S
) -> list[WindowRecord] | None:
    """Return the five windows shared out on two rests with turns of known angle between them, at their nominal times.

    The first two neighbouring rests that hold them; as many stages before the turns as fit. None: there are no such.
    """
    for first, second in itertools.pairwise(still):
        between = [turn for turn in turns if first[1] <= turn[0] and turn[1] <= second[0]]
        for split in (3, 2) if between else ():
            groups = ((KINDS[:split], first), (KINDS[split:], second))
            if all(sum(nominal_s[kind] for kind in kinds) <= _length(span) for kinds, span in groups):
                return [window for kinds, span in groups for window in _laid(kinds, span[0], nominal_s)]
    return None


def _laid(
    kinds: Sequence[Kind], start_s: float, nominal_s: Mapping[Kind, float], share: float = 1.0
) -> list[WindowRecord]:
    """Return windows one after the other; where their times are cut, on whole seconds."""
    windows = []
    for kind in kinds:
        length = nominal_s[kind] if share == 1.0 else float(int(nominal_s[kind] * share))
        windows.append(WindowRecord(kind=kind, start_s=start_s, end_s=start_s + length))
        start_s += length
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
