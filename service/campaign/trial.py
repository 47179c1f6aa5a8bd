"""One Monte Carlo trial: a block made, stored, set up, recorded, compensated; what came of it against what was true."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from drivers.recording import Recording
from drivers.recording_meta import BlockMeta, MotionMeta, ReferenceMeta, SiteMeta, TurnMeta, VibrationMeta, WindowMeta
from inertial.documents import BlockModel, EffectEntry, Noise, Result
from inertial.observability import TERMS
from service.campaign.design import levels_of, trial_seed
from service.campaign.factors import FACTORS, Level
from service.campaign.spec import Campaign
from service.compensate import compensate
from service.errors import RefusedInput
from service.experiments.block import BIAS_LAW_MG, MONTHS, STEADY_X, drift
from service.trials import planted, record, trials, worth
from simulators.scenarios import Scenario, ScenarioMeta, demo_model, effect, reference_errors

RATE_HZ = 100.0
GYRO_LAW_DPH = 2.4
"""1σ after 24 months of y and z gyros; x drifts less, and the law over months is that of the experiments."""
TURN_S, TURN_DPS, TURN_SIGMA_DEG = 30.0, 3.0, 0.001
VIBRATION_BAND_HZ = (5.0, 40.0)
REST_BEFORE_S = 1.0

COLUMNS = pa.schema(
    [
        ("trial", pa.int64()),
        *((name, pa.string() if isinstance(one.default, str) else pa.float64()) for name, one in FACTORS.items()),
        ("verdict", pa.string()),
        ("fit", pa.bool_()),
        ("reason", pa.string()),
        *((f"{what}_{term}", pa.float64()) for what in ("planted", "found", "sigma") for term in TERMS),
        ("chi_square", pa.float64()),
        ("predicted_radial_95_m", pa.float64()),
        *((f"radial_{kind}_{terms}_m", pa.float64()) for kind in ("rest", "turn") for terms in ("without", "with")),
        ("wall_simulate_s", pa.float64()),
        ("wall_estimate_s", pa.float64()),
        ("wall_cpu_s", pa.float64()),
    ]
)
"""Terms f in m/s², g in rad/s. ``radial_…`` after 300 s of navigation, where the study asks for it; ``wall_cpu_s``
is processor time, whatever else the machine does."""


def run_trial(spec: Campaign, trial: int, scratch: str | None = None) -> dict[str, Any]:
    """Run one trial; a block that is not fit is a result, and so is a recording that is refused.

    Parameters
    ----------
    spec
        The study.
    trial
        Its number.
    scratch
        Folder for its recording while it runs; default the system's.
    """
    cpu_s = time.process_time()
    levels = levels_of(spec, trial)
    rng = np.random.default_rng(trial_seed(spec.campaign.seed, trial))
    block_seed, noise_seed = (int(number) for number in rng.integers(0, 2**31, 2))
    model = _noisy(demo_model(block_seed), float(levels["noise"]))
    scenario, windows = _set_up(levels, noise_seed, rng)
    row: dict[str, Any] = {"trial": trial, **levels}
    truth = planted(scenario, model)
    row |= {f"planted_{name}": value for name, value in zip(TERMS, _six(truth), strict=True)}
    with tempfile.TemporaryDirectory(prefix="inertrim-trial-", dir=scratch) as folder:
        began = time.perf_counter()
        recording = record(scenario, model, Path(folder) / "run")
        recording = replace(recording, meta=recording.meta.model_copy(update={"window": windows}))
        simulated = time.perf_counter()
        try:
            result = _compensated(recording, levels, model)
            row |= _facts(result)
            if spec.campaign.navigate:
                row |= _navigated(scenario, model, Path(folder), result)
        except RefusedInput as refusal:
            row |= {"verdict": "refused", "fit": False, "reason": str(refusal).replace(folder, "")}
        ended = time.perf_counter()
    walls = {"wall_simulate_s": simulated - began, "wall_estimate_s": ended - simulated}
    return row | walls | {"wall_cpu_s": time.process_time() - cpu_s}


def _six(terms: dict[str, list[float]]) -> list[float]:
    return [*terms["f_mps2"], *terms["g_radps"]]


def _compensated(recording: Recording, levels: dict[str, Level], model: BlockModel) -> Result:
    known = model if levels["noise_source"] == "model" else None
    return compensate(recording, method=str(levels["method"]), model=known)


def _facts(result: Result) -> dict[str, Any]:
    final, sigma = result.terms["final"], result.sigma
    found = zip(TERMS, [*final.f_mps2, *final.g_radps], [*sigma.f_mps2, *sigma.g_radps], strict=True)
    row: dict[str, Any] = {"verdict": result.verdict, "fit": result.fit, "reason": "; ".join(result.reasons)}
    for name, term, spread in found:
        row |= {f"found_{name}": term, f"sigma_{name}": spread}
    if result.verification is not None:
        row["chi_square"] = result.verification["chi_square"]
    if result.budget is not None:
        row["predicted_radial_95_m"] = result.budget["radial_m"]["95"][-1]
    return row


def _navigated(scenario: Scenario, model: BlockModel, folder: Path, result: Result) -> dict[str, Any]:
    errors = worth(trials(scenario, model, folder), result)["radial_error_m"]
    return {f"radial_{kind}_{terms}_m": value for kind, both in errors.items() for terms, value in both.items()}


def _noisy(model: BlockModel, factor: float) -> BlockModel:
    """Return a block whose white noise and flicker are so many times as large."""
    channels = model.noise.model_dump(exclude={"free"})
    louder = {name: {term: value * factor for term, value in terms.items()} for name, terms in channels.items()}
    return model.model_copy(update={"noise": Noise.model_validate(louder)})


def _set_up(levels: dict[str, Level], seed: int, rng: np.random.Generator) -> tuple[Scenario, list[WindowMeta]]:
    """Return the block as storage and the launcher have it, and the windows that its run uses."""
    number = {name: float(level) for name, level in levels.items() if not isinstance(level, str)}
    reference = ReferenceMeta(
        azimuth_deg=number["azimuth_deg"],
        azimuth_sigma_deg=number["azimuth_sigma_deg"],
        roll_deg=number["roll_deg"],
        pitch_deg=number["pitch_deg"],
        level_sigma_deg=number["level_sigma_deg"],
    )
    motion, windows, end_s = _timetable(number)
    scenario = Scenario(
        site=SiteMeta(latitude_deg=number["latitude_deg"], height_m=number["height_m"]),
        reference=reference,
        block=BlockMeta(sample_rate_hz=RATE_HZ, calibration="calibration.json", gyro_kind="dtg"),
        scenario=ScenarioMeta(duration_s=end_s, seed=seed),
        motion=motion,
        effect=[*reference_errors(reference, rng), *_aged(number["storage_months"], rng)],
    )
    return scenario, windows


def _aged(months: float, rng: np.random.Generator) -> list[EffectEntry]:
    """Return what storage did to the six biases."""
    share = drift(months) / drift(MONTHS[-1]) * np.array([STEADY_X, 1.0, 1.0])
    sizes = ((BIAS_LAW_MG, "accel", "mg"), (GYRO_LAW_DPH, "gyro", "deg/h"))
    return [
        effect("bias_shift", f"{kind}_{axis}", shift=(float(value), unit))
        for size, kind, unit in sizes
        for axis, value in zip("xyz", size * share * rng.standard_normal(3), strict=True)
    ]


def _timetable(number: dict[str, float]) -> tuple[list[MotionMeta], list[WindowMeta], float]:
    """Return motions, windows and length [s]: half a stage to align, three stages, one to verify.

    With two attitudes the block turns by 90° about its own z between the second stage and the third.
    """
    stage_s, two = number["stage_s"], number["attitudes"] == 2.0
    motion: list[MotionMeta] = []
    windows: list[WindowMeta] = []
    now_s = REST_BEFORE_S
    lengths: Sequence[tuple[Any, float]] = (
        ("align", 0.5 * stage_s),
        *((f"stage_{k}", stage_s) for k in (1, 2, 3)),
        ("verify", stage_s),
    )
    for kind, length_s in lengths:
        if two and kind == "stage_3":
            motion.append(_turn(now_s))
            now_s += TURN_S + 2.0 * REST_BEFORE_S
        windows.append(WindowMeta(kind=kind, start_s=now_s, end_s=now_s + length_s))
        now_s += length_s
    end_s = math.ceil(now_s + REST_BEFORE_S)
    if number["vibration_grms"] > 0.0:
        motion += _shaken(windows, number["vibration_grms"])
    return sorted(motion, key=lambda one: one.start_s), windows, end_s


def _turn(now_s: float) -> TurnMeta:
    return TurnMeta(
        kind="turn",
        start_s=now_s + REST_BEFORE_S,
        end_s=now_s + REST_BEFORE_S + TURN_S,
        rate_dps=TURN_DPS,
        axis=[0.0, 0.0, 1.0],
        frame="body",
        angle_sigma_deg=TURN_SIGMA_DEG,
    )


def _shaken(windows: Sequence[WindowMeta], grms: float) -> list[MotionMeta]:
    """Return vibration along body x through every window."""
    return [
        VibrationMeta(
            kind="vibration",
            start_s=window.start_s,
            end_s=window.end_s,
            axis=[1.0, 0.0, 0.0],
            grms=grms,
            band_hz=list(VIBRATION_BAND_HZ),
        )
        for window in windows
    ]
