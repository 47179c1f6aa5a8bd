"""Recordings: the samples of a block as ``NAME.parquet`` or ``NAME.csv`` beside what is known of them, ``NAME.toml``.

``docs/recordings.md`` tells how to write such a pair by hand from another maker's log.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from drivers.recording_meta import (
    INCREMENT_COLUMNS,
    TIME_COLUMN,
    ColumnMeta,
    RecordingError,
    RecordingMeta,
    is_known_column,
    likely_meant,
    meta_text,
    name_hint,
    read_meta,
    temperature_index,
)
from drivers.samples import SampleArray, empty_samples, intervals_s
from drivers.summing import summed

__all__ = ["Recording", "RecordingError", "RecordingMeta", "read_recording", "write_recording"]

PIECE = 1 << 15
"""Rows that are read at once of a recording that is too long to be kept whole."""
RATE_TOLERANCE = 0.1
"""Share by which the measured rate may differ from ``sample_rate_hz``: clocks miss by 4 %, wrong units by more."""

Column = NDArray[Any]

_OPTIONAL = {"temperature": "temperature_c", "supply": "supply_v"}


@dataclass(frozen=True)
class Recording:
    """Samples and what is known about them.

    ``path`` is the data file, ``meta_path`` the TOML beside it.
    """

    samples: SampleArray
    meta: RecordingMeta
    path: Path
    meta_path: Path

    @property
    def model_path(self) -> Path | None:
        """The block model that the TOML names, if any."""
        return self._beside(self.meta.block.model)

    @property
    def calibration_path(self) -> Path | None:
        """The calibration that the TOML names, if any."""
        return self._beside(self.meta.block.calibration)

    def require(self, *keys: str) -> None:
        """Refuse the recording where it does not give what an analysis needs, e.g. ``"site.latitude_deg"``.

        Raises
        ------
        RecordingError
            Names the first key that is missing.
        """
        for key in keys:
            section, _, name = key.partition(".")
            if getattr(getattr(self.meta, section), name) is None:
                reason, remedy = (
                    "is missing and needed here",
                    "Add it; docs/recordings.md says what it means and its unit",
                )
                raise RecordingError(self.meta_path, f"[{section}] {name}", reason, remedy)

    def inputs(self) -> dict[str, str]:
        """Return SHA-256 (hex) of every file the recording consists of, by path relative to the TOML's folder."""
        paths = (self.path, self.meta_path, self.model_path, self.calibration_path)
        folder = self.meta_path.parent
        return {Path(os.path.relpath(path, folder)).as_posix(): _sha256(path) for path in paths if path is not None}

    def _beside(self, name: str | None) -> Path | None:
        return None if name is None else self.meta_path.parent / name


def _sha256(path: Path) -> str:
    """Return the SHA-256 (hex) of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_recording(path: Path | str, most_samples: int | None = None) -> Recording:
    """Read a recording, given as NAME, NAME.parquet, NAME.csv or NAME.toml.

    Of one with more than ``most_samples`` rows neighbours are summed to one sample as they are read
    (:mod:`drivers.summing`), so that memory does not grow with its length; a CSV alone is read whole first.

    Raises
    ------
    RecordingError
        Names file, place, reason and remedy for whatever makes the pair unfit to be analysed.
    """
    data_path, meta_path = _find_pair(Path(path))
    meta = read_meta(meta_path)
    for key, name in (("model", meta.block.model), ("calibration", meta.block.calibration)):
        if name is not None and not (meta_path.parent / name).is_file():
            reason = f"there is no file {name} beside the TOML"
            raise RecordingError(meta_path, f"[block] {key}", reason, "Put it there, correct the path or drop the key")
    if most_samples is None or (rows := _count_rows(data_path)) <= most_samples:
        samples = _Table(data_path, _read_columns(data_path), meta, meta_path).samples()
    else:
        together = -(-rows // most_samples)
        samples = summed(_pieces(data_path, meta, meta_path), together)
        block = meta.block.model_copy(update={"sample_rate_hz": meta.block.sample_rate_hz / together})
        meta = meta.model_copy(update={"block": block})
    _check_windows(samples["time"], meta, meta_path)
    return Recording(samples, meta, data_path, meta_path)


def _find_pair(path: Path) -> tuple[Path, Path]:
    """Return data file and TOML of a recording named in any of the four ways."""
    name = str(path)
    base = name.removesuffix(path.suffix) if path.suffix in (".parquet", ".csv", ".toml") else name
    candidates = [Path(base + suffix) for suffix in (".parquet", ".csv")]
    data = [path] if path.suffix in (".parquet", ".csv") else [file for file in candidates if file.is_file()]
    if len(data) > 1:
        raise RecordingError(base, "", "both a .parquet and a .csv bear this name", "Say which by its full name")
    if not data or not data[0].is_file():
        names = " or ".join(str(file) for file in (data or candidates))
        raise RecordingError(
            names, "", "no such file", "Give the name of a recording: NAME.parquet or NAME.csv with NAME.toml"
        )
    meta = Path(base + ".toml")
    if not meta.is_file():
        remedy = "Write it beside the data: site, reference and block, as docs/recordings.md shows"
        raise RecordingError(meta, "", f"no such file, and {data[0].name} says nothing without it", remedy)
    return data[0], meta


def _read_columns(path: Path) -> pa.Table:
    """Read the data file whole."""
    with _readable(path):
        if path.suffix == ".csv":
            table = pa.csv.read_csv(path)
        else:
            with pa.parquet.ParquetFile(path, page_checksum_verification=True) as file:
                table = file.read()
    if table.num_rows < 2:
        reason = f"holds {table.num_rows} sample{'s' * (table.num_rows != 1)}"
        raise RecordingError(path, "", reason, "Give at least two: an interval needs both its ends")
    return table


@contextlib.contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Refuse a data file that Arrow cannot read."""
    try:
        yield
    except (pa.ArrowException, OSError) as error:
        kind = "CSV with one header line" if path.suffix == ".csv" else "whole Parquet file"
        reason = f"is not a {kind}: {str(error).splitlines()[0].rstrip('.')}"
        raise RecordingError(path, "", reason, "It may be cut or damaged: copy or convert it again") from None


def _count_rows(path: Path) -> int:
    """Return how many samples a data file holds, at most: the blank lines of a CSV are counted."""
    with _readable(path):
        if path.suffix != ".csv":
            return int(pa.parquet.read_metadata(path).num_rows)
        with path.open("rb") as file:
            return sum(piece.count(b"\n") for piece in iter(lambda: file.read(1 << 20), b""))


def _tables(path: Path) -> Iterator[pa.Table]:
    """Yield a data file in pieces of some ``PIECE`` rows."""
    if path.suffix == ".csv":
        whole = _read_columns(path)
        for first in range(0, whole.num_rows, PIECE):
            yield whole.slice(first, PIECE)
        return
    # Row groups as they come, not all of one at once.
    slowly = {"pre_buffer": False, "buffer_size": 1 << 20}
    with _readable(path), pa.parquet.ParquetFile(path, page_checksum_verification=True, **slowly) as file:
        for batch in file.iter_batches(PIECE):
            yield pa.Table.from_batches([batch])


def _pieces(path: Path, meta: RecordingMeta, meta_path: Path) -> Iterator[SampleArray]:
    """Yield the samples piece by piece, every value checked, their numbers running through."""
    row, last, number = 0, None, 0
    for piece in _tables(path):
        # With the row before it, a piece is checked as it would be within the whole.
        table = piece if last is None else pa.concat_tables([last, piece])
        if table.num_rows >= 2:
            samples = _Table(path, table, meta, meta_path, row - (last is not None)).samples()
            if "sequence" not in table.column_names:
                samples["sequence"] += np.uint32(number)
            number = int(samples["sequence"][-1])
            yield samples[0 if last is None else 1 :]
        row, last = row + piece.num_rows, table.slice(table.num_rows - 1)


class _Table:
    """Columns of a data file on their way to samples, with the names of places for errors."""

    def __init__(self, path: Path, table: pa.Table, meta: RecordingMeta, meta_path: Path, first_row: int = 0) -> None:
        self.path, self.table, self.meta, self.meta_path, self.first_row = path, table, meta, meta_path, first_row
        self.mapping = {column.to: (name, column) for name, column in meta.columns.items()}
        self._check_names()

    def samples(self) -> SampleArray:
        """Return the samples, every value checked."""
        indices = [index for name in self._names() if (index := temperature_index(name)) is not None]
        samples = empty_samples(self.table.num_rows, temperatures=max(indices, default=0) + 1)
        samples["time"] = self._increasing_time()
        samples["sequence"] = self._sequence(samples["time"])
        interval = intervals_s(samples)
        for index, name in enumerate(INCREMENT_COLUMNS):
            values = self._finite(name)
            if name in self.mapping and self.mapping[name][1].per_second:
                values = values * interval
            samples["dv" if index < 3 else "dtheta"][:, index % 3] = values
        for name in self._names():
            index_or_none = temperature_index(name)
            if index_or_none is not None:
                samples["temperature"][:, index_or_none] = self._finite_or_unknown(name)
        if "supply_v" in self._names():
            samples["supply"] = self._finite_or_unknown("supply_v")
        if "status" in self._names():
            samples["status"] = self._whole("status")
        return samples

    def _names(self) -> list[str]:
        """Return the names of our columns that the file holds or gives by way of [columns]."""
        return [name for name in self.table.column_names if is_known_column(name)] + list(self.mapping)

    def _check_names(self) -> None:
        """Refuse columns missing or there twice, our quantities in other units, and mappings of nothing."""
        present, toml = self.table.column_names, self.meta_path.name
        if twice := {name for name in present if present.count(name) > 1}:
            raise RecordingError(self.path, f"column {min(twice)}", "stands there twice", "Keep one of them")
        for name, column in self.meta.columns.items():
            if name not in present:
                hint = name_hint(name, present)
                raise RecordingError(
                    self.meta_path, f"[columns] {name}", f"{self.path.name} has no such column", _sentence(hint)
                )
            if column.to in present:
                reason = f"gives {column.to}, which {self.path.name} has itself"
                raise RecordingError(self.meta_path, f"[columns] {name}", reason, "Drop one of the two")
        spare = [name for name in present if not is_known_column(name) and name not in self.meta.columns]
        for name in (TIME_COLUMN, *INCREMENT_COLUMNS):
            if name not in self._names():
                meant = likely_meant(name, spare)
                reason = f"is missing; {meant} is perhaps the same in another unit" if meant else "is missing"
                remedy = f"Give it, in that unit, or map another maker's column to it under [columns] in {toml}"
                raise RecordingError(self.path, f"column {name}", reason, remedy)
        for name in spare:
            if known := _OPTIONAL.get(name.rpartition("_")[0]):
                remedy = f"Give {known}, map it under [columns] in {toml}, or drop it"
                raise RecordingError(self.path, f"column {name}", f"is {known} in another unit", remedy)

    def _values(self, name: str) -> Column:
        """Return a column in our unit (a rate still as a rate)."""
        source, column = self.mapping.get(name, (name, ColumnMeta(to=name)))
        raw = self.table.column(source).combine_chunks()
        if not (pa.types.is_floating(raw.type) or pa.types.is_integer(raw.type) or pa.types.is_null(raw.type)):
            self._refuse_text(source, raw)
        values: Column = raw.to_numpy(zero_copy_only=False)
        if values.dtype == object:  # a column without any value
            values = np.full(len(values), np.nan)
        return values if name not in self.mapping else (values.astype(np.float64) - column.offset) * column.scale

    def _refuse_text(self, source: str, raw: Any) -> None:
        """Raise for a column that is not numbers, naming its first cell that is none."""
        for row, cell in enumerate(raw.to_pylist()):
            try:
                float("not a number" if isinstance(cell, bool) else cell)
            except (TypeError, ValueError):
                self._refuse(row, source, f"{cell!r} is not a number", "Write a number with a decimal point there")
        self._refuse(0, source, f"is of type {raw.type}, not numbers", "Store the column as numbers")

    def _finite(self, name: str) -> NDArray[np.float64]:
        """Return a column that must be known everywhere."""
        values = self._values(name).astype(np.float64)
        bad = ~np.isfinite(values)
        if bad.any():
            row = int(np.argmax(bad))
            self._refuse(
                row, name, f"is {values[row]}", "Every sample needs a number: leave the row out where it was lost"
            )
        return values

    def _finite_or_unknown(self, name: str) -> NDArray[np.float64]:
        """Return a column that may be unknown (empty or NaN) in places, yet not infinite."""
        values = self._values(name).astype(np.float64)
        if np.isinf(values).any():
            row = int(np.argmax(np.isinf(values)))
            self._refuse(row, name, "is infinite", "Write a number, or leave the cell empty where it is not known")
        return values

    def _whole(self, name: str) -> NDArray[np.int64]:
        """Return a column of whole numbers from 0 to 2³² - 1."""
        values = self._finite(name)
        bad = (values != np.rint(values)) | (values < 0) | (values > 2**32 - 1)
        if bad.any():
            row = int(np.argmax(bad))
            self._refuse(row, name, f"is {values[row]:g}", "Write a whole number from 0 to 4294967295")
        return values.astype(np.int64)

    def _increasing_time(self) -> NDArray[np.float64]:
        """Return the device time, increasing and at about the stated rate."""
        time_s = self._finite(TIME_COLUMN)
        steps = np.diff(time_s)
        if np.any(steps <= 0):
            row = int(np.argmax(steps <= 0)) + 1
            reason = f"{time_s[row]} s does not come after {time_s[row - 1]} s"
            self._refuse(
                row,
                TIME_COLUMN,
                reason,
                "Put the rows in time order, each time once; a restart of the block is two recordings",
            )
        measured, stated = 1 / float(np.median(steps)), self.meta.block.sample_rate_hz
        if not 1 - RATE_TOLERANCE < measured / stated < 1 + RATE_TOLERANCE:
            reason = f"comes at {measured:.6g} Hz, where {self.meta_path.name} says sample_rate_hz = {stated:g}"
            raise RecordingError(
                self.path, f"column {TIME_COLUMN}", reason, "Give time in seconds, or correct sample_rate_hz"
            )
        return time_s

    def _sequence(self, time_s: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return frame numbers; where there are none, from time, so that a gap in time is a gap in sequence."""
        steps = np.diff(time_s)
        if "sequence" not in self._names():
            return np.concatenate([[0], np.cumsum(np.maximum(np.rint(steps / np.median(steps)), 1))]).astype(np.int64)
        sequence = self._whole("sequence")
        back = np.diff(sequence).astype(np.uint32).astype(np.int32) <= 0  # modulo 2³²: a wrap is a step of one
        if back.any():
            row = int(np.argmax(back)) + 1
            reason = f"{sequence[row]} does not come after {sequence[row - 1]}"
            self._refuse(row, "sequence", reason, "Frame numbers increase; drop the column if the log has none")
        return sequence

    def _refuse(self, row: int, column: str, reason: str, remedy: str) -> None:
        raise RecordingError(self.path, f"{self._row_name(row)}, column {column}", reason, remedy)

    def _row_name(self, row: int) -> str:
        """Return where a row stands: the line of a CSV, the row of a Parquet file counted from 1."""
        row += self.first_row
        if self.path.suffix != ".csv":
            return f"row {row + 1}"
        with self.path.open("rb") as file:  # blank lines count as lines and hold no row
            lines = (number for number, line in enumerate(file, start=1) if line.strip())
            return f"line {next(number for place, number in enumerate(lines) if place == row + 1)}"


def _check_windows(time_s: NDArray[np.float64], meta: RecordingMeta, meta_path: Path) -> None:
    """Refuse windows that the data do not cover."""
    margin = 1.5 * float(np.median(np.diff(time_s)))
    for number, window in enumerate(meta.window, start=1):
        if window.start_s < time_s[0] - margin or window.end_s > time_s[-1] + margin:
            reason = f"{window.start_s:g} to {window.end_s:g} s is not within the data"
            span = f"{time_s[0]:g} to {time_s[-1]:g} s"
            remedy = f"These run from {span}: correct the window, or restore the data if they were cut"
            raise RecordingError(meta_path, f"[[window]] no. {number}", reason, remedy)


def _sentence(text: str) -> str:
    """Return a text with a capital first letter."""
    return text[:1].upper() + text[1:]


def write_recording(path: Path | str, samples: SampleArray, meta: RecordingMeta) -> Path:
    """Write ``NAME.parquet`` and ``NAME.toml``, each whole or not at all, and return the first.

    Every number reads back as it is; ``meta.columns`` has done its work and is not written. ``path`` is NAME with or
    without a suffix, ``.csv`` for CSV in place of Parquet; an old pair is replaced.

    Raises
    ------
    RecordingError
        The folder cannot be written.
    """
    suffix = ".csv" if str(path).endswith(".csv") else ".parquet"
    name = str(path).removesuffix(suffix).removesuffix(".toml")
    data_path, meta_path = Path(name + suffix), Path(name + ".toml")
    table = pa.table(dict(_columns_of(samples)))
    try:
        data_path.parent.mkdir(parents=True, exist_ok=True)
        meta_path.unlink(missing_ok=True)  # a crash between the two must not leave new data beside an old TOML
        with _whole_file(data_path) as temporary:
            if suffix == ".csv":
                pa.csv.write_csv(table, temporary)
            else:
                pa.parquet.write_table(table, temporary, compression="zstd", write_page_checksum=True)
        with _whole_file(meta_path) as temporary:
            temporary.write_text(meta_text(meta), encoding="utf-8")
    except OSError as error:
        reason = f"cannot be written: {error.strerror or error}"
        raise RecordingError(data_path, "", reason, "Give a folder that may be written and has room") from None
    return data_path


def _columns_of(samples: SampleArray) -> Iterator[tuple[str, Column]]:
    """Yield the columns of a recording."""
    yield "sequence", samples["sequence"]
    yield TIME_COLUMN, samples["time"]
    for index, name in enumerate(INCREMENT_COLUMNS):
        yield name, np.ascontiguousarray(samples["dv" if index < 3 else "dtheta"][:, index % 3])
    for index in range(samples["temperature"].shape[1]):
        name = f"temperature_{index}_c" if index else "temperature_c"
        yield name, np.ascontiguousarray(samples["temperature"][:, index])
    yield "supply_v", samples["supply"]
    yield "status", samples["status"]


@contextlib.contextmanager
def _whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary name beside ``path`` and put the file in its place once it is whole and on disk."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
