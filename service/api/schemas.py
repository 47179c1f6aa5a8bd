"""A versioned JSON schema (draft 2020-12) for each document that the service gives or keeps."""

from __future__ import annotations

import json
from functools import cache

from pydantic import BaseModel

from inertial.documents import BlockModel, Calibration, Result
from service.api import models
from service.api.problems import Problem

DIALECT = "https://json-schema.org/draft/2020-12/schema"
SCHEMAS: dict[str, tuple[str, type[BaseModel]]] = {
    "status": ("inertrim/status/1", models.Status),
    "conditions": ("inertrim/conditions/1", models.Conditions),
    "run": ("inertrim/run/1", models.RunDetail),
    "runs": ("inertrim/runs/1", models.RunList),
    "lease": ("inertrim/lease/1", models.LeaseState),
    "line": ("inertrim/line/1", models.LineState),
    "audit": ("inertrim/audit/1", models.AuditLog),
    "health": ("inertrim/health/1", models.Health),
    "problem": ("inertrim/problem/1", Problem),
    "result": ("inertrim/result/1", Result),
    "calibration": ("inertrim/calibration/1", Calibration),
    "block": ("inertrim/block/1", BlockModel),
}
"""By name in the address: the schema's own name with its version, and the model behind it."""


@cache
def schema_of(name: str) -> bytes:
    """Return one schema as JSON."""
    title, model = SCHEMAS[name]
    schema = {
        "$schema": DIALECT,
        "$id": f"urn:{title.replace('/', ':')}",
        **model.model_json_schema(mode="serialization"),
    }
    return json.dumps(schema, indent=2).encode()
