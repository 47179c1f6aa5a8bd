"""One run as it is carried from store to store, identical down to the last byte."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from service.store.tables import Audit, CarriedRun, ResultRow, Run, Transition


@dataclass(frozen=True)
class Carried:
    """All that a store holds of one run, as plain data.

    ``audit`` has the run's entries as the store they were made in chained them: they are evidence, and are kept apart
    from the log of the store that takes them in.
    """

    run: dict[str, Any]
    transitions: list[dict[str, Any]]
    result: str | None
    audit: list[dict[str, Any]]

    def to_json(self) -> str:
        """Return it as text, the same for the same run."""
        return json.dumps(vars(self), indent=1, sort_keys=True, ensure_ascii=False) + "\n"

    @classmethod
    def from_json(cls, text: str | bytes) -> Carried:
        """Return what :meth:`to_json` made.

        Raises
        ------
        ValueError
            It is something else.
        """
        found = json.loads(text)
        try:
            carried = cls(**found)
            known = all(set(row) == _names(Transition) - {"id", "run_id"} for row in carried.transitions)
            whole = known and set(carried.run) == _names(Run)
        except TypeError:
            whole = False
        if not whole:
            raise ValueError("not a run as this inertrim knows one")
        return carried


def read(session: Session, run_id: str) -> Carried | None:
    """Return one run, None where there is none."""
    run = session.get(Run, run_id)
    if run is None:
        return None
    changes = session.scalars(select(Transition).where(Transition.run_id == run_id).order_by(Transition.id))
    result = session.get(ResultRow, run_id)
    brought = session.get(CarriedRun, run_id)
    entries = session.scalars(select(Audit).where(Audit.run_id == run_id).order_by(Audit.id))
    audit = json.loads(brought.audit) if brought is not None else [_columns(row, "id") for row in entries]
    return Carried(
        _columns(run),
        [_columns(row, "id", "run_id") for row in changes],
        result.document if result is not None else None,
        audit,
    )


def write(session: Session, carried: Carried, result_sha256: str | None, origin: Mapping[str, str]) -> None:
    """Add one run; ``origin`` has ``utc``, ``signer`` and ``manifest_sha256``."""
    run_id = carried.run["id"]
    session.add(Run(**carried.run))
    session.flush()
    for row in carried.transitions:
        session.add(Transition(**row, run_id=run_id))
        session.flush()  # in this order
    if carried.result is not None:
        session.add(ResultRow(run_id=run_id, sha256=result_sha256, document=carried.result))
    session.add(CarriedRun(run_id=run_id, audit=json.dumps(carried.audit, ensure_ascii=False), **origin))


def _names(table: type[Run] | type[Transition]) -> set[str]:
    return {column.name for column in table.__table__.columns}


def _columns(row: Any, *without: str) -> dict[str, Any]:
    return {column.name: getattr(row, column.name) for column in row.__table__.columns if column.name not in without}
