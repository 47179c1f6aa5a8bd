"""The simulated block of the experiments: a DTG block as in the paper, calibrated once, then stored."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers.recording_meta import BlockMeta, MotionMeta, ReferenceMeta, SiteMeta, TurnMeta, VibrationMeta
from inertial.documents import BlockModel, EffectEntry
from simulators.scenarios import Scenario, ScenarioMeta, demo_model, effect, reference_errors

SEED = 14
REST_S, NAVIGATION_S = 300.0, 300.0
END_S = REST_S + NAVIGATION_S
GYRO_Y_BIAS_DPH = -2.425
"""Coefficient of gyro y: raised by 80 % of itself it moves the term by +1.94 deg/h, as in the paper's Table 3."""
RAISED_BY = 0.8
ACCEL_SHIFT_MG = (0.05, -0.18, 0.27)
GYRO_SHIFT_DPH = (0.12, 0.44, -2.1)
"""What storage did: sizes within those of the paper's tables. Gyro y's makes a term of −0.440 deg/h."""

VIBRATION_GRMS, VIBRATION_BAND_HZ, VIBRATION_S = 6.26, (20.0, 1000.0), 60.0
"""0.04 g²/Hz from 20 to 1000 Hz: the flat part of the minimum integrity profile of MIL-STD-810 method 514, without its
roll-off to 2 kHz. The paper's duration is not recoverable; a minute is ours."""

BLOCKS, MONTHS = 6, (3, 6, 9, 12, 15, 18, 21, 24)
BIAS_LAW_MG, SCALE_LAW_PPM, LAW_MONTHS = 0.30, 60.0, 6.0
STEADY_X = 0.3
"""Drift law: c·ln(1 + months/6), c drawn once a sensor: 1σ after 24 months. x drifts less, as in the paper."""


def model() -> BlockModel:
    """Return the block as the laboratory left it."""
    plain = demo_model(SEED)
    raised = plain.calibration.gyro_y.model_copy(update={"bias_radps": math.radians(GYRO_Y_BIAS_DPH) / 3600.0})
    return plain.model_copy(
        update={"block": "experiments", "calibration": plain.calibration.model_copy(update={"gyro_y": raised})}
    )


def scenario(motion: Sequence[MotionMeta], duration_s: float, effects: Sequence[EffectEntry], seed: int) -> Scenario:
    """Return the block on its table: azimuth to 0.1°, level to 0.003°, their errors drawn."""
    reference = ReferenceMeta(
        azimuth_deg=40.0, azimuth_sigma_deg=0.1, roll_deg=0.0, pitch_deg=0.0, level_sigma_deg=0.003
    )
    errors = reference_errors(reference, np.random.default_rng(SEED))
    return Scenario(
        site=SiteMeta(latitude_deg=35.7, height_m=1200.0),
        reference=reference,
        block=BlockMeta(sample_rate_hz=100.0, calibration="calibration.json", gyro_kind="dtg"),
        scenario=ScenarioMeta(duration_s=duration_s, seed=seed),
        motion=list(motion),
        effect=[*errors, *effects],
    )


def stored() -> list[EffectEntry]:
    """Return what storage did to the block of the three tests."""
    accel = [effect("bias_shift", f"accel_{a}", shift=(v, "mg")) for a, v in zip("xyz", ACCEL_SHIFT_MG, strict=True)]
    gyro = [effect("bias_shift", f"gyro_{a}", shift=(v, "deg/h")) for a, v in zip("xyz", GYRO_SHIFT_DPH, strict=True)]
    return [*accel, *gyro]


def index_turns() -> list[MotionMeta]:
    """Return the table's motion: the index axis by 90° and back, level and with the tilt axis at 90°."""

    def turn(start_s: float, angle_deg: float, *, index: bool) -> TurnMeta:
        axis, frame = ([0.0, 0.0, 1.0], "body") if index else ([1.0, 0.0, 0.0], "tangent")
        rate_dps = math.copysign(3.0, angle_deg)
        return TurnMeta(
            kind="turn",
            start_s=start_s,
            end_s=start_s + abs(angle_deg) / 3.0,
            rate_dps=rate_dps,
            axis=axis,
            frame="body" if frame == "body" else "tangent",
        )

    return [
        turn(REST_S + 20.0, 90.0, index=True),
        turn(REST_S + 70.0, -90.0, index=True),
        turn(REST_S + 120.0, 90.0, index=False),
        turn(REST_S + 170.0, 90.0, index=True),
        turn(REST_S + 220.0, -90.0, index=True),
    ]


def shaken(axis: Sequence[float]) -> list[MotionMeta]:
    """Return the random vibration along a body axis, at the start of navigation; rest before and after."""
    start_s = REST_S + 10.0
    return [
        VibrationMeta(
            kind="vibration",
            start_s=start_s,
            end_s=start_s + VIBRATION_S,
            axis=list(axis),
            grms=VIBRATION_GRMS,
            band_hz=list(VIBRATION_BAND_HZ),
        )
    ]


def drift(months: float) -> float:
    """Return how far the drift law has gone."""
    return math.log1p(months / LAW_MONTHS)


def ageing() -> tuple[np.ndarray, np.ndarray]:
    """Return c of the accelerometers' bias [mg] and positive scale factor [ppm], each (blocks, 3)."""
    rng = np.random.default_rng(SEED + 1)
    share = np.array([STEADY_X, 1.0, 1.0])
    bias = BIAS_LAW_MG / drift(MONTHS[-1]) * rng.standard_normal((BLOCKS, 3)) * share
    scale = SCALE_LAW_PPM / drift(MONTHS[-1]) * rng.standard_normal((BLOCKS, 3)) * share
    return bias, scale
