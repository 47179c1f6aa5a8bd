"""Histories of terms: from the store's results, or from a table that somebody brings."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from inertial.ageing import MONTH_DAYS, TermHistories
from inertial.ageing_fleet import TERMS
from inertial.documents import Calibration, DocumentError, Result, parse_document
from service.errors import RefusedInput
from service.run_folder import RunFolder
from service.store import RunRecord, Store

UNITS = {name: "mps2" if name.startswith("f") else "radps" for name in TERMS}
VALUE_COLUMNS = {name: f"{name}_{UNITS[name]}" for name in TERMS}
SIGMA_COLUMNS = {name: f"sigma_{name}_{UNITS[name]}" for name in TERMS}
PAGE = 200


@dataclass(frozen=True)
class Check:
    """One check: months since the laboratory, terms and their 1σ in SI; NaN for what nothing bounds."""

    months: float
    terms: Mapping[str, float]
    sigma: Mapping[str, float]


@dataclass(frozen=True)
class BlockHistory:
    """One block since one calibration. ``epoch``: when that was; None where a table gives months alone."""

    name: str
    epoch: datetime | None
    since: str
    checks: tuple[Check, ...]

    def date(self, months: float) -> str | None:
        """Return the day so many months after the calibration."""
        return None if self.epoch is None else (self.epoch + timedelta(days=months * MONTH_DAYS)).date().isoformat()


def term_histories(blocks: list[BlockHistory]) -> dict[str, tuple[list[str], TermHistories]]:
    """Return by term the blocks that have it with their histories, for :func:`inertial.ageing_fleet.analyse_fleet`."""
    found = {}
    for name in TERMS:
        names, columns = [], []
        for block in blocks:
            seen = [check for check in block.checks if math.isfinite(check.terms[name] + check.sigma[name])]
            if seen:
                names.append(block.name)
                rows = [(check.months, check.terms[name], check.sigma[name]) for check in seen]
                months, values, sigma = np.array(rows, dtype=np.float64).T
                columns.append((months, values, sigma))
        if names:
            found[name] = (names, TermHistories.of(columns))
    return found


# ------------------------------------------------------------------ from the store


class StoreHistories:
    """The history of every block that a store has results of, once for each calibration it had.

    Only results that are fit count. A block is told by its serial number; the calibration by its hash among the
    result's inputs, and its date by the copy in the run's folder. Where that says none, time counts from the first
    check, which ``since`` tells. Each result document is read once.
    """

    def __init__(self, store: Store, runs: Path) -> None:
        self.store = store
        self._runs = runs
        self._hashes: dict[str, str] = {}
        self._trims: dict[str, _Trim | None] = {}
        self._blocks: list[BlockHistory] = []

    def read(self) -> list[BlockHistory]:
        """Return the histories: the same list as before where the store has no other results."""
        hashes = self.store.result_hashes()
        new = sorted(run for run, digest in hashes.items() if self._hashes.get(run) != digest)
        for start in range(0, len(new), PAGE):
            page = self.store.results(new[start : start + PAGE])
            self._trims |= {run.id: _trim(run, document) for run, document in page}
        if new:
            self._blocks = _by_block([trim for trim in self._trims.values() if trim is not None], self._runs)
        self._hashes = hashes
        return self._blocks


@dataclass(frozen=True)
class _Trim:
    """A run with a fit result: what a history needs of it."""

    run: str
    serial: str
    calibration: str
    started: datetime
    terms: Mapping[str, float]
    sigma: Mapping[str, float]


def _trim(run: RunRecord, document: str) -> _Trim | None:
    try:
        result: Result = parse_document(Result, document, f"result of run {run.id}")
    except DocumentError:
        return None  # written by a newer program: its runs are listed, its terms are not ours to read
    if not result.fit:
        return None
    final, sigma = result.terms["final"], result.sigma
    terms = dict(zip(TERMS, [*final.f_mps2, *final.g_radps], strict=True))
    spread = dict(zip(TERMS, [*sigma.f_mps2, *sigma.g_radps], strict=True))
    known = {name: math.nan if value is None else value for name, value in spread.items()}
    started = datetime.fromisoformat(run.started_utc.replace("Z", "+00:00"))
    return _Trim(run.id, _serial(run), result.inputs.get("calibration.json", ""), started, terms, known)


def _serial(run: RunRecord) -> str:
    identity = run.block.get("identity")
    serial = identity.get("serial") if isinstance(identity, dict) else None
    return str(serial or "unknown block")


def _by_block(trims: list[_Trim], runs: Path) -> list[BlockHistory]:
    groups: dict[tuple[str, str], list[_Trim]] = defaultdict(list)
    for trim in sorted(trims, key=lambda trim: trim.started):
        groups[trim.serial, trim.calibration].append(trim)
    latest: dict[str, datetime] = {}
    for (serial, _), found in groups.items():
        latest[serial] = max(latest.get(serial, found[-1].started), found[-1].started)
    histories = []
    for (serial, calibration), found in sorted(groups.items()):
        current = found[-1].started == latest[serial]
        name = serial if current else f"{serial} (calibration {calibration[:8] or 'none'})"
        histories.append(_block(name, found, runs))
    return histories


def _block(name: str, found: list[_Trim], runs: Path) -> BlockHistory:
    calibrated = _calibrated(RunFolder(runs, found[-1].run).path / "calibration.json")
    epoch = calibrated if calibrated is not None and calibrated <= found[0].started else found[0].started
    month = timedelta(days=MONTH_DAYS)
    checks = tuple(Check((trim.started - epoch) / month, trim.terms, trim.sigma) for trim in found)
    return BlockHistory(name, epoch, "calibration" if epoch == calibrated else "first check", checks)


def _calibrated(path: Path) -> datetime | None:
    try:
        text = parse_document(Calibration, path.read_bytes(), str(path)).date
        return datetime.combine(date.fromisoformat(text[:10]), datetime.min.time(), UTC)
    except (OSError, DocumentError, ValueError):
        return None


# ------------------------------------------------------------------ from a table


def history_of_table(path: Path) -> list[BlockHistory]:
    """Read a table of checks, one a row, CSV or Parquet.

    Columns: ``block``, ``months`` (since its calibration) and for each term that is known ``f_x_mps2`` … ``g_z_radps``
    with ``sigma_f_x_mps2`` …; an empty pair is a term that this check could not bound.

    Raises
    ------
    RefusedInput
        Names file, row, column, reason and remedy.
    """
    table = _read(path)
    known = {"block", "months", *VALUE_COLUMNS.values(), *SIGMA_COLUMNS.values()}
    for name in table.column_names:
        if name not in known:
            raise RefusedInput(f"{path}: column {name}", "is none of a history.", f"Known: {', '.join(sorted(known))}.")
    for name in ("block", "months"):
        if name not in table.column_names:
            raise RefusedInput(f"{path}: column {name}", "is missing.", "docs/ageing.md lists the columns.")
    terms = [name for name in TERMS if VALUE_COLUMNS[name] in table.column_names]
    for name in terms:
        if SIGMA_COLUMNS[name] not in table.column_names:
            raise RefusedInput(f"{path}: column {SIGMA_COLUMNS[name]}", "is missing.", "Every term needs its 1σ.")
    if not terms or table.num_rows == 0:
        raise RefusedInput(str(path), "holds no term.", "Give f_x_mps2 … g_z_radps with their sigma_… columns.")
    groups: dict[str, list[Check]] = defaultdict(list)
    for number, row in enumerate(table.to_pylist(), start=1):
        groups[str(row["block"])].append(_row(path, number, row, terms))
    for checks in groups.values():
        checks.sort(key=lambda check: check.months)
    return [BlockHistory(name, None, "calibration", tuple(checks)) for name, checks in sorted(groups.items())]


def _read(path: Path) -> pa.Table:
    try:
        return pa.parquet.read_table(path) if path.suffix == ".parquet" else pa.csv.read_csv(path)
    except (pa.ArrowException, ValueError) as error:
        reason = f"is not a CSV with one header line, nor Parquet: {str(error).splitlines()[0].rstrip('.')}."
        raise RefusedInput(str(path), reason, "Restore it, or export it again.") from None


def _row(path: Path, number: int, row: dict[str, Any], terms: list[str]) -> Check:
    months = _number(path, number, "months", row["months"])
    if not 0.0 <= months < 1200.0:
        raise RefusedInput(f"{path}: row {number}, months", f"{months:g} is no age.", "Months since the calibration.")
    values = dict.fromkeys(TERMS, math.nan)
    sigmas = dict.fromkeys(TERMS, math.nan)
    for name in terms:
        cells = row[VALUE_COLUMNS[name]], row[SIGMA_COLUMNS[name]]
        if None in cells:
            continue
        values[name] = _number(path, number, VALUE_COLUMNS[name], cells[0])
        sigmas[name] = _number(path, number, SIGMA_COLUMNS[name], cells[1])
        if sigmas[name] <= 0.0:
            place = f"{path}: row {number}, {SIGMA_COLUMNS[name]}"
            raise RefusedInput(place, f"{sigmas[name]:g} is no σ.", "Leave both cells empty where nothing bounds it.")
    return Check(months, values, sigmas)


def _number(path: Path, row: int, column: str, cell: Any) -> float:
    if isinstance(cell, bool) or not isinstance(cell, int | float) or not math.isfinite(cell):
        raise RefusedInput(f"{path}: row {row}, {column}", f"{cell!r} is not a number.", "Write a number.")
    return float(cell)
