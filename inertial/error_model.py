"""The sensors' error model, eqs (1), (2) with the additive terms of (8), (9), and its exact inverse.

Every coefficient is split by the sign of the reading it multiplies (``u⁺ = max(u, 0)``, ``u⁻ = min(u, 0)``)::

    A = P⁺·a⁺ + P⁻·a⁻ + b + f                 (1), (8)   [m/s²]
    G = Q⁺·g⁺ + Q⁻·g⁻ + b̂ + F·a + g_b         (2), (9)   [rad/s]

with readings ``a, g``, truth ``A, G``; scale factors on the diagonals of P, Q and misalignments beside them.
The split acts on each sample as sent. The inverse is exact: within one sign pattern the model is linear, and each
pattern's matrix is inverted once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from inertial.compiled import compiled
from inertial.documents import AccelCoefficients, AccelName, ChannelCoefficients, GyroCoefficients, GyroName

Array = NDArray[np.float64]
ACCELS: tuple[AccelName, ...] = ("accel_x", "accel_y", "accel_z")
GYROS: tuple[GyroName, ...] = ("gyro_x", "gyro_y", "gyro_z")
Name = TypeVar("Name", bound=str)


def _identity() -> Array:
    return np.eye(3)


def _zeros() -> Array:
    return np.zeros(3)


def _zero_matrix() -> Array:
    return np.zeros((3, 3))


@dataclass(frozen=True)
class Coefficients:
    """Coefficients of (1), (2); row = sensor whose truth is computed, column = reading. The default is ideal."""

    accel_positive: Array = field(default_factory=_identity)
    accel_negative: Array = field(default_factory=_identity)
    accel_bias_mps2: Array = field(default_factory=_zeros)
    gyro_positive: Array = field(default_factory=_identity)
    gyro_negative: Array = field(default_factory=_identity)
    gyro_bias_radps: Array = field(default_factory=_zeros)
    g_sensitivity: Array = field(default_factory=_zero_matrix)
    """rad/s per m/s²: which accelerometers act on which gyro is the mounting of the DTGs."""

    @classmethod
    def ideal(cls) -> Coefficients:
        """Return the block whose reading is the truth."""
        return cls()

    @classmethod
    def from_document(cls, document: ChannelCoefficients) -> Coefficients:
        """Return the coefficients of a calibration or block model."""
        accels = [document.accel_x, document.accel_y, document.accel_z]
        gyros = [document.gyro_x, document.gyro_y, document.gyro_z]
        g_sensitivity = [[g.g_sensitivity_radps_per_mps2.get(name, 0.0) for name in ACCELS] for g in gyros]
        return cls(
            _matrix([a.scale_positive for a in accels], [a.misalignment_positive for a in accels], ACCELS),
            _matrix([a.scale_negative for a in accels], [a.misalignment_negative for a in accels], ACCELS),
            np.array([a.bias_mps2 for a in accels]),
            _matrix([g.scale_positive for g in gyros], [g.misalignment_positive for g in gyros], GYROS),
            _matrix([g.scale_negative for g in gyros], [g.misalignment_negative for g in gyros], GYROS),
            np.array([g.bias_radps for g in gyros]),
            np.array(g_sensitivity),
        )

    def to_document(self) -> ChannelCoefficients:
        """Return the same coefficients as a document; zero misalignments and g-sensitivities are left out."""
        accels = {
            name: AccelCoefficients(
                scale_positive=float(self.accel_positive[i, i]),
                scale_negative=float(self.accel_negative[i, i]),
                bias_mps2=float(self.accel_bias_mps2[i]),
                misalignment_positive=_others(self.accel_positive[i], ACCELS, i),
                misalignment_negative=_others(self.accel_negative[i], ACCELS, i),
            )
            for i, name in enumerate(ACCELS)
        }
        gyros = {
            name: GyroCoefficients(
                scale_positive=float(self.gyro_positive[i, i]),
                scale_negative=float(self.gyro_negative[i, i]),
                bias_radps=float(self.gyro_bias_radps[i]),
                misalignment_positive=_others(self.gyro_positive[i], GYROS, i),
                misalignment_negative=_others(self.gyro_negative[i], GYROS, i),
                g_sensitivity_radps_per_mps2=_others(self.g_sensitivity[i], ACCELS, None),
            )
            for i, name in enumerate(GYROS)
        }
        return ChannelCoefficients.model_validate({**accels, **gyros})


def _matrix(scales: Sequence[float], misalignments: Sequence[Mapping[Name, float]], names: tuple[Name, ...]) -> Array:
    matrix = np.diag(np.asarray(scales, dtype=np.float64))
    for i, row in enumerate(misalignments):
        for name, value in row.items():
            j = names.index(name)
            if i == j:
                raise ValueError(f"misalignment of {names[i]} names {name} itself; its own share is the scale factor")
            matrix[i, j] = value
    return matrix


def _others(row: Array, names: tuple[Name, ...], own: int | None) -> dict[Name, float]:
    return {name: float(row[j]) for j, name in enumerate(names) if j != own and row[j] != 0.0}


@dataclass(frozen=True)
class Terms:
    """Additive terms of (8), (9): total, body axes, added to the reading's value. Each (3,)."""

    f_mps2: Array
    g_radps: Array

    @classmethod
    def zero(cls) -> Terms:
        """Return no compensation."""
        return cls(np.zeros(3), np.zeros(3))

    def __add__(self, other: Terms) -> Terms:
        """Return the two one after the other."""
        return Terms(self.f_mps2 + other.f_mps2, self.g_radps + other.g_radps)

    def __neg__(self) -> Terms:
        """Return the terms that undo these."""
        return Terms(-self.f_mps2, -self.g_radps)


def true_from_readings(
    accel_mps2: ArrayLike, gyro_radps: ArrayLike, coefficients: Coefficients, terms: Terms | None = None
) -> tuple[Array, Array]:
    """Return true specific force (n, 3) [m/s²] and rate (n, 3) [rad/s] of readings of the same shapes; eqs (8), (9)."""
    accel, gyro = _rows(accel_mps2, "accelerometer"), _rows(gyro_radps, "gyro")
    terms = terms or Terms.zero()
    true_accel = _forward(
        accel, coefficients.accel_positive, coefficients.accel_negative, coefficients.accel_bias_mps2 + terms.f_mps2
    )
    true_gyro = _forward(
        gyro, coefficients.gyro_positive, coefficients.gyro_negative, coefficients.gyro_bias_radps + terms.g_radps
    )
    if np.any(coefficients.g_sensitivity):
        true_gyro += accel @ coefficients.g_sensitivity.T
    return true_accel, true_gyro


def readings_from_true(
    true_accel_mps2: ArrayLike, true_gyro_radps: ArrayLike, coefficients: Coefficients, terms: Terms | None = None
) -> tuple[Array, Array]:
    """Return the readings (n, 3), (n, 3) that (8), (9) turn into this truth; the exact inverse.

    Raises
    ------
    ValueError
        Coefficients that no reading, or more than one, answers to: the eight sign patterns' determinants must be
        of one sign (column W-property of the horizontal linear complementarity problem, Sznajder & Gowda 1995).
    """
    accel, gyro = _rows(true_accel_mps2, "accelerometer"), _rows(true_gyro_radps, "gyro")
    terms = terms or Terms.zero()
    inverses = _pattern_inverses(coefficients.accel_positive, coefficients.accel_negative, "accelerometer")
    readings = _inverse(accel, inverses, coefficients.accel_bias_mps2 + terms.f_mps2)
    if np.any(coefficients.g_sensitivity):
        gyro = gyro - readings @ coefficients.g_sensitivity.T
    inverses = _pattern_inverses(coefficients.gyro_positive, coefficients.gyro_negative, "gyro")
    return readings, _inverse(gyro, inverses, coefficients.gyro_bias_radps + terms.g_radps)


def _rows(values: ArrayLike, kind: str) -> Array:
    rows = np.ascontiguousarray(values, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise ValueError(f"{kind} values have shape {rows.shape}; give (n, 3): one row a sample, columns x, y, z")
    return rows


def _pattern_inverses(positive: Array, negative: Array, kind: str) -> Array:
    """Return the inverses (8, 3, 3) by sign pattern: bit j of the index set where reading j is positive."""
    matrices = np.empty((8, 3, 3))
    for z, y, x in product((0, 1), repeat=3):
        matrices[x + 2 * y + 4 * z] = np.where(np.array([x, y, z], dtype=bool), positive, negative)
    if not np.all(np.isfinite(matrices)):
        raise ValueError(f"{kind} coefficients are not finite; restore the calibration")
    determinants = np.linalg.det(matrices)
    sizes = np.prod(np.linalg.norm(matrices, axis=1), axis=1)  # Hadamard's bound: the determinant if orthogonal
    if not (np.all(determinants > 1e-9 * sizes) or np.all(determinants < -1e-9 * sizes)):
        raise ValueError(
            f"{kind} scale factors and misalignments cannot be inverted: some truth has no reading or several "
            f"(determinants by sign pattern {determinants.min():.3g} to {determinants.max():.3g}); "
            "check for a zero scale factor, scale factors of opposite sign or a row given twice"
        )
    return np.asarray(np.linalg.inv(matrices))


@compiled
def _forward(readings: Array, positive: Array, negative: Array, constant: Array) -> Array:
    true = np.empty_like(readings)
    for k in range(readings.shape[0]):
        x, y, z = readings[k, 0], readings[k, 1], readings[k, 2]
        for i in range(3):
            true[k, i] = (
                (positive[i, 0] if x > 0.0 else negative[i, 0]) * x
                + (positive[i, 1] if y > 0.0 else negative[i, 1]) * y
                + (positive[i, 2] if z > 0.0 else negative[i, 2]) * z
                + constant[i]
            )
    return true


@compiled
def _inverse(true: Array, inverses: Array, constant: Array) -> Array:
    readings = np.empty_like(true)
    pattern = 7
    for k in range(true.shape[0]):
        a, b, c = true[k, 0] - constant[0], true[k, 1] - constant[1], true[k, 2] - constant[2]
        # Follow the signs from the sample before; where that wanders, try every pattern and keep the one whose
        # readings contradict it least (by rounding only, since one pattern does hold).
        best, least = pattern, np.inf
        for attempt in range(12):
            if attempt >= 4:
                pattern = attempt - 4
            m = inverses[pattern]
            x = m[0, 0] * a + m[0, 1] * b + m[0, 2] * c
            y = m[1, 0] * a + m[1, 1] * b + m[1, 2] * c
            z = m[2, 0] * a + m[2, 1] * b + m[2, 2] * c
            against = max(
                -x if pattern & 1 else x,
                -y if pattern & 2 else y,
                -z if pattern & 4 else z,
                0.0,
            )
            if against < least:
                best, least = pattern, against
            if against <= 0.0:
                break
            pattern = (1 if x > 0.0 else 0) + (2 if y > 0.0 else 0) + (4 if z > 0.0 else 0)
        pattern = best
        for i in range(3):
            readings[k, i] = inverses[pattern, i, 0] * a + inverses[pattern, i, 1] * b + inverses[pattern, i, 2] * c
    return readings
