"""A campaign's results on disk: a folder of finished chunks while it runs, one Parquet file when it is done.

Each chunk is a file of its own, put in place whole, so that a kill at any point loses only what was not finished. The
final file is made from the chunks in the order of their trials, whoever worked them out in whatever order.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from service.campaign.spec import Campaign
from service.errors import RefusedInput

KEY = b"inertrim.campaign"
GROUP_ROWS = 50_000
"""Rows that the final file keeps together: what Parquet notes of one group takes more room than ten trials."""


class Chunks:
    """What there is of a campaign under ``OUT.parts``.

    Raises
    ------
    RefusedInput
        ``OUT`` or its parts belong to another campaign.
    """

    def __init__(self, spec: Campaign, out: Path) -> None:
        self._spec, self._out = spec, out
        self._folder = out.with_name(out.name + ".parts")
        self._size = spec.campaign.chunk
        # Another version may compute otherwise: its chunks and ours do not make one result.
        self._facts = {"campaign": spec.digest(), "software": f"inertrim {version('inertrim')}"}
        self.finished = self._is_ours()
        self._check_parts()

    @property
    def scratch(self) -> Path:
        """Return where workers of this machine leave what they need for a moment; it goes with the parts."""
        return self._folder / "scratch"

    @property
    def count(self) -> int:
        """Return how many chunks there are in all."""
        return -(-self._spec.trials // self._size)

    def span(self, chunk: int) -> tuple[int, int]:
        """Return a chunk's first trial and how many it has."""
        first = chunk * self._size
        return first, min(self._size, self._spec.trials - first)

    def missing(self) -> Iterator[int]:
        """Yield the chunks that are still to be worked out."""
        here = {path.name for path in self._folder.glob("*.parquet")}
        return (chunk for chunk in range(self.count) if self._path(chunk).name not in here)

    def trials_done(self) -> int:
        """Return how many trials are finished."""
        return self._spec.trials - sum(self.span(chunk)[1] for chunk in self.missing())

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold the folder of the parts, made anew or gone on with, against every other call.

        The system takes the hold from a call that is killed. A folder without a finished chunk is not left behind.

        Raises
        ------
        RefusedInput
            Another call holds it.
        """
        self._folder.mkdir(exist_ok=True)
        with (self._folder / "lock").open("ab") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                remedy = "Wait for that one, end it, or name another --out."
                raise RefusedInput(str(self._folder), "another call works on this campaign.", remedy) from None
            self._check_parts()
            if not self._mark.is_file():
                content = {**self._facts, "spec": self._spec.model_dump(mode="json")}
                _write_whole(self._mark, json.dumps(content, indent=1).encode())
            try:
                yield
            finally:
                if next(self._folder.glob("*.parquet"), None) is None:
                    self.clear()

    def save(self, chunk: int, table: pa.Table) -> None:
        """Keep a finished chunk."""
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd")
        _write_whole(self._path(chunk), sink.getvalue())

    def finish(self) -> None:
        """Put the chunks together in order, then clear them away."""
        part = self._out.with_name(f".{self._out.name}.part")
        schema = pq.read_schema(self._path(0)).with_metadata({KEY: json.dumps(self._facts, sort_keys=True).encode()})
        with _written(part):
            with pq.ParquetWriter(part, schema, compression="zstd") as writer:
                for group in _groups(pq.read_table(self._path(chunk)) for chunk in range(self.count)):
                    writer.write_table(group.replace_schema_metadata(schema.metadata))
            with part.open("rb") as file:
                os.fsync(file.fileno())
            part.replace(self._out)
        self.finished = True
        self.clear()

    def clear(self) -> None:
        """Clear our parts away; nothing happens where there are none."""
        if self._mark.is_file():
            shutil.rmtree(self._folder, ignore_errors=True)

    @property
    def _mark(self) -> Path:
        return self._folder / "campaign.json"

    def _path(self, chunk: int) -> Path:
        return self._folder / f"{chunk:09d}.parquet"

    def _is_ours(self) -> bool:
        """Return whether ``OUT`` is this campaign's, finished."""
        if not self._out.exists():
            return False
        try:
            found = json.loads((pq.read_schema(self._out).metadata or {}).get(KEY, b"{}"))
        except (pa.ArrowException, OSError, ValueError):
            found = {}
        if found != self._facts:
            remedy = "Name another --out, or move that file away."
            raise RefusedInput(str(self._out), "exists and is not the result of this campaign.", remedy)
        return True

    def _check_parts(self) -> None:
        """Refuse parts that are another's."""
        if not self._mark.is_file():
            return
        found = json.loads(self._mark.read_bytes())
        if any(found.get(name) != fact for name, fact in self._facts.items()):
            remedy = "Go on with the specification it began with, remove that folder, or name another --out."
            raise RefusedInput(str(self._folder), "holds the parts of another campaign or version.", remedy)


def _write_whole(path: Path, content: bytes | pa.Buffer) -> None:
    part = path.with_name(f".{path.name}.part")
    with _written(part):
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)


def _groups(tables: Iterable[pa.Table]) -> Iterator[pa.Table]:
    """Yield the same rows in tables of some ``GROUP_ROWS``, holding no more than one."""
    held: list[pa.Table] = []
    rows = 0
    for table in tables:
        held.append(table)
        rows += len(table)
        if rows >= GROUP_ROWS:
            yield pa.concat_tables(held).combine_chunks()
            held, rows = [], 0
    if held:
        yield pa.concat_tables(held).combine_chunks()


@contextmanager
def _written(part: Path) -> Iterator[None]:
    """Say what to do where the disk does not take a file, and leave no half of it."""
    try:
        yield
    except OSError as error:
        part.unlink(missing_ok=True)
        remedy = "Make room, then call again: what was finished is kept."
        raise RefusedInput(str(part), f"cannot be written ({error.strerror or error}).", remedy) from None
