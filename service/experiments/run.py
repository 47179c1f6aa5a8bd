"""The three tests and the storage sets: simulate, compensate by both methods, navigate, tabulate, draw."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivers.recording import Recording
from drivers.recording_meta import MotionMeta
from inertial.documents import BlockModel, Calibration, Result
from service.compensate import compensate
from service.experiments import block
from service.experiments.figures import Curve, draw
from service.experiments.tables import METHODS, tables_text
from service.navigate import navigate_recording
from service.report import DEG_H_RADPS, MG_MPS2, face_sigma, face_terms
from service.trials import record
from simulators.scenarios import effect, planted_terms

AGE_CHECK_S = 275.0
NAMES = {"none": "without terms", "paper": "paper, three stages", "optimal": "optimal"}


def run_experiments(out: Path) -> dict[str, Any]:
    """Make all tests and write recordings, figures (SVG and plotly HTML), ``tables.md`` and ``experiments.json``.

    Parameters
    ----------
    out
        Folder; made where it does not exist.

    Returns
    -------
    dict
        ``dynamic``, ``vibration``, ``planted_shift``, ``storage``: terms in mg and deg/h with 1σ, and errors in m, m/s.
    """
    out.mkdir(parents=True, exist_ok=True)
    facts: dict[str, Any] = {"storage": storage(out)}
    facts["dynamic"] = rest_and_navigation(out, "dynamic", block.index_turns(), seed=1)
    facts["vibration"] = rest_and_navigation(out, "vibration", block.shaken([1.0, 0.0, 0.0]), seed=2)
    facts["planted_shift"] = planted_shift(out)
    _draw_storage(out, facts["storage"])
    for number, name in ((4, "dynamic"), (5, "vibration")):
        _draw_errors(out, f"fig_{number}", name, facts[name])
    (out / "tables.md").write_text(tables_text(facts), encoding="utf-8")
    (out / "experiments.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    return facts


def rest_and_navigation(out: Path, name: str, motion: Sequence[MotionMeta], seed: int) -> dict[str, Any]:
    """Return one test: 300 s at rest for the terms, then 300 s of navigation with each method's and with none."""
    scenario, model = block.scenario(motion, block.END_S, block.stored(), seed), block.model()
    recording = record(scenario, model, out / name)
    planted = planted_terms(scenario, model)
    return {
        "planted": [*(planted.f_mps2 / MG_MPS2), *(planted.g_radps / DEG_H_RADPS)],
        **_with_each_method(recording),
    }


def _with_each_method(recording: Recording, calibration: Calibration | None = None) -> dict[str, Any]:
    results: dict[str, Result | None] = {"none": None}
    for method in METHODS:
        results[method] = compensate(recording, method=method, start_s=0.0, end_s=block.REST_S, calibration=calibration)
    return {
        "terms": {name: _terms(result) for name, result in results.items() if result is not None},
        "navigation": {name: _navigated(recording, result, calibration) for name, result in results.items()},
    }


def _terms(result: Result) -> dict[str, Any]:
    return {
        "stages": [face_terms(result, stage) for stage in ("stage_1", "stage_2", "stage_3")],
        "final": face_terms(result, "final"),
        "sigma": face_sigma(result),
        "verdict": result.verdict,
        "chi_square": (result.verification or {}).get("chi_square"),
    }


def _navigated(recording: Recording, result: Result | None, calibration: Calibration | None) -> dict[str, Any]:
    facts = navigate_recording(recording, result, block.REST_S, block.END_S, calibration=calibration)
    rows = slice(0, None, 10)  # one a second is enough for a figure
    return {
        "time_s": [time - block.REST_S for time in facts["time_s"][rows]],
        "radial_m": facts["radial_m"][rows],
        "position_m": facts["position_m"][-1],
        "velocity_mps": facts["velocity_mps"][-1],
        "final_radial_m": facts["radial_m"][-1],
    }


def planted_shift(out: Path) -> dict[str, Any]:
    """Return the third test: gyro y's bias coefficient raised by 80 % of itself, vibration along y."""
    model = block.model()
    scenario = block.scenario(block.shaken([0.0, 1.0, 0.0]), block.END_S, block.stored(), seed=3)
    recording = record(scenario, model, out / "planted_shift")
    return {
        "share": block.RAISED_BY,
        "original": _with_each_method(recording),
        "raised": _with_each_method(recording, _raised(model)),
    }


def _raised(model: BlockModel) -> Calibration:
    gyro = model.calibration.gyro_y
    raised = gyro.model_copy(update={"bias_radps": (1.0 + block.RAISED_BY) * gyro.bias_radps})
    return Calibration(coefficients=model.calibration.model_copy(update={"gyro_y": raised}))


def storage(out: Path) -> dict[str, Any]:
    """Return the drift of a set of like blocks, and what a run at its end finds of each block's vertical shift."""
    bias, scale = block.ageing()
    grown = np.array([block.drift(months) for months in block.MONTHS])
    found: dict[str, list[float]] = {method: [] for method in METHODS}
    truth = []
    for number in range(block.BLOCKS):
        aged = [
            entry
            for axis in range(3)
            for entry in (
                effect("bias_shift", f"accel_{'xyz'[axis]}", shift=(bias[number, axis] * grown[-1], "mg")),
                effect("scale_factor", f"accel_{'xyz'[axis]}", error=(scale[number, axis] * grown[-1], "ppm")),
            )
        ]
        scenario = block.scenario([], AGE_CHECK_S, aged, seed=10 + number)
        recording = record(scenario, block.model(), out / "storage")
        truth.append(-float((bias[number, 2] + scale[number, 2] * 1e-3) * grown[-1]))  # 1 g upwards: 1 ppm ≡ 1 µg
        for method in METHODS:
            found[method].append(face_terms(compensate(recording, method=method), "final")[2])
    return {
        "months": list(block.MONTHS),
        "bias_change_mg": (bias[:, :, None] * grown).tolist(),
        "scale_change_ppm": (scale[:, :, None] * grown).tolist(),
        "vertical_term_due_mg": truth,
        "vertical_term_found_mg": found,
    }


def _draw_storage(out: Path, facts: dict[str, Any]) -> None:
    for name, key, unit in (("fig_2", "bias_change_mg", "mg"), ("fig_3", "scale_change_ppm", "ppm")):
        what = "bias" if name == "fig_2" else "positive scale factor"
        curves = [
            Curve(f"block {number + 1}, {axis}", facts["months"], values, group="xyz".index(axis), labelled=number == 0)
            for number, sets in enumerate(facts[key])
            for axis, values in zip("xyz", sets, strict=True)
        ]
        draw(out / name, f"Change of accelerometer {what} in storage, six blocks", "months", unit, curves)


def _draw_errors(out: Path, name: str, test: str, facts: dict[str, Any]) -> None:
    curves = [
        Curve(NAMES[kind], one["time_s"], one["radial_m"], group=index)
        for index, (kind, one) in enumerate(facts["navigation"].items())
    ]
    draw(out / name, f"Radial error, {test} test", "time, s", "m", curves)
