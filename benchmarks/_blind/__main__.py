"""Write hidden cases: `python -m benchmarks._blind --seed S --first 0 --count 10 --cases DIR --truth OTHER_DIR`."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import numpy as np

from benchmarks._blind.cases import Case, make
from drivers.recording import write_recording
from drivers.recording_meta import RecordingMeta
from drivers.samples import empty_samples


def write(case: Case, folder: Path) -> None:
    """Write NAME.parquet, NAME.toml and block.json of a case."""
    samples = empty_samples(len(case.stamps), temperatures=1)
    samples["sequence"], samples["time"] = case.sequence, case.stamps
    increments = case.readings * case.intervals[:, None]
    samples["dv"], samples["dtheta"] = increments[:, :3], increments[:, 3:]
    samples["temperature"][:, 0], samples["supply"] = case.temperature, case.supply
    folder.mkdir(parents=True, exist_ok=True)
    write_recording(folder / "recording", samples, RecordingMeta.model_validate(meta(case)))
    (folder / "block.json").write_text(json.dumps(case.model, indent=2) + "\n")


def meta(case: Case) -> dict[str, object]:
    """What the recording's TOML states."""
    stated, deg, sigma = case.stated, math.degrees, case.plan.sigma
    site = {"latitude_deg": deg(stated.latitude), "height_m": case.height}
    if case.surveyed:
        site["gravity_mps2"] = stated.gravity
    motions: list[dict[str, object]] = [
        {
            "kind": "turn",
            "start_s": turn.start_s,
            "end_s": turn.end_s,
            "rate_dps": deg(turn.rate_radps),
            "axis": list(turn.axis),
            "frame": turn.frame,
            "angle_sigma_deg": deg(turn.angle_sigma_rad),
        }
        for turn in stated.turns
    ]
    motions += [
        {
            "kind": "vibration",
            "start_s": shake.start_s,
            "end_s": shake.end_s,
            "axis": list(shake.axis),
            "grms": shake.grms,
            "band_hz": list(shake.band_hz),
        }
        for shake in stated.shakes
    ]
    return {
        "site": site,
        "reference": {
            "azimuth_deg": deg(stated.azimuth),
            "azimuth_sigma_deg": deg(sigma["azimuth"]),
            "roll_deg": deg(stated.roll),
            "pitch_deg": deg(stated.pitch),
            "heading_deg": deg(stated.heading),
            "level_sigma_deg": deg(sigma["level"]),
            "level_frame": case.plan.level_frame,
        },
        "block": {"sample_rate_hz": float(np.round(1 / case.intervals[0], 6)), "gyro_kind": case.plan.kind},
        "motion": motions,
    }


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks._blind", description=__doc__)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--cases", type=Path, required=True, help="folder of the recordings")
    parser.add_argument("--truth", type=Path, required=True, help="another folder, for what is hidden in them")
    arguments = parser.parse_args()
    if arguments.truth.resolve().is_relative_to(arguments.cases.resolve()):
        parser.error("the truth must not lie in the folder of the recordings")
    arguments.truth.mkdir(parents=True, exist_ok=True)
    for number in range(arguments.first, arguments.first + arguments.count):
        case = make(arguments.seed, number)
        write(case, arguments.cases / f"{number:05d}")
        (arguments.truth / f"{number:05d}.json").write_text(json.dumps(case.truth, indent=2) + "\n")


if __name__ == "__main__":
    main()
