"""``/runs``: start, follow, abort and acknowledge runs, and fetch what they found."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Body, Header, Query, Request, Response
from fastapi.responses import FileResponse

from inertial.documents import Result, parse_document
from service.api.common import REFUSALS, ControllerHere, MayCommand, RunId, as_problem, who_asks
from service.api.models import Accepted, Change, NavigationError, Note, Run, RunDetail, RunList, RunStart
from service.api.problems import ProblemError, responses
from service.controller import Controller
from service.navigation_error import navigation_error
from service.store import RunRecord

router = APIRouter(prefix="/runs", tags=["runs"])
BASE = "/api/v1/runs"


@router.post("", status_code=202, responses=responses(400, 409, 413, 422, 423, 503), dependencies=[MayCommand])
def start_run(
    body: RunStart,
    request: Request,
    response: Response,
    controller: ControllerHere,
    idempotency_key: Annotated[str | None, Header(min_length=1, max_length=200)] = None,
) -> Accepted:
    """Start a run; with ``Idempotency-Key``, asking again gives the run that the first request started."""
    try:
        asked = body.model_dump(mode="json")
        run_id, _ = controller.start_run(asked, who_asks(request, body.operator), idempotency_key)
    except REFUSALS as error:
        raise as_problem(error) from None
    return _accepted(controller, response, run_id)


@router.get("", responses=responses(422))
def list_runs(
    controller: ControllerHere,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    before: Annotated[str | None, Query(max_length=40, description="Runs older than this one.")] = None,
) -> RunList:
    """List runs, newest first."""
    records = controller.store.runs(limit, before)
    following = f"{BASE}?limit={limit}&before={records[-1].id}" if len(records) == limit else None
    return RunList(runs=[Run(**_run(record)) for record in records], next=following)


@router.get("/{run_id}", responses=responses(404, 422))
def read_run(run_id: RunId, controller: ControllerHere) -> RunDetail:
    """Tell one run with its changes of state."""
    record = _known(controller, run_id)
    return RunDetail(
        **_run(record),
        transitions=[Change(**{key: one[key] for key in Change.model_fields}) for one in record.transitions],
        terms=controller.terms(run_id),
    )


@router.post(
    "/{run_id}/abort", status_code=202, responses=responses(400, 404, 409, 413, 422, 423), dependencies=[MayCommand]
)
def abort_run(
    run_id: RunId,
    request: Request,
    response: Response,
    controller: ControllerHere,
    note: Annotated[Note | None, Body()] = None,
) -> Accepted:
    """Abort the run in hand."""
    note = note or Note()
    try:
        controller.abort_run(run_id, who_asks(request, note.operator), note.reason or "")
    except REFUSALS as error:
        raise as_problem(error) from None
    return _accepted(controller, response, run_id)


@router.post(
    "/{run_id}/acknowledge",
    status_code=202,
    responses=responses(400, 404, 409, 413, 422, 423),
    dependencies=[MayCommand],
)
def acknowledge_run(
    run_id: RunId,
    request: Request,
    response: Response,
    controller: ControllerHere,
    note: Annotated[Note | None, Body()] = None,
) -> Accepted:
    """Take note of a FAULT, which a new run needs."""
    note = note or Note()
    try:
        controller.acknowledge_run(run_id, who_asks(request, note.operator), note.reason or "")
    except REFUSALS as error:
        raise as_problem(error) from None
    return _accepted(controller, response, run_id)


@router.get("/{run_id}/result", response_model=Result, responses=responses(404, 422))
def read_result(run_id: RunId, controller: ControllerHere) -> Response:
    """Give the result document of a run, byte for byte as it was concluded."""
    record = _known(controller, run_id)
    document = controller.store.result(run_id)
    if document is None:
        raise _nothing_yet(record, "result")
    return Response(document, media_type="application/json")


@router.get("/{run_id}/navigation", responses=responses(404, 422))
def read_navigation(run_id: RunId, controller: ControllerHere) -> NavigationError:
    """Tell how far navigation goes astray with the run's terms in, and without them."""
    record = _known(controller, run_id)
    document = controller.store.result(run_id)
    if document is None:
        raise _nothing_yet(record, "result")
    return NavigationError(**_navigation(document))


@lru_cache(maxsize=32)
def _navigation(document: str) -> dict[str, Any]:
    return navigation_error(parse_document(Result, document, "result.json"))


@router.get(
    "/{run_id}/report",
    response_class=FileResponse,
    responses={200: {"content": {"text/html": {}}}, **responses(404, 422)},
)
def read_report(run_id: RunId, controller: ControllerHere) -> FileResponse:
    """Give the report page of a run."""
    record = _known(controller, run_id)
    return _file(record, controller.folder(run_id).report, "report", "text/html; charset=utf-8")


@router.get(
    "/{run_id}/samples",
    response_class=FileResponse,
    responses={200: {"content": {"application/vnd.apache.parquet": {}}}, **responses(404, 422)},
)
def read_samples(run_id: RunId, controller: ControllerHere) -> FileResponse:
    """Give the samples of a run as Parquet."""
    record = _known(controller, run_id)
    path = controller.folder(run_id).recording
    return _file(record, path, "samples", "application/vnd.apache.parquet", f"{run_id}.parquet")


def _known(controller: Controller, run_id: str) -> RunRecord:
    try:
        return controller.run(run_id)
    except REFUSALS as error:
        raise as_problem(error) from None


def _accepted(controller: Controller, response: Response, run_id: str) -> Accepted:
    location = f"{BASE}/{run_id}"
    response.headers["Location"] = location
    return Accepted(run_id=run_id, state=controller.status().facts["state"], location=location)


def _file(record: RunRecord, path: Path, what: str, media_type: str, name: str | None = None) -> FileResponse:
    if not path.is_file():
        raise _nothing_yet(record, what)
    return FileResponse(path, media_type=media_type, filename=name)


def _nothing_yet(record: RunRecord, what: str) -> ProblemError:
    over = record.ended_utc is not None
    stands = f"{'ended' if over else 'stands'} in {record.state} ({record.reason})"
    # Where launchers share a store, files lie with the launcher that wrote them.
    detail = f"Run {record.id} of launcher {record.launcher!r} {stands}; there is no {what} of it here."
    return ProblemError(404, f"no-{what}", detail, state=record.state)


def _run(record: RunRecord) -> dict[str, Any]:
    address = f"{BASE}/{record.id}"
    return {
        "run_id": record.id,
        "state": record.state,
        "reason": record.reason,
        "verdict": record.verdict,
        "method": record.method,
        "operator": record.operator,
        "started": record.started_utc,
        "ended": record.ended_utc,
        "launcher": record.launcher,
        "software": record.software,
        "request": record.request,
        "block": record.block,
        "links": {"self": address, **{what: f"{address}/{what}" for what in ("result", "report", "samples")}},
    }
