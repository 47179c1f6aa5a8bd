"""One trial of a fleet's re-analysis: what a model does not say of one block's recordings."""

from __future__ import annotations

import json
import time
from typing import Any

import pyarrow as pa

from drivers.recording_meta import RecordingError
from service.campaign.spec import Campaign
from simulators.discrepancy.compare import read_to_compare
from simulators.discrepancy.report import discrepancy
from simulators.errors import ScenarioError
from simulators.model_store import load_model

COLUMNS = pa.schema(
    [
        ("trial", pa.int64()),
        ("block", pa.string()),
        ("recordings", pa.list_(pa.string())),
        ("verdict", pa.string()),
        ("reason", pa.string()),
        ("effects", pa.list_(pa.string())),
        ("findings", pa.string()),
        ("largest_evidence_nats", pa.float64()),
        ("heldout_rms_before", pa.float64()),
        ("heldout_rms_after", pa.float64()),
        ("model_sha256", pa.string()),
        ("wall_analyse_s", pa.float64()),
        ("wall_cpu_s", pa.float64()),
    ]
)
"""``findings`` is the JSON of ``report.json``'s findings; ``effects`` their names as effect:channel."""


def run_reanalysis(spec: Campaign, trial: int) -> dict[str, Any]:
    """Analyse one subject; a recording that cannot be used is a row that says why."""
    subject = spec.subjects[trial]
    row: dict[str, Any] = {
        "trial": trial,
        "block": subject.block,
        "recordings": [path.name for path in subject.recordings],
    }
    began, cpu_s = time.perf_counter(), time.process_time()
    try:
        report = discrepancy([read_to_compare(path) for path in subject.recordings], load_model(subject.model))
    except (RecordingError, ScenarioError) as error:
        row |= {"verdict": "refused", "reason": str(error)}
    else:
        gap = report.document["gap"]["heldout_rms"]
        row |= {
            "verdict": report.verdict,
            "reason": report.document["text"],
            "effects": [f"{finding['effect']}:{finding['channel']}" for finding in report.findings],
            "findings": json.dumps(report.findings, sort_keys=True),
            "largest_evidence_nats": max((f["evidence_nats"] for f in report.findings), default=None),
            "heldout_rms_before": gap["before"],
            "heldout_rms_after": gap["after"],
            "model_sha256": report.document["model"]["sha256"],
        }
    return row | {"wall_analyse_s": time.perf_counter() - began, "wall_cpu_s": time.process_time() - cpu_s}
