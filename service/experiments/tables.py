"""The experiments' tables as Markdown, ours beside what can be recovered of the paper's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

SENSORS = ("f_xb, mg", "f_yb, mg", "f_zb, mg", "g_xb, deg/h", "g_yb, deg/h", "g_zb, deg/h")
SIZES = ("0.01–0.3 mg",) * 3 + ("small", "of 0.1–3 deg/h", "of 0.1–3 deg/h")
METHODS = ("paper", "optimal")
TERMS = {"none": "without", "paper": "paper", "optimal": "optimal"}


def tables_text(facts: dict[str, Any]) -> str:
    """Return all tables."""
    parts = [
        _terms_table("Table 1: terms before the dynamic test", facts["dynamic"]),
        _errors_table("Radial error at the end of the dynamic test (Fig. 4)", facts["dynamic"]),
        _terms_table("Table 2: terms before the vibration test", facts["vibration"]),
        _errors_table("Radial error at the end of the vibration test (Fig. 5)", facts["vibration"]),
        _third_table(facts["planted_shift"]),
        _third_errors(facts["planted_shift"]),
        _storage_table(facts["storage"]),
    ]
    return "\n".join(parts)


def _terms_table(title: str, test: dict[str, Any]) -> str:
    rows = [
        [
            sensor,
            SIZES[k],
            f"{test['planted'][k]:+.4f}",
            *(f"{test['terms'][method]['final'][k]:+.4f} ± {_sigma(test, method, k)}" for method in METHODS),
        ]
        for k, sensor in enumerate(SENSORS)
    ]
    return _table(title, ["term", "the paper's size", "planted", "paper, stage 3", "optimal"], rows)


def _sigma(test: dict[str, Any], method: str, k: int) -> str:
    sigma = test["terms"][method]["sigma"][k]
    return "unbounded" if sigma is None else f"{sigma:.4f}"


def _errors_table(title: str, test: dict[str, Any]) -> str:
    without = test["navigation"]["none"]["final_radial_m"]
    rows = [
        [TERMS[kind], f"{one['final_radial_m']:.1f} m", f"{without / one['final_radial_m']:.1f}"]
        for kind, one in test["navigation"].items()
    ]
    return _table(title, ["terms", "after 300 s", "factor"], rows)


def _third_table(test: dict[str, Any]) -> str:
    paper = {4: "−0.440 → +1.500"}
    rows = []
    for k, sensor in enumerate(SENSORS):
        cells = []
        for method in METHODS:
            before, after = (test[name]["terms"][method]["final"][k] for name in ("original", "raised"))
            cells.append(f"{before:+.3f} → {after:+.3f} ({after - before:+.4f})")
        rows.append([sensor, paper.get(k, "moves by less than 0.007"), *cells])
    title = "Table 3: terms with gyro y's bias coefficient as it is → raised by 80 % of itself (change)"
    return _table(title, ["term", "the paper's", "paper, stage 3", "optimal"], rows)


def _third_errors(test: dict[str, Any]) -> str:
    rows = []
    for kind, name in TERMS.items():
        for case in ("original", "raised"):
            one = test[case]["navigation"][kind]
            position = ", ".join(f"{value:+.2f}" for value in one["position_m"])
            velocity = ", ".join(f"{value:+.4f}" for value in one["velocity_mps"])
            rows.append([f"{name}, {case}", position, velocity, f"{one['final_radial_m']:.2f}"])
    title = "Table 3: errors after 300 s with vibration along y"
    return _table(title, ["terms, coefficient", "position, m", "velocity, m/s", "radial, m"], rows)


def _storage_table(facts: dict[str, Any]) -> str:
    rows = [
        [f"block {number + 1}", f"{due:+.4f}", *(f"{facts['vertical_term_found_mg'][m][number]:+.4f}" for m in METHODS)]
        for number, due in enumerate(facts["vertical_term_due_mg"])
    ]
    title = "After 24 months: the vertical accelerometer's shift (bias and scale factor) and the term found, mg"
    return _table(title, ["block", "due", *METHODS], rows)


def _table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [f"**{title}**", "", _row(head), _row(["---"] * len(head)), *(_row(row) for row in rows), ""]
    return "\n".join(lines)


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
