"""Bodies that the API takes and gives."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

Text = Annotated[str, StringConstraints(max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")]
"""One line of a person's words."""


class Body(BaseModel):
    """Common rules of request bodies."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class RunRequest(Body):
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
    """One run."""

    run_id: str
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


class Library(BaseModel):
    """Documents in one folder."""

    entries: list[LibraryEntry]


class Health(BaseModel):
    """Whether the service lives, or can take commands, and if not, why."""

    ok: bool
    reasons: list[str]
