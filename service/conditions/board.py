"""Keeps the conditions from one look to the next: since when, for how long, and who has taken note of what."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from service.conditions.catalogue import CATALOGUE, Definition, Measure
from service.conditions.facts import Facts

State = Literal["ok", "pending", "failed", "acknowledged", "unknown"]
_WANTED: dict[bool | None, State] = {None: "unknown", True: "ok", False: "failed"}


class UnknownCondition(Exception):
    """There is no condition of that name."""


class CannotAcknowledge(Exception):
    """The condition is not broken, so that there is nothing to take note of."""


@dataclass(frozen=True)
class Acknowledgement:
    """Who took note of a broken condition, and why; it ends when the condition is whole again."""

    by: str
    reason: str
    utc: str


@dataclass(frozen=True)
class Standing:
    """One condition as it stands, since when, and since when [simulated s] its measure says the same."""

    state: State
    since_utc: str
    measure: Measure
    same_since_s: float
    acknowledgement: Acknowledgement | None = None


class Board:
    """All conditions; it is fed facts and asked for its judgement.

    Parameters
    ----------
    utc
        Wall clock of the records.
    catalogue
        The conditions.
    """

    def __init__(self, utc: Callable[[], str], catalogue: Sequence[Definition] = CATALOGUE) -> None:
        self._utc = utc
        self._definitions = {one.name: one for one in catalogue}
        self._standing: dict[str, Standing] = {}

    def update(self, facts: Facts, now_s: float) -> list[str]:
        """Take a look at simulated time ``now_s``; return the names of the conditions whose state changed."""
        changed = []
        for name, definition in self._definitions.items():
            before = self._standing.get(name)
            after = self._next(definition, before, definition.measure(facts), now_s)
            self._standing[name] = after
            if before is not None and before.state != after.state:
                changed.append(name)
        return changed

    def acknowledge(self, name: str, by: str, reason: str) -> None:
        """Take note of a broken condition.

        Raises
        ------
        UnknownCondition, CannotAcknowledge
        """
        if name not in self._definitions:
            raise UnknownCondition(name)
        standing = self._standing.get(name)
        if standing is None or standing.state not in ("failed", "acknowledged"):
            raise CannotAcknowledge(f"{name} is {'unknown' if standing is None else standing.state}, not failed")
        state: State = "failed" if self._definitions[name].severity == "critical" else "acknowledged"
        utc = self._utc()
        self._standing[name] = replace(
            standing,
            state=state,
            since_utc=standing.since_utc if state == standing.state else utc,
            acknowledgement=Acknowledgement(by, reason, utc),
        )

    def against(self) -> list[str]:
        """Return what speaks against going, in words; nothing when all is well or taken note of."""
        return [self._words(name) for name, one in self._standing.items() if one.state == "failed"]

    def noted(self) -> list[str]:
        """Return what is broken and was taken on by somebody, in words."""
        return [
            f"{self._words(name)}; acknowledged by {one.acknowledgement.by}: {one.acknowledgement.reason}"
            for name, one in self._standing.items()
            if one.state == "acknowledged" and one.acknowledgement is not None
        ]

    def listing(self) -> list[dict[str, Any]]:
        """Return every condition as plain data (``GET /api/v1/conditions``)."""
        return [self.entry(name) for name in self._standing]

    def entry(self, name: str) -> dict[str, Any]:
        """Return one condition as plain data."""
        definition, standing = self._definitions[name], self._standing[name]
        note = standing.acknowledgement
        return {
            "name": definition.name,
            "title": definition.title,
            "severity": definition.severity,
            "state": standing.state,
            "since": standing.since_utc,
            "persistence_s": definition.persistence_s,
            "measured": standing.measure.measured,
            "limit": standing.measure.limit,
            "unit": standing.measure.unit,
            "text": standing.measure.text,
            "cause": definition.cause,
            "remedy": definition.remedy,
            "acknowledgement": None if note is None else asdict(note),
        }

    def _next(self, definition: Definition, before: Standing | None, measure: Measure, now_s: float) -> Standing:
        """Return how a condition stands after a look: its state follows the measure once that has lasted."""
        wanted = _WANTED[measure.holds]
        if before is None:
            return Standing(wanted if definition.persistence_s == 0 else "unknown", self._utc(), measure, now_s)
        since_s = before.same_since_s if measure.holds is before.measure.holds else now_s
        kept = replace(before, measure=measure, same_since_s=since_s)
        if before.state == wanted or (wanted == "failed" and before.state == "acknowledged"):
            return kept
        recovers = before.state == "pending" and wanted == "ok"
        if wanted == "unknown" or recovers or now_s - since_s >= definition.persistence_s:
            return Standing(wanted, self._utc(), measure, since_s)
        if wanted == "failed" and before.state == "ok":
            return Standing("pending", self._utc(), measure, since_s)
        return kept

    def _words(self, name: str) -> str:
        return f"{name}: {self._standing[name].measure.text}"
