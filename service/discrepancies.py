"""The discrepancy workflow within the running service: jobs in a process of their own, one at a time, kept on disk.

A job is a folder beside the store: ``job.json`` (what was asked, how it stands) and what the workflow writes. The
process runs at the lowest priority with one thread, so that acquisition is never slowed.
"""

from __future__ import annotations

import json
import os
import queue
import secrets
import shutil
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import structlog

from service.events import EventHub
from service.run_folder import write_whole
from service.store import utc_now

log = structlog.get_logger()

MOST_WAITING = 8
"""Jobs that may wait; more are refused."""
STOP_S = 5.0
"""Real seconds that a job gets to end when the service ends."""
OVER = ("done", "failed", "interrupted")


class UnknownDiscrepancy(Exception):
    """There is no such job."""


class TooManyDiscrepancies(Exception):
    """As many jobs wait as may."""


class DiscrepancyKeyReused(Exception):
    """An idempotency key came again with another request."""


@dataclass(frozen=True)
class Job:
    """One run of the workflow: what was asked, by whom, and how it stands.

    ``state`` is queued, working, done, failed or interrupted; ``share`` of the work done, ``text`` what is being done;
    ``model`` the SHA-256 it started from, ``found`` that of the new model.
    """

    id: str
    operator: str
    started_utc: str
    request: dict[str, Any]
    recordings: list[str]
    model: str
    key: str | None = None
    state: str = "queued"
    share: float = 0.0
    text: str = "waiting"
    ended_utc: str | None = None
    verdict: str | None = None
    found: str | None = None
    error: str | None = None


class Discrepancies:
    """All jobs of a service. Methods may be called from any thread; none waits for a job.

    Parameters
    ----------
    folder
        Where the jobs' folders lie.
    hub
        Told of every step, as event ``discrepancy``.
    """

    def __init__(self, folder: Path, hub: EventHub) -> None:
        self._folder, self._hub = folder, hub
        self._lock = threading.Lock()
        self._jobs = {job.id: job for job in _kept(folder)}
        for job in self._jobs.values():
            if job.state not in OVER:
                self._change(job, state="interrupted", text="the service was stopped or killed meanwhile")
        self._waiting: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._process: subprocess.Popen[str] | None = None
        self._stopping = False
        self._thread = threading.Thread(target=self._work, name="discrepancies", daemon=True)

    def start_working(self) -> None:
        """Begin to take jobs."""
        self._thread.start()

    def stop(self) -> None:
        """End the job in hand as interrupted."""
        with self._lock:
            self._stopping = True
            process = self._process
        if process is not None:
            process.kill()
        self._waiting.put(None)
        if self._thread.is_alive():
            self._thread.join(2 * STOP_S)

    def jobs(self) -> list[Job]:
        """Return all jobs, newest first."""
        return sorted(self._jobs.values(), key=lambda job: job.id, reverse=True)

    def job(self, job_id: str) -> Job:
        """Return one job or raise :class:`UnknownDiscrepancy`."""
        if job_id not in self._jobs:
            raise UnknownDiscrepancy(job_id)
        return self._jobs[job_id]

    def report(self, job_id: str) -> dict[str, Any] | None:
        """Return ``report.json`` of a job, None before there is one."""
        path = self._folder / self.job(job_id).id / "report.json"
        document: dict[str, Any] | None = json.loads(path.read_text()) if path.is_file() else None
        return document

    def page(self, job_id: str) -> Path | None:
        """Return the path of the report page of a job, None before there is one."""
        path = self._folder / self.job(job_id).id / "report.html"
        return path if path.is_file() else None

    def models(self) -> dict[str, Path]:
        """Return the new models of all jobs by their SHA-256."""
        return {job.found: self._folder / job.id / f"{job.found}.json" for job in self.jobs() if job.found}

    def start(
        self, request: dict[str, Any], recordings: Sequence[Path], model: Path, digest: str, who: str, key: str | None
    ) -> tuple[Job, bool]:
        """Queue a job, or return the one that ``key`` started before, and whether it is new.

        Raises
        ------
        DiscrepancyKeyReused, TooManyDiscrepancies
        """
        with self._lock:
            for job in self._jobs.values():
                if key is not None and job.key == key:
                    if job.request != request:
                        raise DiscrepancyKeyReused(f"the key {key!r} belongs to {job.id}, asked for something else")
                    return job, False
            waiting = sum(job.state not in OVER for job in self._jobs.values())
            if waiting >= MOST_WAITING:
                raise TooManyDiscrepancies(f"{waiting} are in hand already")
            now = utc_now()
            stamp = now.replace("-", "").replace(":", "").replace(".", "").rstrip("Z")
            job = Job(f"{stamp}-{secrets.token_hex(2)}", who, now, request, [str(p) for p in recordings], digest, key)
            folder = self._folder / job.id
            folder.mkdir(parents=True)
            shutil.copyfile(model, folder / "block.json")
            self._keep(job)
        self._waiting.put(job.id)
        return job, True

    # ------------------------------------------------------------------ one after the other

    def _work(self) -> None:
        while (job_id := self._waiting.get()) is not None and not self._stopping:
            try:
                self._run(self._jobs[job_id])
            except Exception as error:
                log.exception("discrepancy", job=job_id)
                self._change(
                    self._jobs[job_id], state="failed", text="failed", error=f"{type(error).__name__}: {error}"
                )

    def _run(self, job: Job) -> None:
        folder = self._folder / job.id
        command = [sys.executable, "-m", "service.discrepancy_worker", str(folder / "block.json"), str(folder)]
        single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
        with self._lock:
            if self._stopping:
                return
            self._process = subprocess.Popen(
                [*command, *job.recordings],
                stdin=subprocess.PIPE,  # never written to: it ends with this process, and the job's with it
                stdout=subprocess.PIPE,
                text=True,
                env={**os.environ, **single},
            )
        job = self._change(job, state="working", text="starting")
        outcome: dict[str, Any] = {}
        assert self._process.stdout is not None
        for line in self._process.stdout:
            told = json.loads(line)
            if "share" in told:
                job = self._change(job, share=told["share"], text=told["text"])
            else:
                outcome = told
        code = self._process.wait()
        self._process = None
        if self._stopping:
            self._change(job, state="interrupted", text="the service was stopped")
        elif "verdict" in outcome:
            self._change(job, state="done", share=1.0, text="done", **outcome)
        else:
            error = outcome.get("error", f"the process ended with code {code}; the service's log tells more")
            self._change(job, state="failed", text="failed", error=error)

    def _change(self, job: Job, **facts: Any) -> Job:
        if facts.get("state") in OVER:
            facts["ended_utc"] = utc_now()
        job = replace(job, **facts)
        self._keep(job, on_disk="state" in facts)
        return job

    def _keep(self, job: Job, on_disk: bool = True) -> None:
        self._jobs[job.id] = job
        if on_disk:
            write_whole(self._folder / job.id / "job.json", json.dumps(asdict(job), indent=2) + "\n")
        self._hub.publish("discrepancy", progress_of(job))


def progress_of(job: Job) -> dict[str, Any]:
    """Return what an event tells of a job."""
    return {key: getattr(job, key) for key in ("id", "state", "share", "text", "verdict", "error")}


def _kept(folder: Path) -> list[Job]:
    """Return the jobs that lie in a folder; one whose start was cut short is none."""
    jobs = []
    for path in sorted(folder.glob("*/job.json")):
        try:
            jobs.append(Job(**json.loads(path.read_text())))
        except (OSError, ValueError, TypeError) as error:
            log.warning("discrepancy", job=path.parent.name, error=str(error))
    return jobs
