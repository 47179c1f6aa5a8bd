"""What becomes of a run's samples: estimated, written, reported. All of it work for :mod:`service.side_process`.

Each piece marks the lines that its process writes with its run, as the service marks its own.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivers.recording import Recording
from drivers.recording_meta import RecordingMeta
from inertial.documents import Result, StageTerms
from service.compensate import compensate, partial
from service.config import BlockSettings, LogSettings, ReferenceSettings, SiteSettings
from service.logs import configure_logs, correlate
from service.orders import Estimate, Keep
from service.report import render
from service.run_folder import RunFolder, recording_meta, write_whole
from service.warm_up import warm_up


@dataclass(frozen=True)
class RunPlan:
    """What a run was asked to do."""

    method: str
    site: SiteSettings | None
    reference: ReferenceSettings
    folder: RunFolder
    block: BlockSettings

    def meta(self, order: Estimate | Keep) -> RecordingMeta:
        """Return what is known of an order's samples."""
        return recording_meta(self.site, self.block, self.reference, order.samples, order.windows, order.turns)


def prepare(log: LogSettings) -> None:
    """Make a process ready: its lines look like the service's, and nothing is left to import or to compile."""
    configure_logs(log)
    warm_up()


def terms_so_far(plan: RunPlan, order: Estimate) -> dict[str, StageTerms]:
    """Return the terms after each stage whose window is full."""
    correlate(plan.folder.run_id)
    path = plan.folder.recording  # where the windows so far would stand; nothing is written for progress
    recording = Recording(order.samples, plan.meta(order), path, path.with_suffix(".toml"))
    return partial(recording, order.windows, method=plan.method)


def final_result(plan: RunPlan, order: Estimate) -> Result:
    """Write the run's recording and return what is found from it."""
    correlate(plan.folder.run_id)
    return compensate(plan.folder.write_recording(order.samples, plan.meta(order)), method=plan.method)


def keep_recording(plan: RunPlan, order: Keep) -> None:
    """Write the recording of a run that has no result."""
    correlate(plan.folder.run_id)
    if len(order.samples) > 1:
        plan.folder.write_recording(order.samples, plan.meta(order))


def write_result(folder: RunFolder, result: Result) -> str:
    """Write result and report, and return the result's document."""
    correlate(folder.run_id)
    document = result.canonical_json()
    write_whole(folder.result, document)
    write_whole(folder.report, render(result))
    return document
