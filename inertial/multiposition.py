"""Calibration without a turntable: the block is turned by hand and laid down in many attitudes.

At every rest the accelerometers must feel gravity's magnitude, whatever the attitude; between two rests the gyros must
turn the direction of gravity felt at one into that felt at the other (Tedaldi, Pretto & Menegatti, ICRA 2014), while
the Earth turns too where the latitude is known. With A = M·a + b and G = N·g + F·a + b̂, both signs alike::

    |M·ā_k + b| = g        u_k+1 = C_k+1,k·u_k,  Ċ from G        ḡ_k = N⁻¹(C_bt·ω_IE − F·ā_k − b̂) at rest

A magnitude does not change when all three accelerometers' axes turn together: three of the six misalignments cannot be
seen. Here the axes are tied to accelerometer x, with y in the x-y plane, so that M is upper triangular; the gyros' six
are then relative to those axes and all seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from inertial.attitude import body_to_tangent, matrix_of_quaternion, rotation_matrix, skew
from inertial.calibration import CalibrationResult, Mounting, Residual, coefficient_names, coefficients_of
from inertial.compiled import compiled
from inertial.documents import Combination, Noise
from inertial.earth import EARTH_RATE_RADPS, earth_rate_tangent_radps
from inertial.error_model import ACCELS, GYROS
from inertial.increments import Increments

Array = NDArray[np.float64]
FEWEST_RESTS = 12
SHORTEST_REST_S = 1.0
_SECOND_S = 1.0
_QUIET_TIMES = 5.0  # a second of 100 samples: variance of noise alone stays within 1.5 times
_TURNING_TIMES = 8.0
_PINNED = 1e3
_UNEXPLAINED = 0.5
_UPPER = ((0, 1), (0, 2), (1, 2))
_SIGMA_OF_MAD = 1.4826
_MOST_TILTED = 0.15  # accelerometers calibrated to 15 %: less is no recording of rests


@dataclass(frozen=True)
class _Rest:
    """Mean readings (3,) [m/s²], [rad/s] of a rest, its first and last sample's rows, and its length."""

    accel: Array
    gyro: Array
    first: int
    last: int
    duration_s: float


def calibrate_by_hand(
    window: Increments,
    gravity_mps2: float,
    *,
    latitude_rad: float | None = None,
    mounting: Mounting | None = None,
) -> CalibrationResult:
    """Calibrate from a recording in which the block was laid down in many attitudes, by hand.

    Parameters
    ----------
    window
        The recording, from the first rest on; the rests are found in it.
    latitude_rad
        Where it was made; None: unknown, and the Earth's rate goes into the σ of the gyro biases.
    mounting
        Which accelerometers act on which gyro; None: none.

    Returns
    -------
    CalibrationResult
        Both signs alike. σ is scaled to the residuals found: attitudes laid by hand are no statistics of sensors alone.

    Raises
    ------
    ValueError
        Fewer than :data:`FEWEST_RESTS` rests, or readings at rest that are not gravity in the units given.
    """
    mounting = mounting or {}
    names = coefficient_names(mounting)
    rests = _rests(window)
    if len(rests) < FEWEST_RESTS:
        raise ValueError(
            f"{len(rests)} rests of {SHORTEST_REST_S:g} s or more were found; lay the block down in "
            f"{FEWEST_RESTS} attitudes or more, all faces and edges, and leave it a few seconds in each"
        )
    sizes = np.linalg.norm([rest.accel for rest in rests], axis=1)
    if not abs(float(np.median(sizes)) / gravity_mps2 - 1.0) < _MOST_TILTED:
        raise ValueError(
            f"at rest the accelerometers read {np.median(sizes):.4g} m/s² where gravity is {gravity_mps2:.5g}: "
            "check the scales and offsets of [columns]"
        )
    accel, accel_covariance, accel_left = _accelerometers(rests, gravity_mps2)
    gyros = _Gyros(window, rests, accel, latitude_rad, mounting)
    gyro, gyro_covariance, turn_left, rate_left = gyros.fit()
    values, covariance = _by_name(names, mounting, accel, accel_covariance, gyro, gyro_covariance)
    residuals = [
        *_named(rests, "rest", ("accel magnitude",), accel_left[:, None]),
        *_named(rests[1:], "turn before the rest", ("gravity x", "gravity y", "gravity z"), turn_left),
        *_named(rests, "rest", GYROS, rate_left),
    ]
    return CalibrationResult(
        method="many attitudes by hand, magnitude of gravity",
        coefficients=coefficients_of(names, values - _ideal(names)),
        order=names,
        values=values,
        covariance=covariance,
        nuisances={},
        residuals=tuple(residuals),
        chi_square=float(sum(residual.normalised**2 for residual in residuals)),
        degrees_of_freedom=len(residuals) - len(accel) - len(gyro),
        unobservable=_unseen(latitude_rad),
        disagreement=None,
        refused=(),
        noise=Noise(),
        notes=_follows_attitude(rests, rate_left, mounting),
    )


def _follows_attitude(rests: list[_Rest], rate_left: Array, mounting: Mounting) -> tuple[str, ...]:
    """Say so where gyro readings at rest go with gravity's direction: that is g-sensitivity, and not in the model."""
    force = np.array([rest.accel for rest in rests])
    design = np.column_stack([np.ones(len(force)), force])
    notes = []
    for i, gyro in enumerate(GYROS):
        slope = np.linalg.lstsq(design, rate_left[:, i])[0]
        left = float(np.var(rate_left[:, i] - design @ slope))
        if left < _UNEXPLAINED * float(np.var(rate_left[:, i])) and not mounting.get(gyro):
            size = math.degrees(float(np.linalg.norm(slope[1:])) * float(np.linalg.norm(force[0]))) * 3600.0
            notes.append(
                f"{gyro} at rest follows the attitude by up to {size:.3g} deg/h: it feels acceleration. "
                "Give a mounting (which accelerometers act on it) to calibrate that as well"
            )
    return tuple(notes)


def _rests(window: Increments) -> list[_Rest]:
    """Find the rests: the accelerometers straggle no more about a second's mean than in the quietest tenth.

    What they do not feel, a slow turn about the vertical, shows by a mean rate unlike that of the other rests.
    """
    interval = window.interval_s
    force = window.dv_mps / interval[:, None]
    width = max(4, round(_SECOND_S / float(np.median(interval))))
    if len(force) <= width:
        return []
    straggle = _moving_variance(force, width)
    steps = np.abs(np.diff(force, axis=0))
    grain = float(np.min(steps[steps > 0.0], initial=np.inf))
    quiet = max(float(np.quantile(straggle, 0.1)), grain**2 / 4.0 if math.isfinite(grain) else 0.0)
    still = np.zeros(len(force) + 2, dtype=np.int8)
    middle = 1 + width // 2
    still[middle : middle + len(straggle)] = straggle <= _QUIET_TIMES * quiet
    edges = np.flatnonzero(np.diff(still))
    found = []
    for first, last in zip(edges[0::2], edges[1::2], strict=True):
        time = float(interval[first:last].sum())
        if time >= SHORTEST_REST_S:
            accel, gyro = (rows[first:last].sum(axis=0) / time for rows in (window.dv_mps, window.dtheta_rad))
            found.append(_Rest(accel, gyro, int(first), int(last), time))
    if not found:
        return []
    rates = np.array([rest.gyro for rest in found])
    middle_rate = np.median(rates, axis=0)
    spread = _SIGMA_OF_MAD * np.median(np.abs(rates - middle_rate), axis=0) + EARTH_RATE_RADPS
    return [rest for rest in found if np.all(np.abs(rest.gyro - middle_rate) < _TURNING_TIMES * spread)]


def _moving_variance(rows: Array, width: int) -> Array:
    """Return the variance summed over the axes in every window of ``width`` rows (n − width + 1,)."""
    centred = rows - np.median(rows, axis=0)
    sums, squares = (np.vstack([np.zeros(3), np.cumsum(v, axis=0)]) for v in (centred, centred**2))
    mean = (sums[width:] - sums[:-width]) / width
    return np.asarray(((squares[width:] - squares[:-width]) / width - mean**2).sum(axis=1))


def _accelerometers(rests: list[_Rest], gravity: float) -> tuple[Array, Array, Array]:
    """Fit scale factors, upper misalignments and biases (9,); return them, their covariance and the residuals."""
    readings = np.array([rest.accel for rest in rests])

    def left(unknowns: Array) -> Array:
        M, b = _accel_matrix(unknowns)
        return np.asarray(np.linalg.norm(readings @ M.T + b, axis=1) - gravity)

    start = np.array([1.0, 1.0, 1.0, *np.zeros(6)])
    found = least_squares(left, start, loss="soft_l1", f_scale=1e-3 * gravity, x_scale="jac")
    scale = _spread(left(found.x), len(start))
    found = least_squares(left, found.x, loss="soft_l1", f_scale=3.0 * scale, x_scale="jac")
    return found.x, _covariance(np.asarray(found.jac), _spread(left(found.x), len(start))), left(found.x)


def _accel_matrix(unknowns: Array) -> tuple[Array, Array]:
    M = np.diag(unknowns[:3])
    for (i, j), value in zip(_UPPER, unknowns[3:6], strict=True):
        M[i, j] = value
    return M, unknowns[6:9]


def _spread(residuals: Array, unknowns: int) -> float:
    """Return σ of residuals from their median size, whatever a few rests that were none do to it."""
    count = max(1, residuals.size - unknowns)
    return float(_SIGMA_OF_MAD * np.median(np.abs(residuals)) * math.sqrt(residuals.size / count)) + 1e-15


def _covariance(jacobian: Array, sigma: float | Array) -> Array:
    """Return the covariance of a fit, zero along what its residuals do not depend on."""
    size = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    inverse = np.linalg.pinv(jacobian / size, rcond=1e-10)
    return np.asarray((inverse @ inverse.T) / np.outer(size, size)) * sigma**2


class _Gyros:
    """Unknowns: N (9), the readings at rest −N⁻¹·b̂ (3), F by mounting and, with a latitude, the first heading.

    The bias stands in units of the reading: else a smaller N would seem to explain its wandering from rest to rest.
    With neither F nor the Earth in the model, rests in other attitudes read another bias: then the longest rest gives
    it, as is the custom, and their disagreement goes into its σ.
    """

    def __init__(
        self, window: Increments, rests: list[_Rest], accel: Array, latitude_rad: float | None, mounting: Mounting
    ) -> None:
        self.interval, self.rests, self.latitude_rad = window.interval_s, rests, latitude_rad
        self.rate = window.dtheta_rad / window.interval_s[:, None]
        self.raw_force = window.dv_mps / window.interval_s[:, None]
        M, b = _accel_matrix(accel)
        up = np.array([rest.accel @ M.T + b for rest in rests])
        self.up = up / np.linalg.norm(up, axis=1)[:, None]
        self.pairs = [("xyz".index(g[-1]), "xyz".index(a[-1])) for g in GYROS for a in mounting.get(g, ())]
        self.earth = np.zeros(3) if latitude_rad is None else earth_rate_tangent_radps(latitude_rad, 0.0)
        self.rows = np.array([(rest.first, rest.last) for rest in rests])
        ends, starts = self.rows[:-1, 1], self.rows[1:, 0]
        lasting = [self.interval[end:start].sum() for end, start in zip(ends, starts, strict=True)]
        self.earth_turns = rotation_matrix(-np.outer(lasting, self.earth))
        self.pinned = not self.pairs and latitude_rad is None
        self.trust = np.full(len(rests), float(not self.pinned))
        if self.pinned:
            self.trust[int(np.argmax([rest.duration_s for rest in rests]))] = _PINNED

    def fit(self) -> tuple[Array, Array, Array, Array]:
        """Return N, b̂, F (12 + f,), their covariance, and what turns (k−1, 3) [rad] and rests (k, 3) [rad/s] leave."""
        unknowns = self._start()
        turns, rates = self.residuals(unknowns)
        for _ in range(2):
            sigma = _spread(turns, 0), _spread(rates, 0)
            found = least_squares(self._stacked, unknowns, loss="soft_l1", f_scale=3.0, x_scale="jac", args=(sigma,))
            unknowns = found.x
            turns, rates = self.residuals(unknowns)
        covariance = _covariance(np.asarray(found.jac), 1.0)
        if self.pinned:
            covariance[9:12, 9:12] += _spread(rates, 0) ** 2 * np.eye(3)
        return *self._in_equation_2(unknowns, covariance), turns, rates

    def _in_equation_2(self, unknowns: Array, covariance: Array) -> tuple[Array, Array]:
        """Return the unknowns as (2) has them, b̂ = −N·(reading at rest), with their covariance."""
        count = 12 + len(self.pairs)
        N, offset = unknowns[:9].reshape(3, 3), unknowns[9:12]
        slope = np.eye(count)
        slope[9:12, :9] = -np.kron(np.eye(3), offset)
        slope[9:12, 9:12] = -N
        values = np.concatenate([unknowns[:9], -N @ offset, unknowns[12:count]])
        spread = slope @ covariance[:count, :count] @ slope.T
        if self.latitude_rad is None:  # the Earth's rate may point anywhere in each attitude
            spread[9:12, 9:12] += EARTH_RATE_RADPS**2 / 3.0 * np.eye(3)
        return values, spread

    def _start(self) -> Array:
        """Return ideal gyros with the offset the rests show, and of twelve headings the one that suits them best."""
        offset = np.median([rest.gyro for rest in self.rests], axis=0)
        plain = np.concatenate([np.eye(3).ravel(), offset, np.zeros(len(self.pairs))])
        if self.latitude_rad is None:
            return plain
        tried = []
        for heading in np.arange(12) * math.tau / 12.0:
            guess = np.append(plain, heading)
            guess[9:12] += np.mean(self.residuals(guess)[1], axis=0)
            tried.append((float(np.sum(self.residuals(guess)[1] ** 2)), tuple(guess)))
        return np.array(min(tried)[1])

    def _stacked(self, unknowns: Array, sigma: tuple[float, float]) -> Array:
        turns, rates = self.residuals(unknowns)
        return np.concatenate([turns.ravel() / sigma[0], (rates * self.trust[:, None]).ravel() / sigma[1]])

    def residuals(self, unknowns: Array) -> tuple[Array, Array]:
        """Return what the turns leave of gravity's direction (k−1, 3) and the rests of their reading (k, 3)."""
        N, offset = unknowns[:9].reshape(3, 3), unknowns[9:12]
        F = np.zeros((3, 3))
        for (i, j), value in zip(self.pairs, unknowns[12 : 12 + len(self.pairs)], strict=True):
            F[i, j] = value
        heading = float(unknowns[-1]) if self.latitude_rad is not None else 0.0
        rate = (self.rate - offset) @ N.T + self.raw_force @ F.T
        turned = rate * self.interval[:, None]
        relative = matrix_of_quaternion(_turned(turned, self.rows))
        attitudes, missed = [_levelled(self.up[0], heading)], []
        for C, earth_turn, felt_after in zip(relative, self.earth_turns, self.up[1:], strict=True):
            C_tb = earth_turn @ attitudes[-1] @ C
            missed.append(C_tb[2] - felt_after)
            attitudes.append(_upright(C_tb, felt_after))  # its level shows again, the heading is carried on
        felt = np.array([rest.accel for rest in self.rests]) @ F.T
        true = np.array([C.T @ self.earth for C in attitudes])
        readings = np.array([rest.gyro for rest in self.rests])
        return np.array(missed), readings - offset - np.linalg.solve(N, (true - felt).T).T


def _levelled(up: Array, heading_rad: float) -> Array:
    """Return C_tb of a block that feels ``up`` (3,) in its axes."""
    return body_to_tangent(math.atan2(up[1], up[2]), math.atan2(up[0], math.hypot(up[1], up[2])), heading_rad)


def _upright(C_tb: Array, up: Array) -> Array:
    """Return ``C_tb`` turned by the smallest angle that makes the vertical felt in the block the tangent frame's."""
    felt = C_tb @ up
    K = skew(np.array([felt[1], -felt[0], 0.0]))
    return np.asarray((np.eye(3) + K + K @ K / (1.0 + felt[2])) @ C_tb)


@compiled
def _turned(dtheta: Array, rows: NDArray[np.int64]) -> Array:
    """Return the rotations (k − 1, 4), scalar-first, from the end of each rest to the start of the next.

    ``rows`` (k, 2): first and last row of each rest. With the coning term of uniform samples; plain scalars.
    """
    turns = np.empty((len(rows) - 1, 4))
    for k in range(len(rows) - 1):
        w, x, y, z = 1.0, 0.0, 0.0, 0.0
        before = dtheta[rows[k, 1] - 1]
        ox, oy, oz = before[0], before[1], before[2]
        for i in range(rows[k, 1], rows[k + 1, 0]):
            tx, ty, tz = dtheta[i, 0], dtheta[i, 1], dtheta[i, 2]
            px = tx + (oy * tz - oz * ty) / 12.0
            py = ty + (oz * tx - ox * tz) / 12.0
            pz = tz + (ox * ty - oy * tx) / 12.0
            ox, oy, oz = tx, ty, tz
            square = px * px + py * py + pz * pz
            c = 1.0 - square / 8.0 + square * square / 384.0
            s = 0.5 - square / 48.0 + square * square / 3840.0
            px, py, pz = s * px, s * py, s * pz
            nw, nx = c * w - px * x - py * y - pz * z, c * x + px * w + pz * y - py * z
            ny, nz = c * y + py * w + px * z - pz * x, c * z + pz * w + py * x - px * y
            w, x, y, z = nw, nx, ny, nz
        turns[k, 0], turns[k, 1], turns[k, 2], turns[k, 3] = w, x, y, z
    return turns


def _by_name(
    names: tuple[str, ...],
    mounting: Mounting,
    accel: Array,
    accel_covariance: Array,
    gyro: Array,
    gyro_covariance: Array,
) -> tuple[Array, Array]:
    """Return values and covariance in the order of ``names``; both signs of a coefficient are one unknown."""
    g_pairs = [f"{g}.g_sensitivity_radps_per_mps2.{a}" for g in GYROS for a in mounting.get(g, ())]
    unknowns = np.concatenate([accel, gyro[: 12 + len(g_pairs)]])
    spread = np.zeros((len(unknowns), len(unknowns)))
    spread[:9, :9], spread[9:, 9:] = accel_covariance, gyro_covariance[: len(unknowns) - 9, : len(unknowns) - 9]
    upper = {f"{ACCELS[i]}<-{ACCELS[j]}": 3 + k for k, (i, j) in enumerate(_UPPER)}
    pick = np.zeros((len(names), len(unknowns)))
    for row, name in enumerate(names):
        own, kind, *other = name.split(".")
        axis = "xyz".index(own[-1])
        column: int | None
        if kind.startswith("g_sensitivity"):
            column = 21 + g_pairs.index(name)
        elif own in ACCELS:
            column = 6 + axis if kind.startswith("bias") else upper.get(f"{own}<-{other[0]}") if other else axis
        else:
            column = 18 + axis if kind.startswith("bias") else 9 + 3 * axis + "xyz".index((other or [own])[0][-1])
        if column is not None:
            pick[row, column] = 1.0
    return pick @ unknowns, pick @ spread @ pick.T


def _ideal(names: tuple[str, ...]) -> Array:
    return np.array([1.0 if ".scale_" in name else 0.0 for name in names])


def _named(rests: list[_Rest], kind: str, channels: tuple[str, ...], left: Array) -> list[Residual]:
    sigma = _spread(left, 0)
    return [
        Residual(1, kind, float(rest.first), channel, float(value), float(value) / sigma)
        for rest, row in zip(rests, left, strict=True)
        for channel, value in zip(channels, row, strict=True)
    ]


def _unseen(latitude_rad: float | None) -> tuple[Combination, ...]:
    """Return what the method cannot see, whatever the recording."""
    found = []
    for i, j in _UPPER:
        third = "xyz"[3 - i - j]
        weights = {
            f"{own}.misalignment_{sign}.{other}": value
            for own, other, value in ((ACCELS[i], ACCELS[j], 1.0), (ACCELS[j], ACCELS[i], -1.0))
            for sign in ("positive", "negative")
        }
        text = (
            f"{ACCELS[i]}<-{ACCELS[j]} against {ACCELS[j]}<-{ACCELS[i]} cannot be seen: gravity's magnitude does not "
            f"change when all axes turn about {third} together; {ACCELS[j]}<-{ACCELS[i]} is set to zero, so that axes "
            "are accelerometer x's own. A turntable, or a known attitude, shows it"
        )
        found.append(Combination(combination=weights, text=text))
    signs = "the two signs of a coefficient are taken as one: a turntable tells S+ from S-"
    found.append(Combination(combination={"scale_positive": 1.0, "scale_negative": -1.0}, text=signs))
    if latitude_rad is None:
        text = "gyro bias and the Earth's rate cannot be told apart without the latitude: give [site] latitude_deg"
        found.append(Combination(combination={f"{gyro}.bias_radps": 1.0 for gyro in GYROS}, text=text))
    return tuple(found)
