"""Levelling and gyrocompassing on a moving launcher: sway, wind and footsteps average out.

The gyros freeze the body axes of one instant in inertial space; specific force integrated twice in those axes is a path
along which gravity, turning with the Earth, leaves a curve of known shape. Sway bends it by no more than the launcher
moved, however long the window, so that the attitude follows from the curve as a whole (the inertial-frame alignment of
Qin Yongyuan, there with two velocity vectors; here every node of the path in one weighted least squares). With ``n``
the tangent axes (north, west, up) that stop turning with the Earth at the window's end, ``t`` the time before it::

    C_nb·p_b = g·u − φ × g·u + p₀ + v₀·t + U·b + (−ε_2, ε_1, 0)·g·t³/6 + noise,    U = ∫∫C_nt,  u = U·(0, 0, 1)

``p_b`` is the path, φ the attitude error, ``b`` accelerometer and ε gyro errors in tangent axes. A level ``b`` tilts
the level it finds and turns the azimuth by tan L·b/g, a westward ε turns it by ε/(Ω·cos L): no record at one attitude
tells them apart, so they stay in the covariance with the σ given for them. The noise is a sum of four kinds (sway,
slow shifts of the launcher, accelerometer and gyro white noise) whose sizes the record itself gives, by restricted
maximum likelihood (Patterson & Thompson 1971). Sensor noise is badly seen there: give it where it is known. Where not,
the boundary-avoiding prior of Chung et al. (Psychometrika 78, 2013) keeps it from being taken for absent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from inertial.alignment import ACCEL_BIAS_PRIOR_MPS2, GYRO_BIAS_PRIOR_RADPS, Alignment, Reference
from inertial.attitude import body_to_tangent, matrix_of_quaternion, roll_pitch_heading, rotation_matrix, skew
from inertial.documents import Noise
from inertial.earth import EARTH_RATE_RADPS, Site
from inertial.error_model import Coefficients, Terms
from inertial.increments import Increments
from inertial.strapdown import integrate

Array = NDArray[np.float64]
SHORTEST_S = 10.0
"""Below this the Earth has turned too little for any block."""
_MOST_NODES = 60
_MOST_BUMPS = 4
_BUMP_GATE = 4.5  # one node in 100,000 without a bump


@dataclass(frozen=True)
class InertialAlignment:
    """Attitude at the end of the window in tangent axes north, west, up (azimuth 0), and what the launcher did.

    ``covariance`` (3, 3) [rad²] of φ with ``C_tb,true = exp(φ)·C_tb``. ``sway_m`` is the unsteadiness from node to
    node, ``shift_m`` the slow wandering in the whole window, ``velocity_random_walk`` [m/s/√s] and
    ``angle_random_walk`` [rad/√s] what the sensors add; ``bumps_s`` the times before the end at which the launcher
    jumped, ``residual_m`` (2,) what is left of the level path, rms north and west.
    """

    C_tb: Array
    covariance: Array
    sway_m: float
    shift_m: float
    velocity_random_walk: float
    angle_random_walk: float
    bumps_s: tuple[float, ...]
    residual_m: Array

    @property
    def azimuth_rad(self) -> float:
        """Return the azimuth of body x, clockwise from north, from 0 to 2π."""
        return roll_pitch_heading(self.C_tb)[2] % math.tau

    @property
    def azimuth_sigma_rad(self) -> float:
        """Return 1σ of the azimuth."""
        return math.sqrt(float(self.covariance[2, 2]))

    @property
    def level_sigma_rad(self) -> float:
        """Return 1σ of the worse level."""
        return math.sqrt(float(np.linalg.eigvalsh(self.covariance[:2, :2])[-1]))


def inertial_alignment(
    window: Increments,
    coefficients: Coefficients,
    site: Site,
    reference: Reference,
    noise: Noise,
    *,
    terms: Terms | None = None,
    accel_bias_sigma_mps2: float = ACCEL_BIAS_PRIOR_MPS2,
    gyro_bias_sigma_radps: float = GYRO_BIAS_PRIOR_RADPS,
) -> Alignment:
    """Return the attitude at the end of a window in which the launcher sways, as ``coarse_alignment`` does at rest.

    The level is the block's own, whatever the reference says of it: a surveyed level does not hold while the launcher
    moves. A given azimuth is kept.

    Raises
    ------
    ValueError
        As :func:`align_in_inertial_frame`.
    """
    dv, dtheta = window.true(coefficients, terms)
    # No record at one attitude tells sensor errors from level and azimuth: the fit assumes none, σ holds what is
    # believed of them, as coarse_alignment does (Groves eq. 5.94).
    accels, gyros = (noise.accel_x, noise.accel_y, noise.accel_z), (noise.gyro_x, noise.gyro_y, noise.gyro_z)
    found = align_in_inertial_frame(
        dv,
        dtheta,
        window.interval_s,
        site,
        velocity_random_walk=max(channel.white for channel in accels),
        angle_random_walk=max(channel.white for channel in gyros),
    )
    accel_sigma = math.hypot(accel_bias_sigma_mps2, max(channel.flicker for channel in accels))
    gyro_sigma = math.hypot(gyro_bias_sigma_radps, max(channel.flicker for channel in gyros))
    level_sigma = accel_sigma / site.gravity_mps2
    azimuth_sigma = math.hypot(
        gyro_sigma / (EARTH_RATE_RADPS * math.cos(site.latitude_rad)), level_sigma * math.tan(site.latitude_rad)
    )
    roll, pitch, _ = roll_pitch_heading(found.C_tb)
    given = reference.azimuth_rad is not None
    return Alignment(
        C_tb=body_to_tangent(roll, pitch, reference.heading_rad),
        azimuth_rad=(
            found.azimuth_rad - reference.heading_rad if reference.azimuth_rad is None else reference.azimuth_rad
        )
        % math.tau,
        level_sigma_rad=math.hypot(found.level_sigma_rad, level_sigma),
        azimuth_sigma_rad=(
            reference.azimuth_sigma_rad if given else math.hypot(found.azimuth_sigma_rad, azimuth_sigma)
        ),
        level_source="accelerometers",
        azimuth_source="given" if given else "gyrocompass",
    )


def align_in_inertial_frame(
    dv_mps: Array,
    dtheta_rad: Array,
    interval_s: Array,
    site: Site,
    *,
    accel_sigma_mps2: float = 0.0,
    gyro_sigma_radps: float = 0.0,
    velocity_random_walk: float = 0.0,
    angle_random_walk: float = 0.0,
) -> InertialAlignment:
    """Level and find north from a window in which the launcher sways, but goes nowhere.

    Parameters
    ----------
    dv_mps, dtheta_rad : (n, 3)
        Velocity [m/s] and angle [rad] increments in body axes, calibration applied, none missing.
    interval_s : (n,)
        Device interval of each sample [s].
    accel_sigma_mps2, gyro_sigma_radps
        1σ of the constant errors that the sensors may still have; they only widen the covariance (see above).
    velocity_random_walk, angle_random_walk
        White noise of the sensors where known, as floors [m/s/√s], [rad/√s]. Without them the σ found may be several
        times too small on a record with bumps.

    Raises
    ------
    ValueError
        Shapes that do not match, a window shorter than :data:`SHORTEST_S`, a site too near a pole to have a north.
    """
    if dv_mps.ndim != 2 or dv_mps.shape[1] != 3 or dtheta_rad.shape != dv_mps.shape:
        raise ValueError(f"dv has shape {dv_mps.shape}, dtheta {dtheta_rad.shape}; give (n, 3) of each")
    if interval_s.shape != dv_mps.shape[:1] or not np.all(interval_s > 0.0):
        raise ValueError("the intervals are not one positive time a sample; give (n,) in seconds")
    if interval_s.sum() < SHORTEST_S:
        raise ValueError(
            f"the window lasts {interval_s.sum():.1f} s; alignment on a moving launcher needs {SHORTEST_S:g} s"
        )
    if abs(site.latitude_rad) > math.radians(89.0):
        raise ValueError("this close to a pole the gyros show no north; give the azimuth")
    path = _path(dv_mps, dtheta_rad, interval_s, site)
    sensors = np.array([accel_sigma_mps2] * 3 + [gyro_sigma_radps] * 2)
    floors = np.array([0.0, 0.0, velocity_random_walk, angle_random_walk])
    C_tb, fit = _improved(_coarse(path), path, site, sensors, floors, [])
    bumps: list[int] = []
    while True:  # the coarse attitude is off by a degree at worst, so that one more step leaves nothing
        C_tb, fit = _improved(C_tb, path, site, sensors, floors, bumps)
        worst = fit.worst_node(bumps)
        if worst is None or len(bumps) == _MOST_BUMPS:
            break
        bumps.append(worst)
    sway, shift, velocity, angle = fit.noise
    return InertialAlignment(
        C_tb,
        fit.covariance,
        sway_m=sway,
        shift_m=shift * math.sqrt(float(interval_s.sum())),
        velocity_random_walk=velocity,
        angle_random_walk=angle,
        bumps_s=tuple(sorted(float(path.back_s[[node - 1, node]].mean()) for node in bumps)),
        residual_m=fit.residual_m,
    )


@dataclass(frozen=True)
class _Path:
    """Node means, from the window's end backwards: ``back_s`` (k,), path in body axes (k, 3), U (k, 3, 3)."""

    back_s: Array
    body_m: Array
    unit: Array


@dataclass(frozen=True)
class _Fit:
    """``rotation`` φ (3,) with its covariance; sizes of the four noises; ``jump`` (k,): a step's size
    at each node, had there been one, in its σ.
    """

    rotation: Array
    covariance: Array
    noise: tuple[float, float, float, float]
    residual_m: Array
    jump: Array

    def worst_node(self, known: list[int]) -> int | None:
        """Return the node at which the path jumps beyond all noise, unless there is none or it is known."""
        size = self.jump.copy()
        size[[0, -1, *known, *(node + 1 for node in known)]] = 0.0
        worst = int(np.argmax(size))
        return worst if size[worst] > _BUMP_GATE else None


def _path(dv: Array, dtheta: Array, interval: Array, site: Site) -> _Path:
    """Integrate specific force twice in the inertial axes that the body has at the end, and gravity's direction."""
    state = np.zeros((len(dv) + 1, 10))
    state[0, 6] = 1.0
    integrate(
        np.ascontiguousarray(dv),
        np.ascontiguousarray(dtheta),
        np.ascontiguousarray(interval),
        np.zeros(3),  # no Earth, no gravity, no Coriolis: an inertial frame
        0.0,
        0.0,
        0.0,
        state,
    )
    time = np.concatenate([[0.0], np.cumsum(interval)])
    back = time[-1] - time
    # Seen from the end, which keeps the numbers small: p₀ and v₀ are free anyway.
    body = (state[:, 0:3] - state[-1, 0:3] + np.outer(back, state[-1, 3:6])) @ matrix_of_quaternion(state[-1, 6:10])
    # Nodes are means: sway faster than a node is gone before the fit.
    nodes = int(min(_MOST_NODES, max(12, time[-1])))
    edges = np.searchsorted(time, np.linspace(0.0, time[-1], nodes + 1)[:-1])
    count = np.diff(np.append(edges, len(time)))[:, None]
    columns = np.hstack([back[:, None], body, _twice_integrated(back, site).reshape(-1, 9)])
    # Backwards, so that the random walks start where the attitude is wanted.
    means = (np.add.reduceat(columns, edges) / count)[::-1]
    return _Path(means[:, 0], means[:, 1:4], means[:, 4:].reshape(-1, 3, 3))


def _twice_integrated(back_s: Array, site: Site) -> Array:
    """Return U = ∫∫C_nt (k, 3, 3) [s²] over the last ``back_s``, by the series of the rotation matrix."""
    omega = skew(-site.earth_rate_radps(0.0))  # backwards in time
    squared = (EARTH_RATE_RADPS * back_s) ** 2
    linear = back_s**3 / 6.0 * (1.0 - squared / 20.0 * (1.0 - squared / 42.0))
    quadratic = back_s**4 / 24.0 * (1.0 - squared / 30.0 * (1.0 - squared / 56.0))
    return np.asarray(
        np.multiply.outer(0.5 * back_s**2, np.eye(3))
        + np.multiply.outer(linear, omega)
        + np.multiply.outer(quadratic, omega @ omega)
    )


def _coarse(path: _Path) -> Array:
    """Solve Wahba's problem on the path's curvature, which is gravity, by Markley's singular value decomposition."""
    body, tangent = _curvature(path.back_s, path.body_m), _curvature(path.back_s, path.unit[:, :, 2])
    U, _, Vt = np.linalg.svd(tangent.T @ body)
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt)


def _curvature(time: Array, rows: Array) -> Array:
    """Return change of slope between successive sixths of the window: free of p₀, v₀, little touched by sway."""
    stride = len(time) // 6
    slope = (rows[stride:] - rows[:-stride]) / (time[stride:] - time[:-stride])[:, None]
    return np.asarray(slope[stride:] - slope[:-stride])


def _improved(
    C_tb: Array, path: _Path, site: Site, sensors: Array, floors: Array, bumps: list[int]
) -> tuple[Array, _Fit]:
    """Return the attitude after one Gauss-Newton step, and the fit."""
    fit = _fit(C_tb, path, site.gravity_mps2, sensors, floors, bumps)
    return rotation_matrix(fit.rotation) @ C_tb, fit


def _fit(C_tb: Array, path: _Path, gravity: float, sensors: Array, floors: Array, bumps: list[int]) -> _Fit:
    """Fit φ, sensor errors, p₀, v₀ and jumps to the level path, with the noise that makes it likeliest."""
    t = path.back_s
    reference = gravity * path.unit[:, :, 2]
    level = (path.body_m @ C_tb.T - reference)[:, :2]
    design = _design(path, reference, gravity, bumps)
    design[:, :, 3:8] *= sensors  # in units of their σ: prior information one, and an error said to be zero stays so
    scale = np.sqrt(np.mean(design**2, axis=(0, 1)))
    scale[3:8] = 1.0
    bases, sizes = _noise_bases(t, gravity)
    likelihood = _Likelihood(level, design / scale, bases, floors**2 * sizes)
    variances = likelihood.maximise()
    estimate, root = likelihood.solve(variances)
    spread = np.linalg.inv(root)
    sway, shift, velocity, angle = np.sqrt(variances / sizes)
    return _Fit(
        rotation=estimate[:3] / scale[:3],
        covariance=(spread @ spread.T)[:3, :3] / np.outer(scale[:3], scale[:3]),
        noise=(float(sway), float(shift), float(velocity), float(angle)),
        residual_m=np.sqrt(np.mean((level - design @ (estimate / scale)) ** 2, axis=0)),
        jump=likelihood.jumps(variances),
    )


def _design(path: _Path, reference: Array, gravity: float, bumps: list[int]) -> Array:
    """Return the columns (k, 2, p) of the level path: φ (3), b (3), ε (2), p₀ (2), v₀ (2), four for each jump."""
    t = path.back_s
    columns = np.zeros((len(t), 2, 12 + 4 * len(bumps)))
    x, y, z = reference.T
    columns[:, 0, 1], columns[:, 0, 2] = -z, y
    columns[:, 1, 0], columns[:, 1, 2] = z, -x
    columns[:, :, 3:6] = path.unit[:, :2, :]
    tilt = gravity * t**3 / 6.0
    columns[:, 0, 7], columns[:, 1, 6] = -tilt, tilt
    for axis in range(2):
        columns[:, axis, 8 + axis], columns[:, axis, 10 + axis] = 1.0, t
        for j, node in enumerate(bumps):
            columns[node, axis, 12 + 4 * j + axis] = 1.0  # the node that it falls into has part of it
            columns[node + 1 :, axis, 14 + 4 * j + axis] = 1.0
    return columns


def _noise_bases(t: Array, gravity: float) -> tuple[Array, Array]:
    """Return the node covariances (4, k, k) of the noises, one at the last node, and their variances there (4,).

    White position (sway), its random walk (slow shifts), accelerometer white noise twice and gyro white noise three
    times integrated; the variances are those of 1 m, 1 m/√s, 1 m/s/√s and 1 rad/√s.
    """
    first, later = np.minimum.outer(t, t), np.maximum.outer(t, t)
    gap = later - first
    velocity = first**2 * (3.0 * later - first) / 6.0
    angle = gravity**2 * first**3 * (first**2 / 20.0 + gap * first / 8.0 + gap**2 / 12.0)
    bases = np.stack([np.eye(len(t)), first, velocity, angle])
    sizes = bases[:, -1, -1]
    return bases / sizes[:, None, None], sizes


class _Likelihood:
    """Restricted likelihood of the level path under Σ variance·basis, the same for both axes.

    ``level`` (k, 2), ``design`` (k, 2, p) with unit prior information on columns 3 to 7, ``bases`` (4, k, k).
    """

    def __init__(self, level: Array, design: Array, bases: Array, floors: Array) -> None:
        self.columns = np.concatenate([design, level[:, :, None]], axis=2)
        self.bases, self.floors = bases, floors
        self.unknown = np.flatnonzero(floors[2:] == 0.0) + 2
        self.prior = np.eye(design.shape[2] + 1)[3:8]

    def solve(self, variances: Array) -> tuple[Array, Array]:
        """Return the estimate (p,) and the root (p, p) of its information."""
        R = self._triangle(self._whitened(variances)[0])
        return np.asarray(solve_triangular(R[:-1, :-1], R[:-1, -1])), R[:-1, :-1]

    def jumps(self, variances: Array) -> Array:
        """Return the size (k,) that a step at each node would have, in its σ, the larger of the two axes."""
        white, factor = self._whitened(variances)
        step = solve_triangular(factor, np.tril(np.ones(factor.shape)), lower=True)
        Q, _ = np.linalg.qr(np.vstack([white[:, :, :-1].reshape(-1, white.shape[2] - 1), self.prior[:, :-1]]))
        rows = white[:, :, -1].ravel()
        rows = rows - Q[: len(rows)] @ (Q[: len(rows)].T @ rows)
        sizes = []
        for axis in range(2):
            hidden = Q[axis : 2 * len(step) : 2].T @ step  # what the other unknowns would take up of the step
            spread = np.sum(step**2, axis=0) - np.sum(hidden**2, axis=0)
            sizes.append(np.abs(step.T @ rows[axis::2]) / np.sqrt(np.maximum(spread, 1e-12 * np.sum(step**2, axis=0))))
        return np.asarray(np.maximum(sizes[0], sizes[1]))

    def maximise(self) -> Array:
        """Return the likeliest variances (4,), none below its floor."""
        count = len(self.bases[0])
        scale = float(self._triangle(self.columns)[-1, -1]) ** 2 / (2.0 * count) + 1e-18
        least, most = np.log(self.floors + 1e-10 * scale), np.log(self.floors + 1e4 * scale)
        start = np.clip(np.log(scale * np.array([0.3, 1.0, 1.0, 1.0])), least, most)
        bounds = list(zip(least, most, strict=True))
        found = minimize(self._cost, start, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-6})
        return np.asarray(np.exp(found.x))

    def _cost(self, log_variances: Array) -> float:
        """Return −2·log of the restricted likelihood and of the prior (flat in the unknown σ), up to a constant."""
        white, factor = self._whitened(np.exp(log_variances))
        determinant = 4.0 * float(np.sum(np.log(np.diag(factor))))
        size = np.abs(np.diag(self._triangle(white)))
        information = 2.0 * float(np.sum(np.log(size[:-1])))
        return determinant + information + float(size[-1]) ** 2 - float(np.sum(log_variances[self.unknown]))

    def _whitened(self, variances: Array) -> tuple[Array, Array]:
        """Return the columns (k, 2, p + 1) divided by the noise's root, and that root (k, k)."""
        covariance = np.tensordot(variances, self.bases, 1)
        covariance[np.diag_indices_from(covariance)] *= 1.0 + 1e-12
        factor = np.linalg.cholesky(covariance)
        flat = self.columns.reshape(len(factor), -1)
        white = solve_triangular(factor, flat, lower=True, check_finite=False)
        return np.asarray(white).reshape(self.columns.shape), np.asarray(factor)

    def _triangle(self, white: Array) -> Array:
        """Return the triangle (p + 1, p + 1) of design, prior and, last, measurement; its corner is the misfit's root.

        By orthogonal rotation and not by normal equations: a tilt and an accelerometer error are nearly one column.
        """
        rows = np.vstack([white.reshape(-1, white.shape[2]), self.prior])
        return np.asarray(np.linalg.qr(rows, mode="r"))
