"""Tables of the store. A change here comes with a migration beside it."""

from __future__ import annotations

from sqlalchemy import JSON, Double, ForeignKey, Index, Text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column


class Base(DeclarativeBase):
    """Declarative base of all tables."""


class Run(Base):
    """One request to trim the block, from its start to its end."""

    __tablename__ = "runs"
    __table_args__ = (Index("runs_by_launcher", "launcher", "id"),)

    id: Mapped[str] = mapped_column(Text, primary_key=True)
    launcher: Mapped[str] = mapped_column(Text, server_default="launcher")
    started_utc: Mapped[str] = mapped_column(Text)
    ended_utc: Mapped[str | None] = mapped_column(Text)
    method: Mapped[str] = mapped_column(Text)
    operator: Mapped[str | None] = mapped_column(Text)
    request: Mapped[dict[str, object]] = mapped_column(JSON)
    software: Mapped[str] = mapped_column(Text)
    state: Mapped[str] = mapped_column(Text)
    reason: Mapped[str] = mapped_column(Text)
    verdict: Mapped[str | None] = mapped_column(Text)
    block: Mapped[dict[str, object]] = mapped_column(JSON)


class Transition(Base):
    """One change of state, with its reason."""

    __tablename__ = "transitions"
    __table_args__ = (
        Index("transitions_by_run", "run_id", "id"),
        Index("transitions_by_launcher", "launcher", "id"),
    )

    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    launcher: Mapped[str] = mapped_column(Text, server_default="launcher")
    run_id: Mapped[str | None] = mapped_column(ForeignKey("runs.id"))
    utc: Mapped[str] = mapped_column(Text)
    simulated_s: Mapped[float] = mapped_column(Double)
    source: Mapped[str] = mapped_column(Text)
    target: Mapped[str] = mapped_column(Text)
    reason: Mapped[str] = mapped_column(Text)
    detail: Mapped[str] = mapped_column(Text)


class ResultRow(Base):
    """The result document of a run, as written beside its recording."""

    __tablename__ = "results"

    run_id: Mapped[str] = mapped_column(ForeignKey("runs.id"), primary_key=True)
    sha256: Mapped[str] = mapped_column(Text)
    document: Mapped[str] = mapped_column(Text)


class Audit(Base):
    """One command, accepted or refused: who, when, what, outcome; each launcher's entries are numbered and chained."""

    __tablename__ = "audit"

    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    launcher: Mapped[str] = mapped_column(Text, server_default="launcher")
    number: Mapped[int] = mapped_column(server_default="0")
    sha256: Mapped[str] = mapped_column(Text, server_default="")
    utc: Mapped[str] = mapped_column(Text)
    who: Mapped[str] = mapped_column(Text)
    command: Mapped[str] = mapped_column(Text)
    run_id: Mapped[str | None] = mapped_column(Text)
    outcome: Mapped[str] = mapped_column(Text)
    detail: Mapped[str] = mapped_column(Text)


class AuditHead(Base):
    """Where each launcher's audit log ends."""

    __tablename__ = "audit_heads"

    launcher: Mapped[str] = mapped_column(Text, primary_key=True)
    entries: Mapped[int]
    sha256: Mapped[str] = mapped_column(Text)


class Token(Base):
    """A bearer token of one launcher, by the hash of its secret."""

    __tablename__ = "tokens"

    id: Mapped[str] = mapped_column(Text, primary_key=True)
    launcher: Mapped[str] = mapped_column(Text)
    name: Mapped[str] = mapped_column(Text)
    role: Mapped[str] = mapped_column(Text)
    secret_hash: Mapped[str] = mapped_column(Text)
    created_utc: Mapped[str] = mapped_column(Text)
    expires_utc: Mapped[str | None] = mapped_column(Text)
    revoked_utc: Mapped[str | None] = mapped_column(Text)


class IdempotencyKey(Base):
    """A key that a client gave a launcher with a command, so that asking twice starts one run."""

    __tablename__ = "idempotency_keys"

    launcher: Mapped[str] = mapped_column(Text, primary_key=True)
    key: Mapped[str] = mapped_column(Text, primary_key=True)
    utc: Mapped[str] = mapped_column(Text)
    request_sha256: Mapped[str] = mapped_column(Text)
    run_id: Mapped[str] = mapped_column(ForeignKey("runs.id"))


class CarriedRun(Base):
    """A run that came from another store in a bundle: who signed it, and the audit entries it brought along."""

    __tablename__ = "carried_runs"

    run_id: Mapped[str] = mapped_column(ForeignKey("runs.id"), primary_key=True)
    utc: Mapped[str] = mapped_column(Text)
    signer: Mapped[str] = mapped_column(Text)
    manifest_sha256: Mapped[str] = mapped_column(Text)
    audit: Mapped[str] = mapped_column(Text)
