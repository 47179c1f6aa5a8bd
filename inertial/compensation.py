"""The paper's compensation before launch: three chained stages at rest (eqs 3 to 9).

A stage navigates from the first rotation matrix C₀ and zero velocity through (8), (9) with the terms so far, and looks
at ten equal steps at what should have stayed zero: tangent velocity, and the rotation vector of C·C₀ᵀ. A line through
the origin over the node index, U = [k], k = 0 … 10 (eq. 3), gives a slope each; divided by the node interval, negated
and turned into body axes by C₀ᵀ it is added to the terms. Vertical axis by the normal equation, level axes by singular
value decomposition, as the paper has it. Three such stages in a row: a gyro error tilts the frame and leaks
k·g·ε·T (k = 0.393) into the level accelerometer terms of the stage that finds it, and the next one takes that out.

What the paper leaves open is here too: the covariance. With K the (6, 6) response of a stage's estimate to constant
errors and n the noise, the error of the terms runs ``e ← (I − K)·e − n``, so that the chain's error is one weighted sum
of all noise, exact to first order; beside it stand the reference's errors, which the terms take in at this attitude,
and the noise that unequal S⁺, S⁻ rectify.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inertial.alignment import Alignment
from inertial.attitude import rotation_vector, skew
from inertial.documents import Combination, Noise
from inertial.earth import Site
from inertial.error_model import Coefficients, Terms
from inertial.increments import Increments
from inertial.observability import TERMS, describe, tilt_axes
from inertial.rest_response import AtRest, functional_covariance, node_response
from inertial.strapdown import PAPER_CORIOLIS, navigate

Array = NDArray[np.float64]

NODES = 10
"""Steps of a stage; with the start, 11 rows of nodes (the paper's 11 × 3)."""
_PARTS = 5  # noise spans between two nodes: weights that run linearly keep their variance to 1e-4
_INDEX = np.arange(NODES + 1.0)
_SLOPE = _INDEX / (_INDEX @ _INDEX)  # (UᵀU)⁻¹Uᵀ of eq. (3)
_UNSEEN_SHARE = 0.3  # a sensor that looks this far along a direction nobody bounds has no σ


@dataclass(frozen=True)
class Stage:
    """One stage: the terms after it (total) and what it saw.

    ``nodes`` (11, 6): tangent velocity [m/s] and rotation vector of C·C₀ᵀ [rad], row 0 zero; ``node_s`` (11,) device
    time [s].
    """

    terms: Terms
    nodes: Array
    node_s: Array


@dataclass(frozen=True)
class ChainResult:
    """Terms of the chain with what is known of their errors; order f x, y, z [m/s²], g x, y, z [rad/s], body axes.

    ``noise_covariance`` (6, 6) is what the sensors' noise in the stages left in the terms. ``reference_covariance``
    (6, 6) is what the errors of level and azimuth and the rectified noise put there: it stays the same at the same
    attitude, so navigation at rest does not show it; ``rectified_covariance`` (6, 6) is the rectified noise's share.
    ``weights`` (6, b, 6) on the mean noise over ``spans_s`` (b, 2) make the former (see
    :mod:`inertial.rest_response`).
    """

    stages: tuple[Stage, ...]
    alignment: Alignment
    noise_covariance: Array
    reference_covariance: Array
    rectified_covariance: Array
    unseen: tuple[bool, ...]
    unobservable: tuple[Combination, ...]
    weights: Array
    spans_s: Array
    repaired: int

    @property
    def terms(self) -> Terms:
        """Return the terms after the last stage."""
        return self.stages[-1].terms

    @property
    def covariance(self) -> Array:
        """Return the covariance (6, 6) of the terms' errors; an unbounded term at the size believed of it."""
        return self.noise_covariance + self.reference_covariance

    @property
    def sigma(self) -> list[float | None]:
        """Return 1σ of the six terms, None where nothing bounds the term."""
        deviation = np.sqrt(np.diag(self.covariance))
        return [None if unseen else float(s) for s, unseen in zip(deviation, self.unseen, strict=True)]

    @property
    def at_rest(self) -> AtRest:
        """Return what the terms make of later readings at this attitude, where the reference's errors cancel."""
        alignment = self.alignment
        return AtRest(
            self.terms, alignment.C_tb, alignment.azimuth_rad, self.weights, self.spans_s, offset=np.zeros((6, 6))
        )


def paper_stage(
    window: Increments,
    alignment: Alignment,
    site: Site,
    coefficients: Coefficients,
    terms: Terms | None = None,
    *,
    coriolis: float = PAPER_CORIOLIS,
) -> Stage:
    """Run one stage on one window at rest, starting from C₀ with ``terms`` applied.

    The stage lasts as long as the window; its node interval is a tenth of that. A node falls on the sample that ends
    nearest to its time, and the line is fitted over the samples' own times, which are U = [k] where they fall together.

    Raises
    ------
    ValueError
        A window of fewer than ten samples.
    """
    if len(window) < NODES:
        raise ValueError(f"the stage has {len(window)} samples; it needs at least one for each of its {NODES} nodes")
    terms = terms or Terms.zero()
    dv, dtheta = window.true(coefficients, terms)
    motion = navigate(
        dv,
        dtheta,
        window.interval_s,
        alignment.C_tb,
        site,
        alignment.azimuth_rad,
        coriolis=coriolis,
        gravity_gradient=False,
    )
    node_interval = float(motion.time_s[-1]) / NODES
    rows = _nearest(motion.time_s, node_interval * _INDEX)
    index = motion.time_s[rows] / node_interval
    nodes = np.hstack(
        [
            motion.velocity_mps[rows],
            rotation_vector(motion.C_tb[rows] @ alignment.C_tb.T),
        ]
    )
    slopes = slopes_of_nodes(nodes, index) / node_interval
    found = Terms(-alignment.C_tb.T @ slopes[0:3], -alignment.C_tb.T @ slopes[3:6])
    return Stage(terms + found, nodes, window.start_s + motion.time_s[rows])


def slopes_of_nodes(nodes: Array, index: Array) -> Array:
    """Return the slope (6,) per node interval of each column of ``nodes`` (11, 6) over ``index`` (11,), through zero.

    Least squares on the vertical axis, least squares by singular value decomposition on the level axes (eq. 3).
    """
    slopes = np.linalg.pinv(index[:, None])[0] @ nodes
    vertical = [2, 5]
    slopes[vertical] = (index @ nodes[:, vertical]) / (index @ index)
    return np.asarray(slopes)


def _nearest(time_s: Array, wanted_s: Array) -> NDArray[np.intp]:
    behind = np.clip(np.searchsorted(time_s, wanted_s), 1, len(time_s) - 1)
    return np.where(wanted_s - time_s[behind - 1] <= time_s[behind] - wanted_s, behind - 1, behind)


def paper_chain(
    windows: Sequence[Increments],
    alignment: Alignment,
    site: Site,
    coefficients: Coefficients,
    noise: Noise,
    *,
    coriolis: float = PAPER_CORIOLIS,
) -> ChainResult:
    """Run the stages, one on each window in time order, and propagate noise and reference through them.

    Parameters
    ----------
    windows
        The paper has three of 60 s each; any number and length will do.
    noise
        Of the block, as :func:`inertial.noise.noise_of_block` or its model gives it.

    Raises
    ------
    ValueError
        No window, or one too short.
    """
    if not windows:
        raise ValueError("the chain has no window; give one for each stage")
    stages: list[Stage] = []
    for window in windows:
        terms = stages[-1].terms if stages else None
        stages.append(paper_stage(window, alignment, site, coefficients, terms, coriolis=coriolis))
    weights, spans, gain = _chain_weights(windows, alignment, site, coefficients, coriolis)
    noise_part = functional_covariance(weights, spans, noise, reference_s=float(spans[-1, 1]))
    rectified_part = _rectified_part(windows, coefficients)
    return ChainResult(
        tuple(stages),
        alignment,
        noise_part,
        _reference_part(alignment, site, gain) + rectified_part,
        rectified_part,
        _unseen(alignment, site),
        _unobservable(alignment, site),
        weights,
        spans,
        sum(window.repaired for window in windows),
    )


def reading_sensitivity(windows: Sequence[Increments], coefficients: Coefficients) -> Array:
    """Return ∂(A, G)/∂(a, g) (6, 6) at the windows' readings: each column by how often its reading is positive."""
    readings = np.vstack([np.hstack(window.readings()) for window in windows])
    positive = np.mean(readings > 0.0, axis=0)
    accel, gyro = positive[:3], positive[3:]
    sensitivity = np.zeros((6, 6))
    sensitivity[0:3, 0:3] = coefficients.accel_positive * accel + coefficients.accel_negative * (1.0 - accel)
    sensitivity[3:6, 3:6] = coefficients.gyro_positive * gyro + coefficients.gyro_negative * (1.0 - gyro)
    sensitivity[3:6, 0:3] = coefficients.g_sensitivity
    return sensitivity


def body_to_tangent_pair(C_tb: Array) -> Array:
    """Return the (6, 6) that turns an accelerometer and a gyro triple from body to tangent axes."""
    return np.asarray(np.kron(np.eye(2), C_tb), dtype=np.float64)


def _chain_weights(
    windows: Sequence[Increments], alignment: Alignment, site: Site, coefficients: Coefficients, coriolis: float
) -> tuple[Array, Array, Array]:
    """Return weights (6, b, 6) of the terms' error on the readings' noise, its spans (b, 2), and I − ∏(I − K)."""
    turn = body_to_tangent_pair(alignment.C_tb)
    earth_rate = site.earth_rate_radps(alignment.azimuth_rad)
    sensitivity = reading_sensitivity(windows, coefficients)
    left = np.eye(6)  # what the stages after this one leave of its error
    weights, spans = [], []
    for window in reversed(windows):
        response = node_response(window.duration_s, NODES, _PARTS, site.gravity_mps2, earth_rate, coriolis)
        estimate = np.einsum("k,kjab->jab", _SLOPE[1:], response) * (NODES / window.duration_s)
        estimate = turn.T @ estimate @ turn
        weights.append(-left @ estimate @ sensitivity)
        edges = window.start_s + np.linspace(0.0, window.duration_s, NODES * _PARTS + 1)
        spans.append(np.column_stack([edges[:-1], edges[1:]]))
        left = left @ (np.eye(6) - estimate.sum(axis=0))
    return np.concatenate(weights[::-1]).transpose(1, 0, 2), np.concatenate(spans[::-1]), np.eye(6) - left


def _reference_part(alignment: Alignment, site: Site, gain: Array) -> Array:
    """Return the covariance (6, 6) that a wrong C₀ puts into the terms.

    C₀ = (I + [ψ×])·C gives the errors ψ × (0, 0, γ) and ψ × ω_t, which look like sensor errors and are taken out so.
    """
    looks_like = _attitude_error_rates(site, site.earth_rate_radps(alignment.azimuth_rad))
    taken_in = gain @ body_to_tangent_pair(alignment.C_tb).T @ looks_like
    return np.asarray(taken_in @ alignment.covariance @ taken_in.T)


def _rectified_part(windows: Sequence[Increments], coefficients: Coefficients) -> Array:
    """Return the covariance (6, 6) of the shift that the sign split makes of noise about zero.

    The mean of S⁺u⁺ + S⁻u⁻ exceeds its value at the mean reading m by (S⁺ − S⁻)·(mean(u⁺) − m⁺), which is
    (S⁺ − S⁻)·σ/√(2π) for Gaussian noise about zero. Another environment makes another noise, so it counts as error.
    """
    readings = np.vstack([np.hstack(window.readings()) for window in windows])
    excess = np.mean(np.maximum(readings, 0.0), axis=0) - np.maximum(np.mean(readings, axis=0), 0.0)
    by_sensor = np.zeros((6, 6))
    by_sensor[0:3, 0:3] = (coefficients.accel_positive - coefficients.accel_negative) * excess[:3]
    by_sensor[3:6, 3:6] = (coefficients.gyro_positive - coefficients.gyro_negative) * excess[3:]
    return np.asarray(by_sensor @ by_sensor.T)


def _unseen(alignment: Alignment, site: Site) -> tuple[bool, ...]:
    """Return which of the six terms look along a direction that nothing from outside bounds."""
    unseen = np.zeros((2, 3))
    if alignment.level_source == "accelerometers":
        unseen[0] = np.linalg.norm(alignment.C_tb[0:2], axis=0)
    if alignment.azimuth_source == "gyrocompass":
        unseen[1] = np.abs(_east(alignment, site) @ alignment.C_tb)
    return tuple(bool(share > _UNSEEN_SHARE) for share in unseen.ravel())


def _east(alignment: Alignment, site: Site) -> Array:
    """Return the level direction (3,) across the Earth's rate, in the tangent frame."""
    earth_rate = site.earth_rate_radps(alignment.azimuth_rad)
    across = np.cross(np.array([0.0, 0.0, 1.0]), earth_rate)
    return np.asarray(-across / np.linalg.norm(across))


def _unobservable(alignment: Alignment, site: Site) -> tuple[Combination, ...]:
    """Return in words what the block's own level and azimuth hide: for 1 rad of each, the terms that imitate it."""
    earth_rate = site.earth_rate_radps(alignment.azimuth_rad)
    turns: list[tuple[str, Array]] = []
    if alignment.level_source == "accelerometers":
        turns += [(axis.name, axis.direction) for axis in tilt_axes(alignment.C_tb)]
    if alignment.azimuth_source == "gyrocompass":
        turns.append(("azimuth error", np.array([0.0, 0.0, 1.0])))
    hidden = []
    for name, turn in turns:
        alike = body_to_tangent_pair(alignment.C_tb).T @ _attitude_error_rates(site, earth_rate) @ turn
        weights = {term: float(value) for term, value in zip(TERMS, alike, strict=True) if value}
        text = describe(weights, name, alignment.C_tb, "nothing", math.inf, earth_rate)
        hidden.append(Combination(combination={**weights, name: 1.0}, text=text))
    return tuple(hidden)


def _attitude_error_rates(site: Site, earth_rate: Array) -> Array:
    """Return (6, 3): what tangent force and rate seem wrong by, per rad of C₀'s error (rotation vector)."""
    return -np.vstack([skew(np.array([0.0, 0.0, site.gravity_mps2])), skew(earth_rate)])
