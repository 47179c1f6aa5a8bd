"""A campaign's summary: what its Parquet file says, as facts and as one Markdown page."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from inertial.observability import TERMS
from service.campaign.factors import FACTORS
from service.campaign.spec import Campaign

GROUPS = 4
"""A factor with more levels than twice this is shown in as many groups of equal size."""
WITHIN_SIGMA = 2.0


def summary(spec: Campaign, out: Path) -> dict[str, Any]:
    """Return what a finished campaign's file says."""
    table = pq.read_table(out)
    verdicts = dict(sorted(Counter(table.column("verdict").to_pylist()).items()))
    wall = [name for name in table.column_names if name.startswith("wall_")]
    facts: dict[str, Any] = {
        "study": spec.campaign.study,
        "trials": table.num_rows,
        "verdicts": verdicts,
        "wall_per_trial_s": {name: float(np.mean(_numbers(table, name))) for name in wall},
    }
    if spec.campaign.study == "reanalysis":
        effects = Counter(name for names in table.column("effects").to_pylist() for name in names or [])
        return facts | {"blocks": len(set(table.column("block").to_pylist())), "effects": dict(effects.most_common())}
    facts["terms"] = {name: _term(table, name) for name in TERMS}
    groups = {name: _by_factor(table, name) for name in spec.vary}
    facts["by_factor"] = {name: found for name, found in groups.items() if len(found) > 1}
    return facts


def page(facts: dict[str, Any], name: str) -> str:
    """Return the summary as Markdown."""
    lines = [f"# Campaign {name}", "", f"{facts['trials']} trials, study `{facts['study']}`.", ""]
    lines += _table(["verdict", "trials"], [[verdict, count] for verdict, count in facts["verdicts"].items()])
    if "effects" in facts:
        lines += ["", f"Effects named in the recordings of {facts['blocks']} blocks:", ""]
        lines += _table(["effect", "trials"], [[effect, count] for effect, count in facts["effects"].items()])
    if "terms" in facts:
        lines += ["", "Error of the terms, found less planted (f in mg, g in deg/h), and in their own σ:", ""]
        head = ["term", "bounded", "rms error", "median σ", "rms error in σ", "within 2σ"]
        lines += _table(head, [[term, *_term_cells(term, found)] for term, found in facts["terms"].items()])
    for factor, groups in facts.get("by_factor", {}).items():
        lines += ["", f"By `{factor}`:", ""]
        head = ["from", "to", "trials", "fit", "predicted radial 95 %, m", "rms error in σ (f_z, g)"]
        lines += _table(head, [[_cell(value) for value in group.values()] for group in groups])
    walls = ", ".join(f"{key} {value:.3f} s" for key, value in facts["wall_per_trial_s"].items())
    return "\n".join([*lines, "", f"Mean time of a trial: {walls}.", ""])


def _term(table: pa.Table, name: str) -> dict[str, float | int | None]:
    error = _numbers(table, f"found_{name}") - _numbers(table, f"planted_{name}")
    sigma = _numbers(table, f"sigma_{name}")
    seen = np.isfinite(error) & np.isfinite(sigma) & (sigma > 0.0)
    if not seen.any():
        return {"bounded": 0, "rms_error": None, "median_sigma": None, "rms_in_sigma": None, "within_2_sigma": None}
    share = error[seen] / sigma[seen]
    return {
        "bounded": int(seen.sum()),
        "rms_error": _rms(error[seen]),
        "median_sigma": float(np.median(sigma[seen])),
        "rms_in_sigma": _rms(share),
        "within_2_sigma": float(np.mean(np.abs(share) < WITHIN_SIGMA)),
    }


def _term_cells(term: str, found: dict[str, Any]) -> list[str]:
    unit = 9.80665e-3 if term.startswith("f") else math.pi / 180.0 / 3600.0
    face = [None if found[key] is None else found[key] / unit for key in ("rms_error", "median_sigma")]
    return [_cell(value) for value in (found["bounded"], *face, found["rms_in_sigma"], found["within_2_sigma"])]


def _by_factor(table: pa.Table, name: str) -> list[dict[str, Any]]:
    """Return a row for each level of a factor, or for groups of equal size where there are many."""
    levels = np.array(table.column(name).to_pylist(), dtype=str if isinstance(FACTORS[name].default, str) else float)
    known = np.unique(levels)
    if len(known) <= 2 * GROUPS:
        groups = [(_cell(level), _cell(level), levels == level) for level in known]
    else:
        parts = np.array_split(np.argsort(levels, kind="stable"), GROUPS)
        groups = [(f"{levels[p[0]]:.4g}", f"{levels[p[-1]]:.4g}", np.isin(np.arange(len(levels)), p)) for p in parts]
    fit = np.array(table.column("fit").to_pylist(), dtype=bool)
    radial = _numbers(table, "predicted_radial_95_m")
    shares = np.array([_share(table, term) for term in TERMS[2:]])
    return [
        {
            "from": low,
            "to": high,
            "trials": int(rows.sum()),
            "fit": float(np.mean(fit[rows])),
            "radial_95_m": _median(radial[rows]),
            "rms_in_sigma": _rms_or_none(shares[:, rows]),
        }
        for low, high, rows in groups
    ]


def _share(table: pa.Table, term: str) -> NDArray[np.float64]:
    error = _numbers(table, f"found_{term}") - _numbers(table, f"planted_{term}")
    return np.asarray(error / _numbers(table, f"sigma_{term}"))


def _numbers(table: pa.Table, name: str) -> NDArray[np.float64]:
    """Return a column with NaN where there is nothing."""
    return np.asarray(table.column(name).to_numpy(), dtype=np.float64)


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _rms_or_none(values: NDArray[np.float64]) -> float | None:
    seen = values[np.isfinite(values)]
    return _rms(seen) if seen.size else None


def _median(values: NDArray[np.float64]) -> float | None:
    seen = values[np.isfinite(values)]
    return float(np.median(seen)) if seen.size else None


def _table(head: list[str], rows: list[list[Any]]) -> list[str]:
    cells = [head, ["---"] * len(head), *rows]
    return ["| " + " | ".join(_cell(cell) for cell in row) + " |" for row in cells]


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
