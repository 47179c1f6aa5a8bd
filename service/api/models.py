"""Bodies that the API takes and gives."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

Text = Annotated[str, StringConstraints(max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")]
"""One line of a person's words."""


class Body(BaseModel):
    """Common rules of request bodies."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class RunStart(Body):
    """Start a run. ``azimuth_deg``: the launcher's azimuth now, instead of the configured one. ``alignment``: how the
    attitude that is not given is found, instead of the configured way; "inertial" while the launcher sways.
    """

    method: Literal["optimal", "paper"] = "optimal"
    azimuth_deg: Annotated[float, Field(ge=-360, le=360)] | None = None
    alignment: Literal["rest", "inertial"] | None = None
    operator: Text | None = None


class Note(Body):
    """Who gives a command, and why."""

    operator: Text | None = None
    reason: Text | None = None


class Accepted(BaseModel):
    """A command was taken; ``location`` is where to follow the run."""

    run_id: str
    state: str
    location: str


class Status(BaseModel):
    """The service now. Times in simulated seconds; ``stage`` is the step in hand, or the one that HOLD interrupted."""

    state: str
    since: str
    reason: str
    detail: str
    run_id: str | None
    stage: str | None
    progress: float | None
    elapsed_s: float
    remaining_s: float | None
    link: str
    age_s: float | None
    fit: bool
    reasons: list[str]
    allowed: list[str]


class Change(BaseModel):
    """One change of state."""

    utc: str
    simulated_s: float
    source: str
    target: str
    reason: str
    detail: str


class Run(BaseModel):
    """One run; ``launcher`` wrote it, where many share a store."""

    run_id: str
    launcher: str
    state: str
    reason: str
    verdict: str | None
    method: str
    operator: str | None
    started: str
    ended: str | None
    software: str
    request: dict[str, Any]
    block: dict[str, Any]
    links: dict[str, str]


class RunDetail(Run):
    """One run with its changes of state and, while it is in hand, the terms of its stages so far."""

    transitions: list[Change]
    terms: dict[str, Any]


class RunList(BaseModel):
    """Runs, newest first; ``next`` is the address of older ones."""

    runs: list[Run]
    next: str | None


class LibraryEntry(BaseModel):
    """A calibration or block model: its file name, content address, schema and block; or why it cannot be read."""

    name: str
    sha256: str | None = None
    document: str | None = None
    block: str | None = None
    error: str | None = None
    in_use: bool = Field(description="Runs go by this one now.")


class Library(BaseModel):
    """Documents that the service knows."""

    entries: list[LibraryEntry]


class Health(BaseModel):
    """Whether the service lives, or can take commands, and if not, why."""

    ok: bool
    reasons: list[str]


class AcknowledgementNote(Body):
    """Who takes note of a broken condition, and why: both have to be said."""

    operator: Annotated[Text, Field(min_length=1)]
    reason: Annotated[Text, Field(min_length=1)]


class ConditionNote(BaseModel):
    """Who took note of a broken condition, when and why."""

    by: str
    reason: str
    utc: str


class Condition(BaseModel):
    """One go / no-go condition: its value against its limit, since when, what causes it and what mends it."""

    name: str
    title: str
    severity: Literal["critical", "warning"]
    state: Literal["ok", "pending", "failed", "acknowledged", "unknown"]
    since: str
    persistence_s: float
    measured: float | str | None
    limit: float | str | None
    unit: str
    text: str
    cause: str
    remedy: str
    acknowledgement: ConditionNote | None


class Conditions(BaseModel):
    """All conditions, with the judgement of the status."""

    fit: bool
    reasons: list[str]
    conditions: list[Condition]


class LeaseRequest(Body):
    """Ask for the lease. ``take_over``: from whoever holds it, with the reason."""

    holder: Annotated[Text, Field(min_length=1)]
    lasts_s: Annotated[float, Field(ge=5, le=600)] = 30.0
    take_over: bool = False
    reason: Text | None = None


class LeaseRenewal(Body):
    """Keep the lease for so long from now on."""

    lasts_s: Annotated[float, Field(ge=5, le=600)] = 30.0


class LeaseTaken(BaseModel):
    """The lease; ``lease_id`` goes with every command as the header ``Lease-Id``."""

    lease_id: str
    holder: str
    lasts_s: float
    taken_over_from: str | None = None


class LeaseState(BaseModel):
    """Who commands now, and for how long if he does not renew; nulls while nobody holds the lease."""

    holder: str | None
    left_s: float | None


class SignIn(Body):
    """A token, to be changed for a session cookie."""

    token: Annotated[str, StringConstraints(min_length=1, max_length=200)]


class SessionState(BaseModel):
    """Who the service takes the asker for; ``csrf`` goes with every command as the header ``X-CSRF-Token``."""

    needed: bool
    name: str | None
    role: str | None
    csrf: str | None


class AuditEntry(BaseModel):
    """One command, accepted or refused, chained to the one before."""

    id: int
    launcher: str
    number: int
    utc: str
    who: str
    command: str
    run_id: str | None
    outcome: str
    detail: str
    sha256: str


class AuditLog(BaseModel):
    """Entries, newest first; ``next`` is the address of older ones."""

    entries: list[AuditEntry]
    next: str | None


class LineState(BaseModel):
    """The line: its state, the age of the newest frame, and every count since the service started."""

    state: str
    age_s: float | None
    url: str | None
    protocol: str
    bit_rate: int
    counters: dict[str, int]


class PlannedStep(BaseModel):
    """One step of a run and how long it takes at least [simulated s]; null where the block decides."""

    step: str
    at_least_s: float | None


class Plan(BaseModel):
    """The way of a run, and the size of terms that ageing explains [mg, deg/h]."""

    steps: list[PlannedStep]
    accel_term_mg: float
    gyro_term_dph: float
    speed: float


class NavigationError(BaseModel):
    """Radial error [m] at rest over time [s]: 50 and 95 % with the terms, and the mean without them."""

    time_s: list[float]
    with_50_m: list[float | None]
    with_95_m: list[float | None]
    without_m: list[float]


class SchemaList(BaseModel):
    """Addresses of the JSON schemas of all documents."""

    schemas: dict[str, str]
