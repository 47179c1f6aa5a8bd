"""What the terms are worth on real blocks: RMS navigation error over all start times, with and without them.

The terms come from the recording's first 270 s, as `inertrim compensate` chooses its windows. Then the block is
navigated at rest for a minute from every start time, each time from an attitude that it levels anew over the first
30 s. Starts later than what the terms have seen are told apart, and so is the rate that is left on the verify window.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from drivers.recording import Recording, read_recording
from inertial.documents import Result
from service.compensate import compensate
from service.navigate import navigate_recording
from service.physical import Physical

RECORDINGS = Path(__file__).resolve().parents[2] / "shared" / "data" / "recordings"
NAMES = ("rlg_vehicle_quiet", "rlg_vehicle_disturbed")
STEP_S = 2.0
NAVIGATION_S = 60.0
DEG_H_RADPS = math.pi / 180 / 3600
MG_MPS2 = 9.80665e-3


def figures_of(recording: Recording) -> dict[str, Any]:
    """Return one recording's terms, what they leave, and its navigation errors."""
    result = compensate(recording)
    physical = Physical.of(recording)
    seen_until_s = result.windows[-2].end_s
    starts = np.arange(0.0, physical.end_s - NAVIGATION_S, STEP_S)
    errors = {
        "without": np.array([_error_m(recording, None, start) for start in starts]),
        "with": np.array([_error_m(recording, result, start) for start in starts]),
    }
    fresh = starts >= seen_until_s
    return {
        "verdict": result.verdict,
        "reasons": result.reasons,
        "terms": {"f_mg": _scaled(result, "f"), "g_dph": _scaled(result, "g")},
        "left_rate_dph": _left_rate_dph(physical, result),
        "starts": len(starts),
        "rms_m": {name: _rms(values) for name, values in errors.items()},
        "fresh_starts": int(fresh.sum()),
        "fresh_rms_m": {name: _rms(values[fresh]) for name, values in errors.items()},
    }


def _error_m(recording: Recording, result: Result | None, start_s: float) -> float:
    facts = navigate_recording(recording, result, start_s, start_s + NAVIGATION_S)
    return float(facts["radial_m"][-1])


def _rms(values: np.ndarray[Any, Any]) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _scaled(result: Result, kind: str) -> list[float]:
    final = result.terms["final"]
    values, unit = (final.f_mps2, MG_MPS2) if kind == "f" else (final.g_radps, DEG_H_RADPS)
    return [value / unit for value in values]


def _left_rate_dph(physical: Physical, result: Result) -> dict[str, dict[str, list[float]]]:
    """Return what is left of the mean rate beside the Earth's, by body axis, with and without terms."""
    azimuth = math.radians(result.alignment["azimuth_deg"])
    earth = np.array(result.alignment["C_tb"]).T @ physical.site.earth_rate_radps(azimuth)
    terms = np.array(result.terms["final"].g_radps)
    verify = result.windows[-1]
    spans = {"verify": (verify.start_s, verify.end_s), "whole": (physical.start_s, physical.end_s)}
    left = {}
    for name, (start_s, end_s) in spans.items():
        span = physical.span(start_s, end_s)
        raw = span.true(physical.coefficients)[1].sum(axis=0) / span.duration_s - earth
        left[name] = {"without": (raw / DEG_H_RADPS).tolist(), "with": ((raw + terms) / DEG_H_RADPS).tolist()}
    return left


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.real_data", description=__doc__)
    parser.add_argument("--recordings", type=Path, default=RECORDINGS, help="folder of the real recordings")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    present = [name for name in NAMES if (arguments.recordings / f"{name}.parquet").is_file()]
    figures = {name: figures_of(read_recording(arguments.recordings / name)) for name in present}
    rows = [
        [
            name,
            found["verdict"],
            f"{found['rms_m']['without']:.1f} / {found['rms_m']['with']:.1f} m",
            "–"
            if not found["fresh_starts"]
            else f"{found['fresh_rms_m']['without']:.1f} / {found['fresh_rms_m']['with']:.1f} m",
        ]
        for name, found in figures.items()
    ]
    header = ["recording", "verdict", "all start times, without / with terms", "fresh ones"]
    print(json.dumps(figures, indent=2))
    if arguments.json:
        arguments.json.write_text(json.dumps({**figures, "table": {"header": header, "rows": rows}}, indent=2) + "\n")


if __name__ == "__main__":
    main()
