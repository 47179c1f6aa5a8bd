"""The store: every write is one durable transaction, so that a killed process loses nothing it has confirmed."""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from alembic.util.exc import CommandError
from sqlalchemy import func, select, update
from sqlalchemy.exc import DatabaseError
from sqlalchemy.orm import Session, sessionmaker

from service.store import carried, revisions
from service.store.audit_chain import GENESIS, Head, Verification, link, verify
from service.store.audit_witness import Witness
from service.store.carried import Carried
from service.store.errors import StoreError
from service.store.postgres import PostgresDatabase
from service.store.sqlite import SqliteFile
from service.store.tables import Audit, AuditHead, CarriedRun, IdempotencyKey, ResultRow, Run, Token, Transition

LAUNCHER = "launcher"
OVER = ("FAULT", "ABORTED")
_CARRIED = select(CarriedRun.run_id)


@dataclass(frozen=True)
class TransitionRecord:
    """One change of state as the sequencer tells it."""

    source: str
    target: str
    reason: str
    detail: str
    simulated_s: float
    utc: str
    run_id: str | None


@dataclass(frozen=True)
class RunRecord:
    """One run as the console reads it."""

    id: str
    launcher: str
    started_utc: str
    ended_utc: str | None
    method: str
    operator: str | None
    state: str
    reason: str
    verdict: str | None
    software: str
    request: dict[str, Any]
    block: dict[str, Any]
    transitions: list[dict[str, Any]] = field(default_factory=list)


@dataclass(frozen=True)
class TokenRecord:
    """One bearer token: who it is for, what it may, the argon2 hash of its secret, and when it ends."""

    id: str
    name: str
    role: str
    secret_hash: str
    created_utc: str
    expires_utc: str | None = None
    revoked_utc: str | None = None


def utc_now() -> str:
    """Return the wall-clock time as RFC 3339 text with microseconds."""
    return datetime.now(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


class Store:
    """Runs, transitions, results, audit and idempotency keys in one database.

    Opening makes the tables where there are none and brings older ones up to date. Safe to call from any thread.

    Parameters
    ----------
    database
        Path of an SQLite file, or URL of a PostgreSQL database that many launchers share.
    launcher
        Name under which this one writes; what others wrote is read and never changed.
    alone
        Refuse a file, or a name in a shared database, that another service has in use.

    Raises
    ------
    StoreError
        The database is not a store, is damaged, was written by a newer program, is in use, or does not answer.
    """

    def __init__(self, database: Path | str, launcher: str = LAUNCHER, *, alone: bool = False) -> None:
        self.launcher = launcher
        place = PostgresDatabase(database) if isinstance(database, str) else SqliteFile(database)
        self._witness = Witness(database.with_name(f"{database.name}.audit") if isinstance(database, Path) else None)
        self._held = place.hold(launcher) if alone else None
        self._engine = place.engine()
        self._sessions: sessionmaker[Session] = sessionmaker(self._engine, expire_on_commit=False)
        try:
            with place.migrating(self._engine) as connection:
                revisions.upgrade(connection)
        except CommandError:
            self.close()
            remedy = "Update the program, or set another store."
            raise StoreError(f"{place.name}: written by a newer inertrim. {remedy}") from None
        except DatabaseError as error:
            self.close()
            raise place.unusable(error) from None

    def close(self) -> None:
        """Close all connections and let go of what was held."""
        self._engine.dispose()
        if self._held is not None:
            self._held.close()

    def check(self) -> None:
        """Raise a database error when the store cannot be read."""
        with self._sessions() as session:
            session.execute(select(func.count(Run.id)))

    # -- runs

    def create_run(
        self, request: dict[str, Any], method: str, operator: str | None, key: str | None = None
    ) -> tuple[RunRecord, bool]:
        """Record a new run, or return the one that ``key`` made before, and whether it is new.

        Raises
        ------
        KeyError
            The key was used with another request.
        """
        digest = hashlib.sha256(json.dumps(request, sort_keys=True).encode()).hexdigest()
        with self._sessions.begin() as session:
            known = session.get(IdempotencyKey, (self.launcher, key)) if key is not None else None
            if known is not None:
                if known.request_sha256 != digest:
                    raise KeyError(key)
                return _record(session.get_one(Run, known.run_id)), False
            now = utc_now()
            run = Run(
                id=_new_run_id(now),
                launcher=self.launcher,
                started_utc=now,
                method=method,
                operator=operator,
                request=request,
                software=version("inertrim"),
                state="POWER_UP",
                reason="start",
                block={},
            )
            session.add(run)
            session.flush()
            if key is not None:
                session.add(
                    IdempotencyKey(launcher=self.launcher, key=key, utc=now, request_sha256=digest, run_id=run.id)
                )
            return _record(run), True

    def run_of_key(self, key: str) -> str | None:
        """Return the run that an idempotency key made."""
        with self._sessions() as session:
            known = session.get(IdempotencyKey, (self.launcher, key))
            return known.run_id if known is not None else None

    def run(self, run_id: str) -> RunRecord | None:
        """Return one run with its transitions, or None."""
        with self._sessions() as session:
            run = session.get(Run, run_id)
            if run is None:
                return None
            rows = session.scalars(select(Transition).where(Transition.run_id == run_id).order_by(Transition.id))
            return _record(run, [_transition(row) for row in rows])

    def runs(self, limit: int, before: str | None = None) -> list[RunRecord]:
        """Return up to ``limit`` runs, newest first, older than run ``before``."""
        query = select(Run).order_by(Run.id.desc()).limit(limit)
        if before is not None:
            query = query.where(Run.id < before)
        with self._sessions() as session:
            return [_record(run) for run in session.scalars(query)]

    def end_run(self, run_id: str) -> None:
        """Close a run that the next one takes over from; its state stays as it was."""
        with self._sessions.begin() as session:
            session.execute(update(Run).where(Run.id == run_id, Run.ended_utc.is_(None)).values(ended_utc=utc_now()))

    def note_block(self, run_id: str, facts: dict[str, Any]) -> None:
        """Add what the block told of itself (identity, terms it held before) to the run."""
        with self._sessions.begin() as session:
            run = session.get_one(Run, run_id)
            run.block = {**run.block, **facts}

    # -- transitions

    def add_transitions(self, records: Sequence[TransitionRecord]) -> None:
        """Record changes of state in one transaction and keep each run's own state with them."""
        with self._sessions.begin() as session:
            for record in records:
                _add_transition(session, self.launcher, record)

    def last_transition(self) -> dict[str, Any] | None:
        """Return this launcher's newest change of state, or None."""
        mine = select(Transition).where(Transition.launcher == self.launcher)
        mine = mine.where(Transition.run_id.is_(None) | Transition.run_id.not_in(_CARRIED))
        with self._sessions() as session:
            row = session.scalars(mine.order_by(Transition.id.desc()).limit(1)).first()
            return _transition(row) if row is not None else None

    def abort_interrupted(self) -> list[str]:
        """Mark every run that this launcher's last process left open as ABORTED (``service_stopped``).

        Returns
        -------
        Their ids.
        """
        left = select(Run).where(Run.ended_utc.is_(None), Run.launcher == self.launcher, Run.id.not_in(_CARRIED))
        left = left.order_by(Run.id)
        with self._sessions.begin() as session:
            open_runs = list(session.scalars(left))
            for run in open_runs:
                _add_transition(
                    session,
                    self.launcher,
                    TransitionRecord(
                        run.state,
                        "ABORTED",
                        "service_stopped",
                        "the service was stopped or killed during the run",
                        0.0,
                        utc_now(),
                        run.id,
                    ),
                )
            return [run.id for run in open_runs]

    # -- results

    def save_result(self, run_id: str, document: str, verdict: str) -> None:
        """Keep a run's result document."""
        digest = hashlib.sha256(document.encode()).hexdigest()
        with self._sessions.begin() as session:
            session.merge(ResultRow(run_id=run_id, sha256=digest, document=document))
            session.execute(update(Run).where(Run.id == run_id).values(verdict=verdict))

    def result(self, run_id: str) -> str | None:
        """Return a run's result document, or None."""
        with self._sessions() as session:
            row = session.get(ResultRow, run_id)
            return row.document if row is not None else None

    def result_hashes(self) -> dict[str, str]:
        """Return the SHA-256 of every run's result document, by run: what tells whether there is anything new."""
        with self._sessions() as session:
            return {row.run_id: row.sha256 for row in session.execute(select(ResultRow.run_id, ResultRow.sha256))}

    def results(self, run_ids: Sequence[str]) -> list[tuple[RunRecord, str]]:
        """Return these runs with their result documents."""
        query = select(Run, ResultRow.document).join(ResultRow, ResultRow.run_id == Run.id).where(Run.id.in_(run_ids))
        with self._sessions() as session:
            return [(_record(run), document) for run, document in session.execute(query)]

    # -- runs carried from store to store

    def carry_out(self, run_id: str) -> Carried | None:
        """Return all that is known of one run, None where there is none."""
        with self._sessions() as session:
            return carried.read(session, run_id)

    def carry_in(self, run: Carried, signer: str, manifest_sha256: str, place: Callable[[], object]) -> None:
        """Add a run of another store; ``place`` puts its files where they belong, and a failure there undoes all.

        Raises
        ------
        KeyError
            The run is here already.
        """
        digest = None if run.result is None else hashlib.sha256(run.result.encode()).hexdigest()
        origin = {"utc": utc_now(), "signer": signer, "manifest_sha256": manifest_sha256}
        with self._sessions.begin() as session:
            if session.get(Run, run.run["id"]) is not None:
                raise KeyError(run.run["id"])
            carried.write(session, run, digest, origin)
            session.flush()
            place()

    # -- audit

    def audit(self, who: str, command: str, run_id: str | None, outcome: str, detail: str = "") -> None:
        """Record one command with its outcome, chained to the entry before."""
        entry = {
            "launcher": self.launcher,
            "utc": utc_now(),
            "who": who,
            "command": command,
            "run_id": run_id,
            "outcome": outcome,
            "detail": detail,
        }
        with self._sessions.begin() as session:
            # Taking the head for writing comes first: whoever else writes waits here, and sees what we leave.
            mine = AuditHead.launcher == self.launcher
            taken = update(AuditHead).where(mine).values(entries=AuditHead.entries + 1)
            if session.connection().execute(taken).rowcount == 0:
                session.add(AuditHead(launcher=self.launcher, entries=1, sha256=GENESIS))
                session.flush()
            head = session.get_one(AuditHead, self.launcher, populate_existing=True)
            head.sha256 = link(head.sha256, head.entries, entry)
            session.add(Audit(**entry, number=head.entries, sha256=head.sha256))
            number, digest = head.entries, head.sha256
        self._witness.note(self.launcher, number, digest)

    def audit_log(self, limit: int = 100, before: int | None = None) -> list[dict[str, Any]]:
        """Return up to ``limit`` entries, of all launchers, newest first, older than the one with id ``before``."""
        query = select(Audit).order_by(Audit.id.desc()).limit(limit)
        if before is not None:
            query = query.where(Audit.id < before)
        with self._sessions() as session:
            return [_columns(row) for row in session.scalars(query)]

    def verify_audit(self, noted: Mapping[int, str]) -> Verification:
        """Check this launcher's audit log against itself, the file beside the store, and hashes noted elsewhere."""
        query = select(Audit).where(Audit.launcher == self.launcher).order_by(Audit.number)
        with self._sessions() as session:
            row = session.get(AuditHead, self.launcher)
            head = Head(row.entries, row.sha256) if row is not None else None
            entries = map(_columns, session.scalars(query))
            return verify(self.launcher, entries, head, {**self._witness.read(self.launcher), **noted})

    # -- tokens

    def add_token(self, token: TokenRecord) -> None:
        """Keep a token."""
        with self._sessions.begin() as session:
            session.add(Token(launcher=self.launcher, **asdict(token)))

    def tokens(self) -> list[TokenRecord]:
        """Return this launcher's tokens, the revoked ones too, oldest first."""
        query = select(Token).where(Token.launcher == self.launcher).order_by(Token.created_utc, Token.id)
        with self._sessions() as session:
            return [_token(row) for row in session.scalars(query)]

    def revoke_token(self, token_id: str) -> bool:
        """End a token now; tell whether there was one to end."""
        known = (Token.id == token_id) & (Token.launcher == self.launcher) & Token.revoked_utc.is_(None)
        with self._sessions.begin() as session:
            ended = session.connection().execute(update(Token).where(known).values(revoked_utc=utc_now()))
            return bool(ended.rowcount)


def _columns(row: Audit) -> dict[str, Any]:
    return {column.name: getattr(row, column.name) for column in Audit.__table__.columns}


def _token(row: Token) -> TokenRecord:
    return TokenRecord(**{field.name: getattr(row, field.name) for field in fields(TokenRecord)})


def _new_run_id(now: str) -> str:
    """Return an id that sorts by time and is a safe folder name."""
    stamp = now.replace("-", "").replace(":", "").replace(".", "").rstrip("Z")
    return f"{stamp}-{secrets.token_hex(2)}"


def _add_transition(session: Session, launcher: str, record: TransitionRecord) -> None:
    session.add(
        Transition(
            launcher=launcher,
            run_id=record.run_id,
            utc=record.utc,
            simulated_s=record.simulated_s,
            source=record.source,
            target=record.target,
            reason=record.reason,
            detail=record.detail,
        )
    )
    if record.run_id is None:
        return
    run = session.get_one(Run, record.run_id)
    if run.ended_utc is not None:
        return  # a FAULT that is acknowledged later leaves the run as it ended
    run.state, run.reason = record.target, record.reason
    if record.target in OVER:
        run.ended_utc = record.utc


def _transition(row: Transition) -> dict[str, Any]:
    return {
        "utc": row.utc,
        "simulated_s": row.simulated_s,
        "source": row.source,
        "target": row.target,
        "reason": row.reason,
        "detail": row.detail,
        "run_id": row.run_id,
    }


def _record(run: Run, transitions: list[dict[str, Any]] | None = None) -> RunRecord:
    return RunRecord(
        run.id,
        run.launcher,
        run.started_utc,
        run.ended_utc,
        run.method,
        run.operator,
        run.state,
        run.reason,
        run.verdict,
        run.software,
        dict(run.request),
        dict(run.block),
        transitions or [],
    )
