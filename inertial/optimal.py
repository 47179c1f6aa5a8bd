"""The optimal estimator: every second of every still span in one weighted least squares.

Unknowns are the six additive terms of (8), (9), the level error (2, about tangent axes 1 and 2), the azimuth error and
the angle error of every turn between two attitudes. At rest in attitude i the truth is gravity and Earth rate::

    A = C_bt,i·(0, 0, γ)        G = C_bt,i·ω_t(azimuth)            (eq. 5)

so each sensor's readings, made true by (1), (2), are these less its term, plus noise. Over one attitude that is one
constant a sensor: the generalised least-squares mean of its nodes (1 s integrals, weighted with the exact covariance
of the integrated noise) holds all the data say, and what is left is a small non-linear problem, solved by Gauss–Newton
steps on the singular value decomposition of the whitened rows and priors. Along a direction that nothing bounds the
reference stays as given and the terms take what is seen; it is named (:mod:`inertial.observability`) and its σ is inf.

The additive terms contain the rectification of the sign split, which navigation sees as well; it is counted in σ.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import ndtr

from inertial.alignment import Alignment
from inertial.attitude import rotation_matrix, rotation_vector, skew
from inertial.documents import CHANNELS, ChannelNoise, Noise
from inertial.earth import EARTH_RATE_RADPS, Site
from inertial.error_model import Coefficients, Terms, true_from_readings
from inertial.increment_covariance import integral_covariances
from inertial.observability import TERMS, UNSEEN_RAD, Unseen, correlation, name_unseen, unseen_directions
from inertial.rest_response import AtRest

Array = NDArray[np.float64]

_NODE_S = 1.0
_MOST_NODES = 600
_SMALLEST_SIGMA_RAD = 1e-9  # an angle "known exactly"; keeps its prior row finite
_QUIETEST = (1e-7, 1e-10)  # white noise [m/s²/√Hz], [rad/s/√Hz]: no sensor is quieter, and weights need some
_ITERATIONS = 20
_SEEN_SIGMA = 3.0
_BELIEF = "belief in the terms"


@dataclass(frozen=True)
class Turn:
    """One turn of the launcher between two attitudes: right-handed about ``axis`` (3,), by ``angle_rad``.

    ``frame``: ``"body"`` (inner axis, turns with the block) or ``"tangent"`` (outer axis, fixed in the room).
    """

    axis: Array
    angle_rad: float
    frame: Literal["body", "tangent"]
    sigma_rad: float


@dataclass(frozen=True)
class Segment:
    """One still span: samples as sent, in time order; lost ones are simply not there.

    ``time_s`` (n,) device time at the end of each sample, ``dv_mps``, ``dtheta_rad`` (n, 3) increments,
    ``interval_s`` (n,) device interval of each. ``turns`` brought the block here from the segment before.
    """

    time_s: Array
    dv_mps: Array
    dtheta_rad: Array
    interval_s: Array
    turns: tuple[Turn, ...] = ()


@dataclass(frozen=True)
class LauncherReference:
    """What the launcher says of the block's first attitude, and how sure it is; ``inf`` where it says nothing.

    ``C_tb`` (3, 3) body to tangent, ``azimuth_rad`` of tangent axis 1. ``level_frame``: whether a level error stays
    with the room (``"tangent"``) or rides with the block (``"body"``) when the launcher turns.
    """

    C_tb: Array
    azimuth_rad: float
    level_sigma_rad: float
    azimuth_sigma_rad: float
    level_frame: Literal["tangent", "body"] = "tangent"

    @classmethod
    def of(cls, alignment: Alignment, level_frame: Literal["tangent", "body"] = "tangent") -> LauncherReference:
        """Return an alignment as a reference: what it took from the sensors themselves says nothing from outside."""
        return cls(
            alignment.C_tb,
            alignment.azimuth_rad,
            alignment.level_sigma_rad if alignment.level_source == "given" else math.inf,
            alignment.azimuth_sigma_rad if alignment.azimuth_source == "given" else math.inf,
            level_frame,
        )


def _flat() -> Array:
    return np.full(3, np.inf)


@dataclass(frozen=True)
class Priors:
    """1σ of what the terms are believed to be beforehand, about zero; the default is no belief."""

    f_sigma_mps2: Array = field(default_factory=_flat)
    g_sigma_radps: Array = field(default_factory=_flat)


@dataclass(frozen=True)
class Nodes:
    """One segment made true and summed to nodes.

    ``spans_s`` (m, 2), ``duration_s`` (m,), ``integral`` (m, 6) of true force and rate, ``reading`` (6,) mean and
    ``scatter`` (6,) 1σ of the readings as sent, ``turns`` as in the segment.
    """

    spans_s: Array
    duration_s: Array
    integral: Array
    reading: Array
    scatter: Array
    turns: tuple[Turn, ...]


@dataclass(frozen=True)
class Weights:
    """Generalised least squares of one constant per attitude, for each channel.

    ``mean`` (6, k, m) makes the means from the nodes' integrals; ``covariance`` (6, k, k) is theirs; ``whiten``
    (6, m, m) inverts the Cholesky factor of the nodes' covariance.
    """

    spans_s: Array
    end_s: float
    design: Array
    mean: Array
    covariance: Array
    whiten: Array


@dataclass(frozen=True)
class OptimalEstimate:
    """What the data and the reference say together.

    ``order`` names the unknowns: ``f_x f_y f_z`` [m/s²], ``g_x g_y g_z`` [rad/s], ``level_1 level_2 azimuth``
    and ``turn_1`` … [rad]. ``prior_sigma`` is what was
    believed beforehand; ``value``, ``covariance`` hold what is bounded; ``unbounded`` (u, n) spans what nothing
    bounds (empty as a rule). ``sources`` takes the covariance apart by independent cause. ``gain`` (n, 6, m) makes the
    error from the noise integrated over ``spans_s`` (m, 2), for use where later noise hangs on earlier.
    ``C_tb`` (k, 3, 3), ``azimuth_rad``: the reference with the estimated errors taken out, of every attitude in turn;
    ``attitude_slope`` (k, 3, n): rotation of each in the tangent frame by the unknowns. ``sensitivity`` (k, 6, n): of
    the calibrated readings in each attitude to the unknowns.
    ``fit`` is the reduced χ² of each sensor's nodes about one constant per attitude, on ``fit_degrees`` degrees of
    freedom: far from 1, the block moved or its noise is not what was said.
    """

    terms: Terms
    order: tuple[str, ...]
    value: Array
    prior_sigma: Array
    covariance: Array
    unbounded: Array
    sources: dict[str, Array]
    unobservable: list[Unseen]
    singular_values: Array
    C_tb: Array
    azimuth_rad: float
    attitude_slope: Array
    sensitivity: Array
    reference: LauncherReference
    turns: tuple[Turn, ...]
    gain: Array
    spans_s: Array
    end_s: float
    noise: Noise
    fit: Array
    fit_degrees: int

    @property
    def sigma(self) -> Array:
        """Return 1σ (n,) of every unknown; inf where nothing bounds it."""
        sigma = np.sqrt(np.diag(self.covariance))
        if len(self.unbounded):
            sigma[np.max(np.abs(self.unbounded), axis=0) > 1e-9] = np.inf
        return sigma

    @property
    def unseen(self) -> NDArray[np.bool_]:
        """Return which unknowns (n,) nothing but a belief bounds: no honest σ stands beside those."""
        sigma = self.sigma
        believed = np.diag(self.sources.get(_BELIEF, np.zeros_like(self.covariance))) > 0.5 * sigma**2
        unmoved = sigma > 0.5 * self.prior_sigma
        return np.asarray(np.isinf(sigma) | (believed & (unmoved | np.isinf(self.prior_sigma))))

    @property
    def correlation(self) -> Array:
        """Return the correlation (n, n) of the errors."""
        return correlation(self.covariance)

    @property
    def rest_weights(self) -> Array:
        """Return weights (6, m, 6) on the mean noise over ``spans_s`` that make the error of compensated readings
        at rest in the last attitude: what later navigation there shows of the estimate. The reference's errors cancel.
        """
        duration = self.spans_s[:, 1] - self.spans_s[:, 0]
        return np.asarray(-np.einsum("sn,ncm->smc", self.sensitivity[-1], self.gain) * duration[:, None])

    @property
    def at_rest(self) -> AtRest:
        """Return what the estimate makes of later readings at rest in the last attitude."""
        sensitivity = self.sensitivity[-1]
        parts = self.reference_covariance + self.sources.get(_BELIEF, np.zeros_like(self.covariance))
        offset = sensitivity @ parts @ sensitivity.T
        return AtRest(self.terms, self.C_tb[-1], self.azimuth_rad, self.rest_weights, self.spans_s, offset)

    @property
    def noise_covariance(self) -> Array:
        """Return the part (n, n) of the covariance that fresh data would draw anew."""
        return self._part("noise of ")

    @property
    def reference_covariance(self) -> Array:
        """Return the part (n, n) of the covariance that level, azimuth and turn angles bring in."""
        return self._part(" reference")

    def _part(self, cause: str) -> Array:
        parts = [part for name, part in self.sources.items() if cause in name]
        return np.asarray(sum(parts, np.zeros_like(self.covariance)))


def estimate(
    segments: Sequence[Segment],
    site: Site,
    reference: LauncherReference,
    noise: Noise,
    coefficients: Coefficients,
    priors: Priors | None = None,
) -> OptimalEstimate:
    """Estimate the additive terms and the reference's errors from still spans.

    Parameters
    ----------
    segments
        In time order; those after a turn name it.
    noise
        Of this block: from its model, or ``free``, which says that it was identified from these very data
        (:func:`inertial.noise.noise_of_block`) and goes through :func:`supported_noise`.
    coefficients
        The laboratory's, eqs (1), (2).

    Raises
    ------
    ValueError
        No segment, or one without samples.
    """
    nodes = nodes_of(segments, coefficients)
    noise = supported_noise(nodes, noise) if noise.free else noise
    return estimate_nodes(nodes, node_weights(nodes, noise), site, reference, noise, coefficients, priors)


def estimate_stages(
    segments: Sequence[Segment],
    site: Site,
    reference: LauncherReference,
    noise: Noise,
    coefficients: Coefficients,
    priors: Priors | None = None,
) -> list[OptimalEstimate]:
    """Return the estimates pooled up to each segment in turn; the last is :func:`estimate` of all."""
    nodes = nodes_of(segments, coefficients)
    noise = supported_noise(nodes, noise) if noise.free else noise
    return [
        estimate_nodes(
            nodes[: k + 1], node_weights(nodes[: k + 1], noise), site, reference, noise, coefficients, priors
        )
        for k in range(len(nodes))
    ]


def supported_noise(nodes: Sequence[Nodes], noise: Noise) -> Noise:
    """Leave out of noise that was identified from these very data each random walk that they do not clearly show.

    Fitted to three minutes a walk often comes out large by chance, and would throw away all but the last seconds; left
    out by mistake it costs little. Kept where the restricted likelihood of the nodes asks for it at 3σ.
    """
    spans, design = _layout(nodes)
    integral = np.concatenate([node.integral for node in nodes])
    changed: dict[str, ChannelNoise] = {}
    for c, (name, walking) in enumerate(zip(CHANNELS, channel_noises(noise), strict=True)):
        if walking.random_walk:
            standing = walking.model_copy(update={"random_walk": 0.0})
            both = integral_covariances([walking, standing], spans, reference_s=float(spans[-1, 1]))
            with_walk, without = (_restricted_likelihood(covariance, design, integral[:, c]) for covariance in both)
            if 2.0 * (with_walk - without) < _SEEN_SIGMA**2:
                changed[name] = getattr(noise, name).model_copy(update={"random_walk": 0.0})
    return noise.model_copy(update=changed)


def _restricted_likelihood(covariance: Array, design: Array, values: Array) -> float:
    """Return the log-likelihood of values (m,) with the means of ``design`` (m, k) integrated out (REML)."""
    factor = np.linalg.cholesky(covariance)
    white = solve_triangular(factor, np.column_stack([design, values]), lower=True)
    basis, triangle = np.linalg.qr(white[:, :-1])
    left = white[:, -1] - basis @ (basis.T @ white[:, -1])
    size = np.sum(np.log(np.diag(factor))) + np.sum(np.log(np.abs(np.diag(triangle))))
    return float(-0.5 * left @ left - size)


def _layout(nodes: Sequence[Nodes]) -> tuple[Array, Array]:
    """Return spans (m, 2) and design (m, k): the time each node spent in each attitude."""
    duration = np.concatenate([node.duration_s for node in nodes])
    attitude = np.repeat(_attitude_index(nodes), [len(node.duration_s) for node in nodes])
    design = np.zeros((len(duration), int(attitude[-1]) + 1))
    design[np.arange(len(duration)), attitude] = duration
    return np.vstack([node.spans_s for node in nodes]), design


def nodes_of(segments: Sequence[Segment], coefficients: Coefficients) -> list[Nodes]:
    """Make the readings true, sample by sample as sent, and sum them to nodes of 1 s or, in a long record, more."""
    if not segments or not all(len(segment.time_s) for segment in segments):
        raise ValueError("the estimate needs still spans with samples in them; there is none or an empty one")
    total = sum(float(segment.interval_s.sum()) for segment in segments)
    width = max(_NODE_S, total / _MOST_NODES)
    return [_segment_nodes(segment, coefficients, width) for segment in segments]


def _segment_nodes(segment: Segment, coefficients: Coefficients, width_s: float) -> Nodes:
    interval = segment.interval_s[:, None]
    accel, gyro = segment.dv_mps / interval, segment.dtheta_rad / interval
    true = np.hstack(true_from_readings(accel, gyro, coefficients)) * interval
    readings = np.hstack([accel, gyro])
    begin = segment.time_s - segment.interval_s
    # A sample belongs to the node that its middle lies in; a node without samples does not exist.
    index = ((begin + 0.5 * segment.interval_s - begin[0]) / width_s).astype(np.int64)
    starts = np.flatnonzero(np.diff(index, prepend=-1))
    if len(starts) > 1 and len(segment.time_s) - starts[-1] < 0.5 * width_s / float(np.median(segment.interval_s)):
        starts = starts[:-1]
    duration = np.add.reduceat(segment.interval_s, starts)
    # Where samples are lost the node shrinks about the middle of those it has.
    middle = np.add.reduceat((begin + 0.5 * segment.interval_s) * segment.interval_s, starts) / duration
    spans = np.column_stack([middle - 0.5 * duration, middle + 0.5 * duration])
    return Nodes(
        spans, duration, np.add.reduceat(true, starts), readings.mean(axis=0), readings.std(axis=0), segment.turns
    )


def node_weights(nodes: Sequence[Nodes], noise: Noise) -> Weights:
    """Return the weights of these nodes; those of runs alike in time, turns and noise are the same."""
    spans, design = _layout(nodes)
    end = float(spans[-1, 1])
    shape = (len(CHANNELS), design.shape[1])
    mean, covariance = np.empty((*shape, len(spans))), np.empty((*shape, shape[1]))
    whiten = np.empty((len(CHANNELS), len(spans), len(spans)))
    channels = channel_noises(noise)
    distinct = list(dict.fromkeys(channels))
    for channel, nodes_covariance in zip(distinct, integral_covariances(distinct, spans, reference_s=end), strict=True):
        alike = [c for c, other in enumerate(channels) if other == channel]
        inverse = solve_triangular(np.linalg.cholesky(nodes_covariance), np.eye(len(spans)), lower=True)
        rows = inverse @ design
        whiten[alike] = inverse
        covariance[alike] = np.linalg.inv(rows.T @ rows)
        mean[alike] = covariance[alike] @ rows.T @ inverse
    return Weights(spans, end, design, mean, covariance, whiten)


def channel_noises(noise: Noise) -> list[ChannelNoise]:
    """Return the six channels' noise in order, none quieter than a sensor can be."""
    channels = [getattr(noise, name) for name in CHANNELS]
    return [
        channel.model_copy(update={"white": max(channel.white, _QUIETEST[c // 3])})
        for c, channel in enumerate(channels)
    ]


def _attitude_index(nodes: Sequence[Nodes]) -> NDArray[np.int64]:
    return np.cumsum([k > 0 and len(node.turns) > 0 for k, node in enumerate(nodes)], dtype=np.int64)


def estimate_nodes(
    nodes: Sequence[Nodes],
    weights: Weights,
    site: Site,
    reference: LauncherReference,
    noise: Noise,
    coefficients: Coefficients,
    priors: Priors | None = None,
) -> OptimalEstimate:
    """Estimate from nodes with their weights ready; see :func:`estimate`."""
    turns = [node.turns for node in nodes[1:] if node.turns]
    problem = _Problem(site, reference, turns)
    integral = np.concatenate([node.integral for node in nodes])
    means = np.einsum("ckm,mc->kc", weights.mean, integral)
    whiten = np.linalg.inv(np.linalg.cholesky(weights.covariance))  # (6, k, k)
    sigma = _prior_sigma(reference, priors or Priors(), problem.turns)
    value, sensitivity = problem.solve(means, whiten, sigma)

    rows = _rows(sensitivity, whiten) * problem.scale
    finite = np.isfinite(sigma)
    prior_rows = np.diag(problem.scale / sigma)[finite]
    left, singular, right = _decomposed(np.vstack([rows, prior_rows]))
    bounded = singular * UNSEEN_RAD > 1.0
    inverse = problem.scale[:, None] * (right[bounded].T / singular[bounded]) @ left[:, bounded].T
    unbounded = right[~bounded] * problem.scale
    inverse = _reference_kept(inverse, unbounded)
    # Columns of the inverse: first what one σ of each whitened mean moves, then what one σ of each prior does.
    by_mean = inverse[:, : rows.shape[0]].reshape(len(value), len(CHANNELS), -1)
    to_mean = np.einsum("ncj,cjk->nck", by_mean, whiten)
    sources = _sources(by_mean, inverse[:, rows.shape[0] :], finite, problem.order)
    shift = _rectification(nodes, coefficients)
    moved = np.einsum("nck,kc->n", to_mean, shift)
    if np.any(moved):
        sources["rectification"] = np.outer(moved, moved)
    covariance = np.asarray(sum(sources.values(), np.zeros((len(value), len(value)))))
    covariance = 0.5 * (covariance + covariance.T)
    unseen = unseen_directions(rows[:, :6], rows[:, 6:], sigma[6:]) * problem.scale
    azimuth = reference.azimuth_rad + float(value[8])
    attitudes = problem.attitudes(value)
    names = name_unseen(
        unseen, problem.order, attitudes[0], site.earth_rate_radps(azimuth), covariance, unbounded, list(finite[6:])
    )
    fit, degrees = _fit(integral, means, weights)
    return OptimalEstimate(
        terms=Terms(value[:3].copy(), value[3:6].copy()),
        order=problem.order,
        value=value,
        prior_sigma=sigma,
        covariance=covariance,
        unbounded=unbounded,
        sources=sources,
        unobservable=names,
        singular_values=singular,
        C_tb=attitudes,
        azimuth_rad=azimuth,
        attitude_slope=problem.attitude_slope(value),
        sensitivity=sensitivity,
        reference=reference,
        turns=problem.turns,
        gain=np.einsum("nck,ckm->ncm", to_mean, weights.mean),
        spans_s=weights.spans_s,
        end_s=weights.end_s,
        noise=noise,
        fit=fit,
        fit_degrees=degrees,
    )


def _prior_sigma(reference: LauncherReference, priors: Priors, turns: Sequence[Turn]) -> Array:
    level, azimuth = reference.level_sigma_rad, reference.azimuth_sigma_rad
    angles = np.array([level, level, azimuth, *(turn.sigma_rad for turn in turns)])
    return np.concatenate([priors.f_sigma_mps2, priors.g_sigma_radps, np.maximum(angles, _SMALLEST_SIGMA_RAD)])


def _rows(sensitivity: Array, whiten: Array) -> Array:
    """Whiten (k, 6, n) over the attitudes of each channel into (6·k, n), channel by channel."""
    return np.asarray(np.einsum("cjk,kcn->cjn", whiten, sensitivity).reshape(-1, sensitivity.shape[2]))


def _sources(by_mean: Array, by_prior: Array, finite: NDArray[np.bool_], order: Sequence[str]) -> dict[str, Array]:
    """Take the covariance apart by independent cause."""
    parts = {f"noise of {name}": by_mean[:, c] @ by_mean[:, c].T for c, name in enumerate(CHANNELS)}
    for column, k in enumerate(np.flatnonzero(finite)):
        name = _cause(order[int(k)])
        part = np.outer(by_prior[:, column], by_prior[:, column])
        parts[name] = parts.get(name, 0.0) + part
    return parts


def _cause(unknown: str) -> str:
    if unknown in TERMS:
        return _BELIEF
    return f"{unknown.partition('_')[0] if unknown.startswith('level') else unknown} reference"


def _fit(integral: Array, means: Array, weights: Weights) -> tuple[Array, int]:
    """Return each channel's reduced χ² about its means, and its degrees of freedom."""
    residual = integral - weights.design @ means
    degrees = len(integral) - len(means)
    white = np.einsum("cij,jc->ci", weights.whiten, residual)
    return np.asarray(np.sum(white**2, axis=1) / max(degrees, 1)), degrees


def _rectification(nodes: Sequence[Nodes], coefficients: Coefficients) -> Array:
    """Return by how much the sign split lifts each mean (k, 6): Σ_j (P⁺ − P⁻)_ij·(E[u_j⁺] − ū_j⁺), u_j normal.

    E[u⁺] = ū·Φ(ū/σ) + σ·φ(ū/σ); at ū = 0 that is the σ/√(2π) of the paper's reading.
    """
    split = np.zeros((6, 6))
    split[:3, :3] = coefficients.accel_positive - coefficients.accel_negative
    split[3:, 3:] = coefficients.gyro_positive - coefficients.gyro_negative
    index = _attitude_index(nodes)
    lifted = np.zeros((int(index[-1]) + 1, 6))
    total = np.zeros(len(lifted))
    if not np.any(split):
        return lifted
    for k, node in zip(index, nodes, strict=True):
        mean, sigma = node.reading, np.maximum(node.scatter, 1e-30)
        ratio = mean / sigma
        density = np.exp(-0.5 * ratio**2) / math.sqrt(2.0 * math.pi)
        lift = mean * ndtr(ratio) + sigma * density - np.maximum(mean, 0.0)
        lifted[k] += split @ lift * node.duration_s.sum()
        total[k] += node.duration_s.sum()
    return np.asarray(lifted / total[:, None])


class _Problem:
    """Truth at rest in each attitude as a function of the unknowns, and its solution."""

    def __init__(self, site: Site, reference: LauncherReference, turns: Sequence[tuple[Turn, ...]]) -> None:
        self.site = site
        self.reference = reference
        self.steps = turns
        self.turns = tuple(turn for step in turns for turn in step)
        angles = [f"turn_{k + 1}" for k in range(len(self.turns))]
        self.order = (*TERMS, "level_1", "level_2", "azimuth", *angles)
        # Terms in units of gravity and Earth rate, so that all unknowns are angles of like effect.
        self.scale = np.concatenate(
            [np.full(3, site.gravity_mps2), np.full(3, EARTH_RATE_RADPS), np.ones(3 + len(angles))]
        )

    def attitudes(self, value: Array) -> Array:
        """Return C_tb (k, 3, 3) of every attitude with the errors of ``value`` in."""
        tilt = self._tilt(value)
        nominal = self._nominal(value)[0]
        if self.reference.level_frame == "tangent":
            return np.stack([rotation_matrix(tilt) @ C for C in nominal])
        return np.stack([C @ rotation_matrix(tilt) for C in nominal])

    def attitude_slope(self, value: Array) -> Array:
        """Return d(rotation vector of C_tb in the tangent frame)/d(unknowns) (k, 3, n), by differences."""
        step = 1e-5
        slope = np.zeros((len(self.steps) + 1, 3, len(value)))
        for j in (6, 7, *range(9, len(value))):
            change = np.zeros(len(value))
            change[j] = step
            turned = self.attitudes(value + change) @ self.attitudes(value - change).transpose(0, 2, 1)
            slope[:, :, j] = rotation_vector(turned) / (2.0 * step)
        return slope

    def _tilt(self, value: Array) -> Array:
        """Return the level error as a rotation vector (3,) in the frame it stays in."""
        tilt = np.array([value[6], value[7], 0.0])
        return tilt if self.reference.level_frame == "tangent" else self.reference.C_tb.T @ tilt

    def _nominal(self, value: Array) -> tuple[list[Array], list[list[Array]]]:
        """Return the attitudes without level error, and the derivative of each by every turn's angle error."""
        C = self.reference.C_tb
        slopes: list[Array] = []
        attitudes, derivatives = [C], [[np.zeros((3, 3)) for _ in self.turns]]
        for step in self.steps:
            for turn in step:
                axis = turn.axis / np.linalg.norm(turn.axis)
                turned = rotation_matrix(axis * (turn.angle_rad + value[9 + len(slopes)]))
                if turn.frame == "tangent":
                    slopes = [turned @ slope for slope in slopes]
                    slopes.append(skew(axis) @ turned @ C)
                    C = turned @ C
                else:
                    slopes = [slope @ turned for slope in slopes]
                    slopes.append(C @ turned @ skew(axis))
                    C = C @ turned
            attitudes.append(C)
            derivatives.append(slopes + [np.zeros((3, 3)) for _ in range(len(self.turns) - len(slopes))])
        return attitudes, derivatives

    def predict(self, value: Array) -> tuple[Array, Array]:
        """Return what the coefficients should make of the readings (k, 6), and its derivative (k, 6, n)."""
        azimuth = self.reference.azimuth_rad + value[8]
        gravity = np.array([0.0, 0.0, self.site.gravity_mps2])
        earth = self.site.earth_rate_radps(azimuth)
        turned = np.cross([0.0, 0.0, 1.0], earth)  # derivative of eq. (5) by the azimuth
        tilt = self._tilt(value)
        back, jacobian = rotation_matrix(-tilt), _right_jacobian(-tilt)
        nominal, slopes = self._nominal(value)
        expected = np.empty((len(nominal), 6))
        derivative = np.zeros((len(nominal), 6, len(value)))
        in_room = self.reference.level_frame == "tangent"
        for k, C in enumerate(nominal):
            derivative[k, :, :6] = -np.eye(6)
            for block, vector in ((slice(0, 3), gravity), (slice(3, 6), earth)):
                if in_room:
                    expected[k, block] = C.T @ back @ vector
                    derivative[k, block, 6:8] = (C.T @ back @ skew(vector) @ jacobian)[:, :2]
                else:
                    body = C.T @ vector
                    expected[k, block] = back @ body
                    derivative[k, block, 6:8] = (back @ skew(body) @ jacobian @ self.reference.C_tb.T)[:, :2]
                for j, slope in enumerate(slopes[k]):
                    derivative[k, block, 9 + j] = slope.T @ back @ vector if in_room else back @ slope.T @ vector
            derivative[k, 3:, 8] = C.T @ back @ turned if in_room else back @ C.T @ turned
            expected[k] -= value[:6]
        return expected, derivative

    def solve(self, means: Array, whiten: Array, sigma: Array) -> tuple[Array, Array]:
        """Return the unknowns (n,) that fit the means (k, 6) and priors best, and the sensitivity (k, 6, n) there."""
        value = np.zeros(len(self.order))
        finite = np.isfinite(sigma)
        prior = np.diag(self.scale / sigma)[finite]
        for _ in range(_ITERATIONS):
            expected, sensitivity = self.predict(value)
            rows = np.vstack([_rows(sensitivity, whiten) * self.scale, prior])
            residual = np.einsum("cjk,kc->cj", whiten, means - expected).ravel()
            residual = np.concatenate([residual, -(value / sigma)[finite]])
            left, singular, right = _decomposed(rows)
            kept = singular * UNSEEN_RAD > 1.0
            step = right[kept].T @ ((left[:, kept].T @ residual) / singular[kept])
            before = value
            value = _reference_kept(value + step * self.scale, right[~kept] * self.scale)
            if np.max(np.abs(value - before) / self.scale) < 1e-12:
                break
        return value, self.predict(value)[1]


def _decomposed(rows: Array) -> tuple[Array, Array, Array]:
    """Return the singular value decomposition of (m, n) with n columns and n singular values whatever m is."""
    short = rows.shape[1] - rows.shape[0]
    padded = np.vstack([rows, np.zeros((max(short, 0), rows.shape[1]))])
    left, singular, right = np.linalg.svd(padded, full_matrices=False)
    return left[: len(rows)], singular, right


def _reference_kept(value: Array, unbounded: Array) -> Array:
    """Move (n, ...) along what nothing bounds until the reference's errors are least: as given, terms take the rest."""
    if not len(unbounded):
        return value
    return np.asarray(value - unbounded.T @ (np.linalg.pinv(unbounded[:, 6:].T) @ value[6:]))


def _right_jacobian(rotation_rad: Array) -> Array:
    """Return J (3, 3) with R(φ + dφ) ≈ R(φ)·R(J·dφ)."""
    angle = float(np.linalg.norm(rotation_rad))
    cross = skew(rotation_rad)
    if angle < 1e-4:
        return np.asarray(np.eye(3) - 0.5 * cross + cross @ cross / 6.0)
    first = (1.0 - math.cos(angle)) / angle**2
    second = (angle - math.sin(angle)) / angle**3
    return np.asarray(np.eye(3) - first * cross + second * cross @ cross)
