"""Run a campaign on dask.distributed: processes of this machine, or a cluster that is there already.

A task is a chunk of trials, known to its worker by the specification and its numbers; what comes back is one Arrow
table. Few more chunks are on their way than there are workers, so that a billion trials need no more memory than a
thousand. A worker that dies is replaced, and its chunk goes to another, by dask itself.
"""

from __future__ import annotations

import importlib
import logging
import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import pyarrow as pa

from service.campaign.chunks import Chunks
from service.campaign.spec import Campaign
from service.errors import RefusedInput

AHEAD = 2
"""Chunks on their way for each worker."""
KEEP_MEMORY = {"MALLOC_TRIM_THRESHOLD_": str(2**30), "MALLOC_MMAP_THRESHOLD_": str(2**25)}
"""A worker's trials all take the same large arrays: given back to the system after each, their pages must be zeroed
anew, which takes the kernel a third of the time of a trial."""
WORKER = "service.campaign.worker"
"""What each worker imports first."""
DEATHS = 20
"""Workers that may die of one chunk before it is given up: a kill from outside is no fault of the chunk."""
CONNECT_S = 20

Progress = Callable[[int, int], None]


class CampaignFailed(RuntimeError):
    """A campaign cannot go on; the text says why. What was finished is kept."""


@dataclass(frozen=True)
class Done:
    """What a call did: trials in all, how many of them now, in what time, over how many bytes on the line.

    ``rate`` is trials a second once every worker had delivered; None where nothing can be said.
    """

    trials: int
    now: int
    wall_s: float
    workers: int
    bytes_moved: int
    rate: float | None


def run_campaign(
    spec: Campaign,
    out: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Done:
    """Work out what is missing of a campaign and write its Parquet file.

    Parameters
    ----------
    spec
        The study. Each trial's result depends on it and on the trial's number alone.
    out
        The file; ``OUT.parts`` holds the chunks meanwhile. A call that was killed is gone on with.
    workers
        Processes on this machine; default one for each core. Means nothing with ``scheduler``.
    scheduler
        Address of a dask scheduler whose workers have this inertrim installed.
    progress
        Called with trials done and trials in all.

    Raises
    ------
    RefusedInput
        The extra ``cluster`` is missing, the scheduler does not answer, or ``out`` belongs to something else.
    CampaignFailed
        A chunk failed, or killed every worker that tried it.
    """
    chunks = Chunks(spec, out)
    if chunks.finished:
        chunks.clear()  # a kill may have come between the file and this
        return Done(spec.trials, 0, 0.0, 0, 0, None)
    distributed = _distributed()
    with chunks.held():
        return _worked_out(distributed, spec, chunks, workers, scheduler, progress or _silent)


def _worked_out(
    distributed: Any, spec: Campaign, chunks: Chunks, workers: int | None, scheduler: str | None, tell: Progress
) -> Done:
    """Work out the chunks that are missing and put all of them together."""
    before = chunks.trials_done()
    tell(before, spec.trials)
    began, pace, moved, size = time.monotonic(), _Pace(), 0, 0
    if before < spec.trials:
        with _client(distributed, workers, scheduler, chunks.scratch) as client:
            size = max(1, len(client.nthreads()))
            done = before
            for chunk, answer in _answers(distributed, client, spec, chunks):
                chunks.save(chunk, pa.ipc.open_stream(answer).read_all())
                done += chunks.span(chunk)[1]
                moved += len(answer) + len(spec.text())
                pace.count(chunks.span(chunk)[1])
                tell(done, spec.trials)
            pace.workers = size
    chunks.finish()
    return Done(spec.trials, spec.trials - before, time.monotonic() - began, size, moved, pace.rate)


def run_chunk(text: str, first: int, count: int) -> bytes:
    """Work out some trials in order; what a worker does. Returns an Arrow stream."""
    spec = Campaign.model_validate_json(text)
    if spec.campaign.study == "reanalysis":
        from service.campaign.reanalysis import COLUMNS, run_reanalysis

        rows = [run_reanalysis(spec, trial) for trial in range(first, first + count)]
        table = pa.Table.from_pylist(rows, schema=COLUMNS)
    else:
        from service.campaign.trial import COLUMNS, run_trial

        scratch = _scratch()
        rows = [run_trial(spec, trial, scratch) for trial in range(first, first + count)]
        table = pa.Table.from_pylist(rows, schema=COLUMNS)
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    return bytes(sink.getvalue())


def _scratch() -> str | None:
    """Return the folder of the worker that this runs in, which dask clears once the worker has died; None: in none."""
    try:
        return str(importlib.import_module("distributed").get_worker().local_directory)
    except (ImportError, ValueError):
        return None


class _Pace:
    """How fast chunks come once all workers have warmed up: after each has delivered its first."""

    def __init__(self) -> None:
        self.workers = 1
        self._ticks: list[tuple[float, int]] = []

    def count(self, trials: int) -> None:
        self._ticks.append((time.monotonic(), trials))

    @property
    def rate(self) -> float | None:
        if len(self._ticks) < 3 * self.workers:
            return None
        warm = self._ticks[self.workers - 1 :]
        elapsed_s = warm[-1][0] - warm[0][0]
        return sum(trials for _, trials in warm[1:]) / elapsed_s if elapsed_s > 0.0 else None


def _answers(distributed: Any, client: Any, spec: Campaign, chunks: Chunks) -> Iterator[tuple[int, bytes]]:
    """Yield finished chunks as they come, keeping only some on their way."""
    text, todo, name = spec.text(), chunks.missing(), spec.digest()[:16]
    numbers: dict[str, int] = {}

    def submit(chunk: int) -> Any:
        future = client.submit(run_chunk, text, *chunks.span(chunk), key=f"{name}-{chunk}", pure=False)
        numbers[future.key] = chunk
        return future

    first = [submit(chunk) for chunk in islice(todo, AHEAD * max(1, len(client.nthreads())))]
    coming = distributed.as_completed(first, loop=client.loop)
    for future in coming:
        try:
            answer: bytes = future.result()
        except distributed.KilledWorker:
            first_trial, count = chunks.span(numbers[future.key])
            reason = f"{DEATHS} workers died of trials {first_trial} to {first_trial + count - 1}"
            raise CampaignFailed(f"{reason}. Look into their logs; then call again, to go on.") from None
        except Exception as error:
            reason = f"trials from {chunks.span(numbers[future.key])[0]} on: {type(error).__name__}: {error}"
            raise CampaignFailed(f"{reason}. What was finished is kept; call again to go on.") from error
        yield numbers.pop(future.key), answer
        future.release()
        following = next(todo, None)
        if following is not None:
            coming.add(submit(following))


@contextmanager
def _client(distributed: Any, workers: int | None, scheduler: str | None, scratch: Path) -> Iterator[Any]:
    """Give a client of a running cluster: a local one with its files in ``scratch``, or the one at an address."""
    import dask

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what goes wrong is told once, by us
    with ExitStack() as stack:
        settings: dict[str, Any] = {f"distributed.nanny.pre-spawn-environ.{k}": v for k, v in KEEP_MEMORY.items()}
        settings["distributed.worker.preload"] = [WORKER]
        stack.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": DEATHS, **settings}))
        if scheduler is not None:
            yield stack.enter_context(_connected(distributed, scheduler))
            return
        cluster = stack.enter_context(
            distributed.LocalCluster(
                n_workers=workers or os.cpu_count() or 1,
                threads_per_worker=1,
                processes=True,
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
                local_directory=str(scratch),
            )
        )
        yield stack.enter_context(distributed.Client(cluster, set_as_default=False))


def _connected(distributed: Any, scheduler: str) -> Any:
    try:
        distributed.comm.get_address_host_port(scheduler)  # a client that was only half made takes a minute to end
        client = distributed.Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = f"{scheduler} does not answer as a dask scheduler ({error})."
        raise RefusedInput("--scheduler", reason, "Give the address that the scheduler printed, tcp://…") from None
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
    except TimeoutError:
        client.close()
        remedy = f"Start some: dask worker {scheduler} --nthreads 1."
        raise RefusedInput("--scheduler", f"{scheduler} has no workers.", remedy) from None
    return client


def _distributed() -> Any:
    """Return the engine, whose calls carry no types."""
    try:
        return importlib.import_module("distributed")
    except ImportError:
        remedy = "Install the extra: pip install 'inertrim[cluster]'."
        raise RefusedInput("campaign", "needs dask.distributed, which is not installed.", remedy) from None


def _silent(done: int, total: int) -> None:
    """Tell nobody."""
    del done, total
