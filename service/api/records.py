"""``/audit``, ``/line``, ``/plan``, ``/schemas``: what was commanded, how the line fares, what is to come."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Query, Response

from service.api.common import ControllerHere
from service.api.models import AuditEntry, AuditLog, LineState, Plan, PlannedStep, SchemaList
from service.api.problems import ProblemError, responses
from service.api.schemas import SCHEMAS, schema_of
from service.sequencer import planned

router = APIRouter(tags=["records"])
BASE = "/api/v1"


@router.get("/audit", responses=responses(422))
def read_audit(
    controller: ControllerHere,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
    before: Annotated[int | None, Query(ge=0, le=2**53, description="Entries older than the one of this id.")] = None,
) -> AuditLog:
    """List commands, newest first."""
    rows = controller.store.audit_log(limit, before)
    following = f"{BASE}/audit?limit={limit}&before={rows[-1]['id']}" if len(rows) == limit else None
    return AuditLog(entries=[AuditEntry(**row) for row in rows], next=following)


@router.get("/line")
def read_line(controller: ControllerHere) -> LineState:
    """Tell how the line fares."""
    link, line = controller.settings.link, controller.line
    facts = controller.status().facts
    return LineState(
        state=facts["link"],
        age_s=facts["age_s"],
        url=link.url,
        protocol=link.protocol,
        bit_rate=link.bit_rate,
        counters=line.counters() if line is not None else {},
    )


@router.get("/plan")
def read_plan(controller: ControllerHere) -> Plan:
    """Tell the way of a run with the least time each step takes, and what terms are expected."""
    limits = controller.settings.conditions
    return Plan(
        steps=[PlannedStep(step=name, at_least_s=length) for name, length in planned(controller.settings.sequence)],
        accel_term_mg=limits.accel_term_mg,
        gyro_term_dph=limits.gyro_term_dph,
        speed=controller.timebase.speed,
    )


@router.get("/schemas")
def list_schemas() -> SchemaList:
    """List the JSON schemas of all documents."""
    return SchemaList(schemas={name: f"{BASE}/schemas/{name}" for name in SCHEMAS})


@router.get(
    "/schemas/{name}",
    responses={200: {"content": {"application/schema+json": {"schema": {"type": "object"}}}}, **responses(404, 422)},
    response_class=Response,
)
def read_schema(name: Annotated[str, Path(max_length=60)]) -> Response:
    """Give one JSON schema."""
    if name not in SCHEMAS:
        raise ProblemError(404, "unknown-schema", f"There is no schema {name!r}. GET {BASE}/schemas lists them.")
    return Response(schema_of(name), media_type="application/schema+json")
