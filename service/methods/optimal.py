"""``optimal``: everything the stages say in one weighted least squares (:mod:`inertial.optimal`)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from drivers.recording_meta import TurnMeta
from inertial.alignment import ACCEL_BIAS_PRIOR_MPS2, GYRO_BIAS_PRIOR_RADPS, Alignment
from inertial.budget import Errors
from inertial.documents import Combination, Observability
from inertial.error_model import Terms
from inertial.optimal import LauncherReference, OptimalEstimate, Priors, Segment, Turn, estimate
from service.methods.material import Findings, Material


class Pooled:
    """The bound's way: stage k is the estimate of all data up to the end of stage k."""

    def stages(self, material: Material) -> list[Terms]:
        """Return the terms after each stage there is so far."""
        return [_up_to(material, stage).terms for stage in range(len(material.windows))]

    def findings(self, material: Material) -> Findings:
        """Return all that the stages say together."""
        last = len(material.windows) - 1
        found = _up_to(material, last)
        earlier = [_up_to(material, stage).terms for stage in range(last)]
        return Findings(
            stages=[*earlier, found.terms],
            order=found.order,
            covariance=found.covariance,
            unseen=found.unseen,
            unobservable=[Combination(combination=one.weights, text=one.text) for one in found.unobservable],
            at_rest=found.at_rest,
            errors=Errors.of_estimate(found),
            noise=found.noise,
            alignment=replace(
                material.alignment,
                C_tb=found.C_tb[-1],
                azimuth_rad=found.azimuth_rad,
                level_sigma_rad=float(np.max(np.sqrt(np.diag(found.covariance)[6:8]))),
                azimuth_sigma_rad=float(np.sqrt(found.covariance[8, 8])),
            ),
            observability=Observability(
                singular_values=found.singular_values.tolist(),
                correlation=found.correlation.tolist(),
                fit=found.fit.tolist(),
            ),
        )


def _up_to(material: Material, last: int) -> OptimalEstimate:
    """Return the estimate of the stages up to one, with the noise that was known then."""
    physical, alignment = material.physical, material.alignment
    segments = [_segment(material, stage) for stage in range(last + 1)]
    reference = LauncherReference.of(alignment, physical.recording.meta.reference.level_frame)
    return estimate(
        segments, physical.site, reference, material.noise[last], physical.coefficients, _beliefs(alignment)
    )


def _segment(material: Material, stage: int) -> Segment:
    """Return a stage's samples as they came, without any that were lost."""
    physical, window = material.physical, material.windows[stage]
    rows = physical.rows(window.start_s, window.end_s)
    samples = physical.recording.samples[rows]
    return Segment(
        np.asarray(samples["time"], dtype=np.float64),
        np.asarray(samples["dv"], dtype=np.float64),
        np.asarray(samples["dtheta"], dtype=np.float64),
        physical.interval_s[rows],
        tuple(_turn(turn) for turn in material.turns_before(stage)),
    )


def _turn(turn: TurnMeta) -> Turn:
    """Return a described turn; an angle without σ counts as exact, as an azimuth or level does."""
    angle_rad = math.radians(turn.rate_dps) * (turn.end_s - turn.start_s)
    return Turn(np.array(turn.axis), angle_rad, turn.frame, math.radians(turn.angle_sigma_deg or 0.0))


def _beliefs(alignment: Alignment) -> Priors:
    """Return what must be believed of the sensors where the block took its level or azimuth from them itself.

    Without it not one term would have a bound: 1 rad of tilt would hide in them. Where launcher says both, none.
    """
    flat = np.full(3, np.inf)
    accel = flat if alignment.level_source == "given" else np.full(3, ACCEL_BIAS_PRIOR_MPS2)
    gyro = flat if alignment.azimuth_source == "given" else np.full(3, GYRO_BIAS_PRIOR_RADPS)
    return Priors(accel, gyro)
