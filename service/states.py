"""The states of the sequencer and what may follow what; nothing here knows time, samples or the block."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from typing import Any

from statemachine import State, StateMachine


class Name(StrEnum):
    """Names of the states as operators and consoles read them (docs/states.md)."""

    OFFLINE = "OFFLINE"
    POWER_UP = "POWER_UP"
    SELF_TEST = "SELF_TEST"
    SETTLING = "SETTLING"
    ALIGNING = "ALIGNING"
    STAGE_1 = "STAGE_1"
    STAGE_2 = "STAGE_2"
    STAGE_3 = "STAGE_3"
    VERIFYING = "VERIFYING"
    READY = "READY"
    HOLD = "HOLD"
    FAULT = "FAULT"
    ABORTED = "ABORTED"


PATH = tuple(Name)[1:10]
"""The way of a run, POWER_UP to READY."""

RESUMABLE = PATH[1:8]
"""Steps that HOLD can interrupt and that begin again by themselves."""

WINDOWS = {
    Name.ALIGNING: "align",
    Name.STAGE_1: "stage_1",
    Name.STAGE_2: "stage_2",
    Name.STAGE_3: "stage_3",
    Name.VERIFYING: "verify",
}
"""Steps that use a window of data, and the window's name in the recording."""

OPERATOR_COMMANDS = ("start", "abort", "acknowledge")


def _held(step: Name) -> Callable[..., bool]:
    """Return the guard that lets HOLD go back to ``step`` alone."""

    def is_held(held: str | None = None) -> bool:
        return held == step

    return is_held


def _is_over(held: str | None = None) -> bool:
    """HOLD after READY: nothing begins again by itself, a new run may start."""
    return held == Name.READY


class TrimStates(StateMachine):
    """The state chart. Every event carries ``held`` (what HOLD interrupted), ``reason`` and ``detail``."""

    OFFLINE = State(initial=True)
    POWER_UP = State()
    SELF_TEST = State()
    SETTLING = State()
    ALIGNING = State()
    STAGE_1 = State()
    STAGE_2 = State()
    STAGE_3 = State()
    VERIFYING = State()
    READY = State()
    HOLD = State()
    FAULT = State()
    ABORTED = State()

    start = OFFLINE.to(POWER_UP) | READY.to(POWER_UP) | ABORTED.to(POWER_UP) | HOLD.to(POWER_UP, cond=_is_over)
    advance = (
        POWER_UP.to(SELF_TEST)
        | SELF_TEST.to(SETTLING)
        | SETTLING.to(ALIGNING)
        | ALIGNING.to(STAGE_1)
        | STAGE_1.to(STAGE_2)
        | STAGE_2.to(STAGE_3)
        | STAGE_3.to(VERIFYING)
        | VERIFYING.to(READY)
    )
    hold = (
        SELF_TEST.to(HOLD)
        | SETTLING.to(HOLD)
        | ALIGNING.to(HOLD)
        | STAGE_1.to(HOLD)
        | STAGE_2.to(HOLD)
        | STAGE_3.to(HOLD)
        | VERIFYING.to(HOLD)
        | READY.to(HOLD)
    )
    resume = (
        HOLD.to(SELF_TEST, cond=_held(Name.SELF_TEST))
        | HOLD.to(SETTLING, cond=_held(Name.SETTLING))
        | HOLD.to(ALIGNING, cond=_held(Name.ALIGNING))
        | HOLD.to(STAGE_1, cond=_held(Name.STAGE_1))
        | HOLD.to(STAGE_2, cond=_held(Name.STAGE_2))
        | HOLD.to(STAGE_3, cond=_held(Name.STAGE_3))
        | HOLD.to(VERIFYING, cond=_held(Name.VERIFYING))
    )
    restart = (
        SELF_TEST.to(POWER_UP)
        | SETTLING.to(POWER_UP)
        | ALIGNING.to(POWER_UP)
        | STAGE_1.to(POWER_UP)
        | STAGE_2.to(POWER_UP)
        | STAGE_3.to(POWER_UP)
        | VERIFYING.to(POWER_UP)
        | HOLD.to(POWER_UP, unless=_is_over)
    )
    fault = (
        POWER_UP.to(FAULT)
        | SELF_TEST.to(FAULT)
        | SETTLING.to(FAULT)
        | ALIGNING.to(FAULT)
        | STAGE_1.to(FAULT)
        | STAGE_2.to(FAULT)
        | STAGE_3.to(FAULT)
        | VERIFYING.to(FAULT)
        | HOLD.to(FAULT, unless=_is_over)
    )
    abort = (
        POWER_UP.to(ABORTED)
        | SELF_TEST.to(ABORTED)
        | SETTLING.to(ABORTED)
        | ALIGNING.to(ABORTED)
        | STAGE_1.to(ABORTED)
        | STAGE_2.to(ABORTED)
        | STAGE_3.to(ABORTED)
        | VERIFYING.to(ABORTED)
        | READY.to(ABORTED)
        | HOLD.to(ABORTED)
    )
    acknowledge = FAULT.to(OFFLINE)

    def __init__(self, on_change: Callable[[Name, Name, str, str], None], at: Name = Name.OFFLINE) -> None:
        self._on_change = on_change
        self._enabled: dict[tuple[str, str | None], frozenset[str]] = {}
        super().__init__(start_value=at.value)

    @property
    def name_now(self) -> Name:
        """The state the machine is in."""
        return Name(str(self.current_state_value))

    def may(self, event: str, held: str | None) -> bool:
        """Whether ``event`` leads anywhere from here; worked out once for each state and what it holds."""
        here = (str(self.current_state_value), held)
        if here not in self._enabled:
            self._enabled[here] = frozenset(str(enabled) for enabled in self.enabled_events(held=held))
        return event in self._enabled[here]

    def after_transition(self, source: Any, target: Any, reason: str = "", detail: str = "") -> None:
        """Tell the owner of every change of state."""
        self._on_change(Name(source.id), Name(target.id), reason, detail)
