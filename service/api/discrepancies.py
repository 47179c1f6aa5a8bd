"""``/discrepancies``: start the discrepancy workflow, follow it, read what it found; adopt its model."""

from __future__ import annotations

import json
from collections.abc import AsyncGenerator
from contextlib import aclosing
from typing import Annotated, Any

from fastapi import APIRouter, Header, Path, Request, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel, ConfigDict, Field, StringConstraints, model_validator

from inertial.documents import DocumentError
from service.api.common import REFUSALS as RUN_REFUSALS
from service.api.common import ControllerHere, as_problem, who_asks
from service.api.models import Body, Text
from service.api.problems import ProblemError, responses
from service.api.stream import DOCUMENTED, EventStream, Message
from service.controller import Controller
from service.discrepancies import OVER, DiscrepancyKeyReused, Job, TooManyDiscrepancies, UnknownDiscrepancy, progress_of
from service.discrepancy_desk import REFUSALS, RunInHand, UnknownInput
from service.events import text_of

router = APIRouter(tags=["discrepancies"])
BASE = "/api/v1/discrepancies"
Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
JobId = Annotated[str, Path(description="Id of a discrepancy, as POST /discrepancies gave it.", max_length=40)]


class RecordingChoice(Body):
    """A recording: that of a run, or one in the configured folder of recordings, by its name without ending."""

    model_config = ConfigDict(
        json_schema_extra={
            "oneOf": [{"required": [one], "properties": {one: {"type": "string"}}} for one in ("run_id", "name")]
        }
    )

    run_id: Annotated[str, StringConstraints(max_length=40)] | None = None
    name: Text | None = None

    @model_validator(mode="after")
    def _one(self) -> RecordingChoice:
        if (self.run_id is None) == (self.name is None):
            raise ValueError("give run_id or name, one of them")
        return self


class DiscrepancyStart(Body):
    """Start the workflow. ``model``: SHA-256 of the model to start from, instead of the one in use."""

    recordings: Annotated[list[RecordingChoice], Field(min_length=1, max_length=20)]
    model: Sha256 | None = None
    operator: Text | None = None


class DiscrepancyAccepted(BaseModel):
    """The workflow will run; ``location`` is where to follow it."""

    id: str
    state: str
    location: str


class Discrepancy(BaseModel):
    """One run of the workflow. ``progress`` from 0 to 1; ``model`` it started from, ``found`` the new one."""

    id: str
    state: str
    progress: float
    text: str
    operator: str
    started: str
    ended: str | None
    request: dict[str, Any]
    model: str
    found: str | None
    verdict: str | None
    error: str | None
    links: dict[str, str]


class DiscrepancyDetail(Discrepancy):
    """One run of the workflow with its ``report.json``, once there is one."""

    report: dict[str, Any] | None


class DiscrepancyList(BaseModel):
    """All runs of the workflow, newest first, and the recordings in the configured folder."""

    discrepancies: list[Discrepancy]
    recordings: list[str]


class Adoption(Body):
    """Believe in another model from now on: a child of the one in use, by its SHA-256."""

    sha256: Sha256
    operator: Text
    reason: Text | None = None


class Adopted(BaseModel):
    """The model in use."""

    sha256: str


@router.post("/discrepancies", status_code=202, responses=responses(400, 404, 409, 413, 422, 503))
def start_discrepancy(
    body: DiscrepancyStart,
    request: Request,
    response: Response,
    controller: ControllerHere,
    idempotency_key: Annotated[str | None, Header(min_length=1, max_length=200)] = None,
) -> DiscrepancyAccepted:
    """Start the workflow on recordings that are known here; it runs in a process of its own."""
    asked = body.model_dump(mode="json")
    try:
        job, _ = controller.desk.start(asked, who_asks(request, body.operator), idempotency_key)
    except (*REFUSALS, *RUN_REFUSALS) as error:
        raise _problem(error) from None
    response.headers["Location"] = f"{BASE}/{job.id}"
    return DiscrepancyAccepted(id=job.id, state=job.state, location=f"{BASE}/{job.id}")


@router.get("/discrepancies")
def list_discrepancies(controller: ControllerHere) -> DiscrepancyList:
    """List all runs of the workflow, newest first."""
    jobs = [Discrepancy(**_facts(job)) for job in controller.desk.jobs.jobs()]
    return DiscrepancyList(discrepancies=jobs, recordings=controller.desk.recordings())


@router.get("/discrepancies/{job_id}", responses=responses(404, 422))
def read_discrepancy(job_id: JobId, controller: ControllerHere) -> DiscrepancyDetail:
    """Tell how one run of the workflow stands, and what it found."""
    job = _known(controller, job_id)
    return DiscrepancyDetail(**_facts(job), report=controller.desk.jobs.report(job_id))


@router.get(
    "/discrepancies/{job_id}/report",
    response_class=FileResponse,
    responses={200: {"content": {"text/html": {}}}, **responses(404, 422)},
)
def read_discrepancy_report(job_id: JobId, controller: ControllerHere) -> FileResponse:
    """Give the report page."""
    job = _known(controller, job_id)
    page = controller.desk.jobs.page(job_id)
    if page is None:
        raise ProblemError(404, "no-report", f"Discrepancy {job_id} is {job.state}, without a report.", state=job.state)
    return FileResponse(page, media_type="text/html; charset=utf-8")


@router.get(
    "/discrepancies/{job_id}/events",
    response_class=Response,
    responses={**DOCUMENTED, **responses(404, 422)},
)
def follow_discrepancy(job_id: JobId, controller: ControllerHere) -> Response:
    """Stream ``discrepancy`` (how it stands, at once and at every step) until it is over, and ``heartbeat``."""
    _known(controller, job_id)
    return EventStream(_progress(controller, job_id))


async def _progress(controller: Controller, job_id: str) -> AsyncGenerator[Message]:
    async with aclosing(controller.hub.subscribe()) as stream:
        facts = progress_of(_known(controller, job_id))
        yield Message("discrepancy", text_of(facts), retry_ms=2_000)
        while facts["state"] not in OVER:
            event = await anext(stream)
            if event.kind == "heartbeat":
                yield Message("heartbeat", event.text)
                facts = progress_of(controller.desk.jobs.job(job_id))  # one that ended before we subscribed
            elif event.kind == "discrepancy" and (told := json.loads(event.text))["id"] == job_id:
                facts = told
                yield Message("discrepancy", event.text)


@router.post("/models/adopt", responses=responses(400, 404, 409, 413, 422, 503))
def adopt_model(body: Adoption, request: Request, controller: ControllerHere) -> Adopted:
    """Believe in another model from now on; in the audit log."""
    try:
        controller.desk.adopt(body.sha256, who_asks(request, body.operator), body.reason or "")
    except REFUSALS as error:
        raise _problem(error) from None
    return Adopted(sha256=body.sha256)


def _known(controller: Controller, job_id: str) -> Job:
    try:
        return controller.desk.jobs.job(job_id)
    except UnknownDiscrepancy:
        detail = f"There is no discrepancy {job_id!r}. GET {BASE} lists them."
        raise ProblemError(404, "unknown-discrepancy", detail) from None


def _facts(job: Job) -> dict[str, Any]:
    address = f"{BASE}/{job.id}"
    same = ("id", "state", "text", "operator", "request", "model", "found", "verdict", "error")
    return {
        **{key: getattr(job, key) for key in same},
        "progress": job.share,
        "started": job.started_utc,
        "ended": job.ended_utc,
        "links": {"self": address, "report": f"{address}/report", "events": f"{address}/events"},
    }


def _problem(error: Exception) -> ProblemError:
    text = f"{str(error)[:1].upper()}{str(error)[1:]}."
    if isinstance(error, UnknownInput):
        return ProblemError(404, "unknown-input", text)
    if isinstance(error, RunInHand | TooManyDiscrepancies):
        return ProblemError(409, "not-allowed", f"{text} Ask again when it is over.")
    if isinstance(error, DiscrepancyKeyReused):
        return ProblemError(422, "idempotency-key-reused", f"{text} Use a new key for a new request.")
    if isinstance(error, DocumentError):
        return ProblemError(409, "model-refused", str(error))
    return as_problem(error)
