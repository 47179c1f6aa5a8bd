"""The navigation error that is left: predicted from the joint covariance of everything the estimate is unsure of.

Errors of the used state (position p, velocity v, attitude ψ with Ĉ = (I + [ψ×])·C, tangent frame) grow along a
reference trajectory as the linearised strapdown equations (:mod:`inertial.strapdown`) say::

    δṗ = δv
    δv̇ = ψ × C·a + C·δa − c·(ω_t × δv + δω_t × v) + (−g·δx/R, −g·δy/R, 2g·δz/R)
    ψ̇ = −ω_t × ψ + C·δg − δω_t

with δa, δg the errors of the terms plus the sensors' noise, δω_t that of the azimuth (eq. 5). Terms, level and azimuth
errors enter jointly: at rest they cancel where the run could not tell them apart, after a turn they do not. Later noise
is counted with its correlation to the noise already in the terms: slow flicker is in both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq
from scipy.special import erf

from inertial.attitude import skew
from inertial.documents import CHANNELS, Noise, Uncertainty
from inertial.earth import Site
from inertial.increment_covariance import integral_covariances
from inertial.observability import TERMS
from inertial.optimal import OptimalEstimate, channel_noises
from inertial.rest_response import AtRest
from inertial.strapdown import CORIOLIS, Navigation

Array = NDArray[np.float64]

_STEP_S = 0.1
_NOISE_SPANS = 200
_CANCELLED = 0.01  # of its parts: what is left of an unseen direction that the same attitude takes out again
_DOCUMENT_SPAN_S = 5.0  # weights run smoothly over minutes: their variance keeps to a per cent
_NO_GAIN = 1e-12
_REACH = 9.0  # σ beyond which a normal variable has no probability to speak of


@dataclass(frozen=True)
class Profile:
    """Reference trajectory: ``time_s`` (n+1,) from 0, ``C_tb`` (n+1, 3, 3), ``velocity_mps`` (n+1, 3) and the mean
    specific force of each step ``force_mps2`` (n, 3), tangent axes.
    """

    time_s: Array
    C_tb: Array
    velocity_mps: Array
    force_mps2: Array

    @classmethod
    def rest(cls, C_tb: ArrayLike, duration_s: float, site: Site) -> Profile:
        """Return a block that stands still."""
        count = max(math.ceil(duration_s), 1)
        return cls.on_the_spot(np.linspace(0.0, duration_s, count + 1), np.tile(C_tb, (count + 1, 1, 1)), site)

    @classmethod
    def on_the_spot(cls, time_s: ArrayLike, C_tb: ArrayLike, site: Site) -> Profile:
        """Return a block that turns (n+1, 3, 3) where it stands."""
        time, attitude = np.asarray(time_s, dtype=np.float64), np.asarray(C_tb, dtype=np.float64)
        force = np.tile([0.0, 0.0, site.gravity_mps2], (len(time) - 1, 1))
        return cls(time, attitude, np.zeros((len(time), 3)), force)

    @classmethod
    def of(cls, navigation: Navigation, site: Site, azimuth_rad: float) -> Profile:
        """Return a navigated trajectory, true or as measured, in steps of 0.1 s or its own where longer."""
        time = navigation.time_s
        rows = np.unique(
            np.searchsorted(time, np.arange(0.0, time[-1] + _STEP_S, _STEP_S) - 1e-9).clip(0, len(time) - 1)
        )
        time, velocity, position = time[rows], navigation.velocity_mps[rows], navigation.position_m[rows]
        middle = 0.5 * (velocity[1:] + velocity[:-1])
        place = 0.5 * (position[1:] + position[:-1]) * (site.gravity_mps2 / site.radius_m)
        gravity = place * np.array([-1.0, -1.0, 2.0]) - np.array([0.0, 0.0, site.gravity_mps2])
        turning = CORIOLIS * np.cross(site.earth_rate_radps(azimuth_rad), middle)
        force = np.diff(velocity, axis=0) / np.diff(time)[:, None] + turning - gravity
        return cls(time - time[0], navigation.C_tb[rows], velocity, force)


@dataclass(frozen=True)
class Errors:
    """What the start of a navigation is unsure of: estimated less true.

    ``order`` names the columns as :class:`inertial.optimal.OptimalEstimate` does. ``sources`` (n, n) each: covariance
    by independent cause. ``unbounded`` (u, n): directions nothing bounds. ``attitude_slope`` (3, n) makes the attitude
    error ψ. ``gain`` (n, 6, m) on the noise integrated over ``spans_s`` (m, 2) makes the part of the errors that later
    noise hangs together with; its covariance is then not among the sources.
    """

    order: tuple[str, ...]
    sources: Mapping[str, Array]
    unbounded: Array
    attitude_slope: Array
    gain: Array | None = None
    spans_s: Array | None = None

    @classmethod
    def of_document(cls, document: Uncertainty) -> Errors:
        """Return the errors that a result speaks of."""
        order = tuple(document.order)
        gain = np.zeros((len(order), len(CHANNELS), len(document.spans_s)))
        for channel, by_name in document.gain.items():
            for name, weights in by_name.items():
                gain[order.index(name), CHANNELS.index(channel)] = weights
        return cls(
            order,
            {name: np.array(part, dtype=np.float64) for name, part in document.sources.items()},
            np.array([[weights.get(name, 0.0) for name in order] for weights in document.unbounded]).reshape(
                -1, len(order)
            ),
            np.array(document.attitude_slope),
            gain,
            np.array(document.spans_s),
        )

    def to_document(self, C_tb: Array, azimuth_rad: float, span_s: float = _DOCUMENT_SPAN_S) -> Uncertainty:
        """Return the errors as a result keeps them, the past noise in spans of about ``span_s``.

        Raises
        ------
        ValueError
            Errors without the noise that made them.
        """
        if self.gain is None or self.spans_s is None:
            raise ValueError("these errors do not tell the noise that made them; give those of an estimate")
        gain, spans = _merged(self.gain, self.spans_s, span_s)
        return Uncertainty(
            order=list(self.order),
            sources={name: part.tolist() for name, part in self.sources.items()},
            unbounded=[
                {name: float(weight) for name, weight in zip(self.order, direction, strict=True) if weight}
                for direction in self.unbounded
            ],
            attitude_slope=self.attitude_slope.tolist(),
            spans_s=[(float(start), float(end)) for start, end in spans],
            gain={
                channel: {
                    name: gain[n, c].tolist()
                    for n, name in enumerate(self.order)
                    if np.max(np.abs(gain[n, c])) > _NO_GAIN * np.max(np.abs(gain[n]))
                }
                for c, channel in enumerate(CHANNELS)
            },
            C_tb=np.asarray(C_tb).tolist(),
            azimuth_rad=azimuth_rad,
        )

    @classmethod
    def of_estimate(cls, estimate: OptimalEstimate, attitude: int = -1) -> Errors:
        """Return what an optimal estimate leaves, at its last attitude unless another is asked for."""
        sources = {name: part for name, part in estimate.sources.items() if not name.startswith("noise of ")}
        slope = estimate.attitude_slope[attitude]
        return cls(estimate.order, sources, estimate.unbounded, slope, estimate.gain, estimate.spans_s)

    @classmethod
    def of_covariance(
        cls, order: Sequence[str], covariance: ArrayLike, unbounded: Sequence[Mapping[str, float]] = ()
    ) -> Errors:
        """Return a joint covariance of terms, level and azimuth errors as a result holds it.

        ``unbounded``: combinations, weights by name, that nothing bounds.
        """
        directions = np.array([[weights.get(name, 0.0) for name in order] for weights in unbounded])
        joint = {"terms and reference": np.asarray(covariance, dtype=np.float64)}
        return cls(tuple(order), joint, directions.reshape(-1, len(order)), _slope(order))

    @classmethod
    def of_chain(
        cls,
        found: AtRest,
        site: Site,
        level_sigma_rad: float,
        azimuth_sigma_rad: float,
        rectified_covariance: ArrayLike | None = None,
    ) -> Errors:
        """Return what the paper's chain leaves: its noise, a reference whose errors the terms took in, and (6, 6) of
        the noise that the sign split rectified.
        """
        order = (*TERMS, "level_1", "level_2", "azimuth")
        C_bt = found.C_tb.T
        earth = site.earth_rate_radps(found.azimuth_rad)
        force = np.array([0.0, 0.0, site.gravity_mps2])
        taken_in = np.zeros((9, 3))
        taken_in[0:3, :2] = (C_bt @ skew(force))[:, :2]
        taken_in[3:6, :2] = (C_bt @ skew(earth))[:, :2]
        taken_in[3:6, 2] = C_bt @ np.cross([0.0, 0.0, 1.0], earth)
        taken_in[6:9] = np.eye(3)
        level = level_sigma_rad**2 * taken_in[:, :2] @ taken_in[:, :2].T
        azimuth = azimuth_sigma_rad**2 * np.outer(taken_in[:, 2], taken_in[:, 2])
        sources = {"level reference": level, "azimuth reference": azimuth}
        if rectified_covariance is not None and np.any(rectified_covariance):
            sources["rectification"] = np.zeros((9, 9))
            sources["rectification"][:6, :6] = rectified_covariance
        duration = found.spans_s[:, 1] - found.spans_s[:, 0]
        gain = np.zeros((9, len(CHANNELS), len(duration)))
        gain[:6] = found.weights.transpose(0, 2, 1) / duration
        return cls(order, sources, _none(order), _slope(order), gain, found.spans_s)


def _merged(gain: Array, spans_s: Array, length_s: float) -> tuple[Array, Array]:
    """Return gain (n, 6, k) and spans (k, 2) of neighbours taken together, each as their mean by duration."""
    duration = spans_s[:, 1] - spans_s[:, 0]
    starts = [0]
    for k in range(1, len(spans_s)):
        gap = spans_s[k, 0] - spans_s[k - 1, 1]
        if gap > 0.1 * length_s or spans_s[k, 1] - spans_s[starts[-1], 0] > 1.001 * length_s:
            starts.append(k)
    ends = [*starts[1:], len(spans_s)]
    total = np.add.reduceat(duration, starts)
    merged = np.add.reduceat(gain * duration, starts, axis=2) / total
    return np.asarray(merged), np.column_stack([spans_s[starts, 0], spans_s[np.array(ends) - 1, 1]])


def _none(order: Sequence[str]) -> Array:
    return np.zeros((0, len(order)))


def _slope(order: Sequence[str]) -> Array:
    slope = np.zeros((3, len(order)))
    for axis, name in enumerate(("level_1", "level_2")):
        if name in order:
            slope[axis, tuple(order).index(name)] = 1.0
    return slope


@dataclass(frozen=True)
class Budget:
    """Predicted error at ``time_s`` (m,): state order position 1, 2, 3 [m], velocity [m/s], attitude ψ [rad].

    ``covariance`` (m, 9, 9); ``unbounded`` (m, 9) where nothing bounds the error; ``sources`` (m, 9, 9) each:
    covariance by independent cause, which add up to it.
    """

    time_s: Array
    covariance: Array
    unbounded: NDArray[np.bool_]
    sources: dict[str, Array] = field(repr=False)

    @property
    def sigma(self) -> Array:
        """Return 1σ (m, 9); inf where nothing bounds it."""
        return np.where(self.unbounded, np.inf, np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))

    def radial_m(self, probability: float) -> Array:
        """Return the distance (m,) from the truth that the position error keeps within, eq. (10)."""
        return self._within(slice(0, 3), probability)

    def horizontal_m(self, probability: float) -> Array:
        """Return the same in the level plane; at one half it is the circular error probable."""
        return self._within(slice(0, 2), probability)

    def speed_mps(self, probability: float) -> Array:
        """Return the same of the velocity error's size."""
        return self._within(slice(3, 6), probability)

    def _within(self, part: slice, probability: float) -> Array:
        found = [radial_quantile(covariance[part, part], probability) for covariance in self.covariance]
        return np.where(np.any(self.unbounded[:, part], axis=1), np.inf, found)

    def contributors(self, most: int = 5) -> list[list[tuple[str, float]]]:
        """Return for each time the causes of the radial position error with their shares of its variance."""
        total = np.trace(self.covariance[:, :3, :3], axis1=1, axis2=2)
        shares = {
            name: np.trace(part[:, :3, :3], axis1=1, axis2=2) / np.maximum(total, 1e-300)
            for name, part in self.sources.items()
        }
        ranked = []
        for k in range(len(self.time_s)):
            causes = sorted(((name, float(share[k])) for name, share in shares.items()), key=lambda cause: -cause[1])
            ranked.append([cause for cause in causes[:most] if cause[1] > 0.001])
        return ranked

    def summary(self) -> dict[str, Any]:
        """Return plain numbers for a document: null where nothing bounds the error; attitude in degrees."""
        sigma = self.sigma
        return {
            "time_s": self.time_s.tolist(),
            "position_sigma_m": _plain(sigma[:, 0:3]),
            "velocity_sigma_mps": _plain(sigma[:, 3:6]),
            "attitude_sigma_deg": _plain(np.degrees(sigma[:, 6:9])),
            "radial_m": {"50": _plain(self.radial_m(0.5)), "95": _plain(self.radial_m(0.95))},
            "cep_m": _plain(self.horizontal_m(0.5)),
            "horizontal_95_m": _plain(self.horizontal_m(0.95)),
            "speed_mps": {"50": _plain(self.speed_mps(0.5)), "95": _plain(self.speed_mps(0.95))},
            "contributors": [[{"cause": name, "share": share} for name, share in row] for row in self.contributors()],
        }


def _plain(values: Array) -> Any:
    if values.ndim > 1:
        return [_plain(row) for row in values]
    return [float(value) if math.isfinite(value) else None for value in values]


def predict(
    errors: Errors,
    profile: Profile,
    site: Site,
    azimuth_rad: float,
    noise: Noise,
    time_s: ArrayLike,
    *,
    after_s: float | None = 0.0,
    coriolis: float = CORIOLIS,
    gravity_gradient: bool = True,
) -> Budget:
    """Predict the error of a navigation along a profile.

    Parameters
    ----------
    errors
        Of terms and reference at the start.
    profile
        Where the block goes, from the attitude that ``errors`` speaks of.
    noise
        Of the sensors from then on.
    time_s
        Times asked for (m,) since the start.
    after_s
        How long after the estimate's last sample the navigation starts; None for another power-up, whose noise has
        nothing to do with the noise in the estimate.

    Raises
    ------
    ValueError
        A time outside the profile.
    """
    asked = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
    if np.any(asked < 0.0) or np.any(asked > profile.time_s[-1] + 1e-9):
        raise ValueError(
            f"asked for the error at {asked.min():g} to {asked.max():g} s, but the profile runs from 0 to "
            f"{profile.time_s[-1]:g} s; ask within it or give a longer one"
        )
    by_errors, by_noise, spans = _sensitivity(errors, profile, site, azimuth_rad, asked, coriolis, gravity_gradient)
    sources = {name: by_errors @ part @ by_errors.transpose(0, 2, 1) for name, part in errors.sources.items()}
    for c, part in enumerate(_noise_parts(errors, by_errors, by_noise, spans, noise, after_s)):
        sources[f"noise of {CHANNELS[c]}"] = part
    covariance = np.asarray(sum(sources.values()))
    return Budget(asked, covariance, _unbounded(errors, by_errors), sources)


def _noise_parts(
    errors: Errors, by_errors: Array, by_noise: Array, spans: Array, noise: Noise, after_s: float | None
) -> list[Array]:
    """Return the covariance (m, 9, 9) that each channel's noise makes, before and after the start together."""
    channels = channel_noises(noise)
    gain, past = errors.gain, errors.spans_s
    if gain is None or past is None:
        later = integral_covariances(channels, spans)
        return [_sandwich(by_noise[:, :, c], part) for c, part in enumerate(later)]
    end = float(past[-1, 1])
    whole = np.einsum("tsn,ncp->tscp", by_errors, gain)
    if after_s is None:
        before = integral_covariances(channels, past, reference_s=end)
        later = integral_covariances(channels, spans)
        return [_sandwich(whole[:, :, c], before[c]) + _sandwich(by_noise[:, :, c], later[c]) for c in range(6)]
    together = np.concatenate([past, spans + end + after_s])
    joint = integral_covariances(channels, together, reference_s=end)
    both = np.concatenate([whole, by_noise], axis=3)
    return [_sandwich(both[:, :, c], joint[c]) for c in range(6)]


def _sandwich(weights: Array, covariance: Array) -> Array:
    return np.asarray(weights @ covariance @ weights.transpose(0, 2, 1))


def _sensitivity(
    errors: Errors,
    profile: Profile,
    site: Site,
    azimuth_rad: float,
    asked: Array,
    coriolis: float,
    gravity_gradient: bool,
) -> tuple[Array, Array, Array]:
    """Return the state at the asked times by the errors (m, 9, n) and by the noise integrated over spans (m, 9, 6, s).

    Each step is integrated to second order with the attitude at its middle; between steps the state is interpolated.
    """
    n = len(errors.order)
    spans = min(len(profile.force_mps2), _NOISE_SPANS)
    edges = np.linspace(0, len(profile.force_mps2), spans + 1).astype(np.int64)
    span_of_step = np.searchsorted(edges, np.arange(len(profile.force_mps2)), side="right") - 1
    span_times = np.column_stack([profile.time_s[edges[:-1]], profile.time_s[edges[1:]]])
    earth = site.earth_rate_radps(azimuth_rad)
    turned = np.cross([0.0, 0.0, 1.0], earth)
    input_of = _inputs(errors.order)
    gradient = site.gravity_mps2 / site.radius_m * np.diag([-1.0, -1.0, 2.0]) * gravity_gradient
    columns = n + 6 * spans
    state = np.zeros((9, columns))
    state[6:9, :n] = errors.attitude_slope
    found = np.empty((len(asked), 9, columns))
    due = list(np.argsort(asked))
    for k in range(len(profile.force_mps2)):
        start, end = profile.time_s[k], profile.time_s[k + 1]
        dt = end - start
        C = 0.5 * (profile.C_tb[k] + profile.C_tb[k + 1])
        velocity = 0.5 * (profile.velocity_mps[k] + profile.velocity_mps[k + 1])
        dynamics = np.zeros((9, 9))
        dynamics[0:3, 3:6] = np.eye(3)
        dynamics[3:6, 0:3] = gradient
        dynamics[3:6, 3:6] = -coriolis * skew(earth)
        dynamics[3:6, 6:9] = -skew(profile.force_mps2[k])
        dynamics[6:9, 6:9] = -skew(earth)
        by_sensor = np.zeros((9, 6))
        by_sensor[3:6, 0:3] = by_sensor[6:9, 3:6] = C
        by_azimuth = np.concatenate([np.zeros(3), -coriolis * np.cross(turned, velocity), -turned])
        held = np.eye(9) * dt + dynamics * (dt**2 / 2.0) + dynamics @ dynamics * (dt**3 / 6.0)
        forward = np.eye(9) + dynamics @ held
        span = span_of_step[k]
        used = n + 6 * (span + 1)
        after = np.zeros_like(state)
        after[:, :used] = forward @ state[:, :used]
        after[:, :n] += held @ (by_sensor @ input_of[:6] + np.outer(by_azimuth, input_of[6]))
        width = span_times[span, 1] - span_times[span, 0]
        after[:, used - 6 : used] += held @ by_sensor / width
        while due and asked[due[0]] <= end + 1e-9:
            share = min(max((asked[due[0]] - start) / dt, 0.0), 1.0)
            found[due.pop(0)] = (1.0 - share) * state + share * after
        state = after
    by_noise = found[:, :, n:].reshape(len(asked), 9, spans, 6).transpose(0, 1, 3, 2)
    return found[:, :, :n], by_noise, span_times


def _inputs(order: Sequence[str]) -> Array:
    """Return the (7, n) that picks the six terms' errors and the azimuth's from the unknowns."""
    rows = np.zeros((7, len(order)))
    for row, name in enumerate((*TERMS, "azimuth")):
        if name in order:
            rows[row, tuple(order).index(name)] = 1.0
    return rows


def _unbounded(errors: Errors, by_errors: Array) -> NDArray[np.bool_]:
    """Return where (m, 9) an unseen direction shows: terms and reference errors that do not cancel in this motion."""
    shows = np.zeros(by_errors.shape[:2], dtype=np.bool_)
    terms = np.array([name in TERMS for name in errors.order])
    for direction in errors.unbounded:
        whole = by_errors @ direction
        parts = np.abs(by_errors @ (direction * terms)) + np.abs(by_errors @ (direction * ~terms))
        for group in (slice(0, 3), slice(3, 6), slice(6, 9)):
            largest = np.max(parts[:, group], axis=1, keepdims=True)
            shows[:, group] |= np.abs(whole[:, group]) > np.maximum(_CANCELLED * largest, 1e-12)
    return shows


# ---- the size of a correlated normal vector ----------------------------------------------------------------------


def radial_quantile(covariance: ArrayLike, probability: float) -> float:
    """Return the radius that a centred normal vector of covariance (k, k), k ≤ 3, keeps within.

    The probability is integrated exactly along the principal axes, whatever their ratio.

    Raises
    ------
    ValueError
        A probability that is not between 0 and 1.
    """
    if not 0.0 < probability < 1.0:
        raise ValueError(f"probability {probability} is not between 0 and 1")
    sigma = np.sqrt(np.maximum(np.linalg.eigvalsh(np.asarray(covariance, dtype=np.float64)), 0.0))
    largest = float(sigma[-1])
    if largest == 0.0:
        return 0.0
    scaled = sigma / largest
    root = brentq(lambda r: radial_probability(scaled, r) - probability, 0.0, 12.0, xtol=1e-10)
    return float(root) * largest


def radial_probability(sigma: ArrayLike, radius: float) -> float:
    """Return the probability that independent normal variables of 1σ ``sigma`` (k,), k ≤ 3, lie within ``radius``.

    The widest goes by the error function, the others by Gauss–Legendre rules over what they reach within the radius;
    the substitution x = reach·sin θ takes away the root at the rim.
    """
    narrow_first = np.sort(np.asarray(sigma, dtype=np.float64))
    *narrow, widest = narrow_first[narrow_first > 1e-9 * narrow_first[-1]]
    square, weight = np.array([radius**2]), np.ones(1)
    for own in narrow:
        reach = np.minimum(np.sqrt(square), _REACH * own)[:, None]
        x = reach * np.sin(_ANGLES)
        density = np.exp(-0.5 * (x / own) ** 2) / (own * math.sqrt(2.0 * math.pi))
        weight = (weight[:, None] * density * reach * np.cos(_ANGLES) * _ANGLE_WEIGHTS).ravel()
        square = np.maximum(square[:, None] - x**2, 0.0).ravel()
    return float(weight @ erf(np.sqrt(square / 2.0) / widest))


_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(80)
_ANGLES, _ANGLE_WEIGHTS = _NODES * (math.pi / 2.0), _NODE_WEIGHTS * (math.pi / 2.0)
