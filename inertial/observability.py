"""What a run at rest cannot see, found by singular values and said in words.

Unknowns fall in two groups: the *terms* (six, each measured directly by its own sensor) and the *reference* errors
(level, azimuth, angles of the turns). A direction of the reference errors is unseen where the data, with the terms
left free, say less about it than its prior does: a shift of the terms then explains every reading as well.
At one attitude that is every direction; a second attitude takes some of them away.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inertial.earth import STANDARD_GRAVITY_MPS2

Array = NDArray[np.float64]

TERMS = ("f_x", "f_y", "f_z", "g_x", "g_y", "g_z")
UNSEEN_RAD = 10.0
"""An angle known no better than this is not known at all."""

_AXES = "xyz"
_MG_MPS2 = STANDARD_GRAVITY_MPS2 * 1e-3
_DEG_H_RADPS = math.radians(1.0) / 3600.0


@dataclass(frozen=True)
class Unseen:
    """One combination of unknowns that the data cannot take apart.

    ``weights``: change of each unknown (SI, names as in the estimate's ``order``) that leaves every reading as it is,
    for 1 rad of its reference error. ``bounded_by``: ``"nothing"``, ``"reference"`` (the σ given for level, azimuth or
    turn) or ``"prior"`` (the σ given for the terms). ``sigma_rad``: what is left of the reference error; inf where
    nothing bounds it.
    """

    weights: dict[str, float]
    text: str
    bounded_by: str
    sigma_rad: float


def unseen_directions(terms_rows: Array, reference_rows: Array, reference_sigma: Array) -> Array:
    """Return a basis (k, 6 + r) of the directions on which the data say less than the reference's prior.

    Parameters
    ----------
    terms_rows, reference_rows
        Whitened sensitivities (rows, 6) to the terms and (rows, r) to the reference errors [1/rad], each term in
        units of gravity or Earth rate so that all columns are comparable.
    reference_sigma
        Prior 1σ (r,) [rad]; where larger than :data:`UNSEEN_RAD`, or infinite, that limit stands for it.
    """
    # What the terms can imitate is projected out first; the singular values left are the data's own knowledge.
    basis, triangle = np.linalg.qr(terms_rows)
    own = reference_rows - basis @ (basis.T @ reference_rows)
    scale = np.minimum(reference_sigma, UNSEEN_RAD)
    _, singular, right = np.linalg.svd(own * scale, full_matrices=True)
    known = np.zeros(reference_rows.shape[1])
    known[: len(singular)] = singular
    directions = right[known < 1.0] * scale
    imitation = -np.linalg.solve(triangle, basis.T @ reference_rows @ directions.T).T
    return np.hstack([imitation, directions])


def _reduced(directions: Array, columns: int) -> Array:
    """Return the same span in echelon form with pivots in the first ``columns``: one reference error leads a row."""
    rows = directions.copy()
    for i in range(len(rows)):
        j = int(np.argmax(np.abs(rows[i, :columns])))
        rows[i] /= rows[i, j]
        for other in range(len(rows)):
            if other != i:
                rows[other] -= rows[other, j] * rows[i]
    rows[np.abs(rows) < 1e-12] = 0.0
    return rows


def correlation(covariance: Array) -> Array:
    """Return the correlation matrix (n, n) of a covariance (n, n); zero where a variance is zero."""
    sigma = np.sqrt(np.diag(covariance))
    inverse = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=sigma > 0)
    return np.asarray(covariance * np.outer(inverse, inverse))


@dataclass(frozen=True)
class TiltAxis:
    """A level axis that a tilt is told about: its name and direction (3,) in the tangent frame."""

    name: str
    direction: Array


def tilt_axes(C_tb: Array) -> tuple[TiltAxis, TiltAxis]:
    """Return the two level axes nearest to body axes, with the names an operator uses.

    An upright block has roll (about body x) and pitch (nose up, so about minus body y); any other attitude has tilts
    about the two body axes that lie most level.
    """
    first, second = sorted(np.argsort(np.abs(C_tb[2]))[:2])
    along = C_tb[:, first] * np.array([1.0, 1.0, 0.0])
    along /= np.linalg.norm(along)
    across = np.cross([0.0, 0.0, 1.0], along)
    across *= math.copysign(1.0, across @ C_tb[:, second])
    if second != 1 or C_tb[2, 2] < 0.5:
        return TiltAxis(f"tilt about body {_AXES[first]}", along), TiltAxis(f"tilt about body {_AXES[second]}", across)
    return TiltAxis("roll", along), TiltAxis("pitch", -across)


def describe(
    weights: dict[str, float], reference: str, C_tb: Array, bounded_by: str, sigma_rad: float, earth_rate: Array
) -> str:
    """Return the sentence for one unseen direction.

    Parameters
    ----------
    weights
        Change of each term and reference error for 1 rad of ``reference`` [SI].
    reference
        ``"azimuth error"``, ``"angle of turn k"`` or the name of a tilt.
    C_tb
        First attitude (3, 3): says which sensors are level.
    bounded_by, sigma_rad
        As in :class:`Unseen`.
    earth_rate
        Eq. (5) (3,) [rad/s]: says where north and east are.
    """
    f = np.array([weights.get(name, 0.0) for name in TERMS[:3]])
    g = np.array([weights.get(name, 0.0) for name in TERMS[3:]])
    mg_per_rad, deg_h_per_rad = np.linalg.norm(f) / _MG_MPS2, np.linalg.norm(g) / _DEG_H_RADPS
    if mg_per_rad > 50.0:
        bias, per_rad, unit, angle, angle_unit = _accelerometer(f, C_tb), mg_per_rad, "mg", 1e3, "mrad"
    else:
        east = np.cross(earth_rate, [0.0, 0.0, 1.0]) @ C_tb
        bias, per_rad, unit, angle, angle_unit = _gyro(g, east), deg_h_per_rad, "deg/h", math.degrees(1.0), "deg"
    remedy = _remedy(reference)
    if math.isinf(sigma_rad):
        equal, separate = f"1 {unit} ≡ {angle / per_rad:.3g} {angle_unit}", f"give {remedy} or a second attitude"
    else:
        given = "the reference given" if bounded_by == "reference" else "what is believed of the terms"
        equal = f"{sigma_rad * per_rad:.2g} {unit} ≡ {sigma_rad * angle:.2g} {angle_unit} (1σ, by {given} alone)"
        separate = f"give {remedy} of smaller σ or a second attitude"
    return f"{bias} and {reference} are one: {equal}; {separate} to separate them"


def _remedy(reference: str) -> str:
    if reference.startswith("angle of turn"):
        return "a turn angle"
    return "an azimuth reference" if reference == "azimuth error" else "a level reference"


def _accelerometer(f: Array, C_tb: Array) -> str:
    chief = int(np.argmax(np.abs(f)))
    if abs(f[chief]) < 0.95 * np.linalg.norm(f):
        return f"bias of the accelerometers together ({_mixture(f, _AXES)})"
    return f"{'level ' if abs(C_tb[2, chief]) < 0.5 else ''}{_AXES[chief]} accelerometer bias"


def _gyro(g: Array, east: Array) -> str:
    if abs(g @ east) > 0.95 * np.linalg.norm(g) * np.linalg.norm(east):
        return f"east gyro bias ({_mixture(g, _AXES)})"
    return f"bias of the gyros together ({_mixture(g, _AXES)})"


def _mixture(vector: Array, names: Sequence[str]) -> str:
    unit = vector / max(float(np.linalg.norm(vector)), 1e-300)
    return ", ".join(f"{value:+.2f} {name}" for name, value in zip(names, unit, strict=True) if abs(value) > 0.05)


def name_unseen(
    directions: Array,
    order: Sequence[str],
    C_tb: Array,
    earth_rate: Array,
    covariance: Array,
    unbounded: Array,
    finite: Sequence[bool],
) -> list[Unseen]:
    """Return the unseen directions one by one, in words.

    Parameters
    ----------
    directions
        (k, n) in SI, columns as ``order``: six terms, ``level_1``, ``level_2``, ``azimuth``, ``turn_1`` …
    C_tb, earth_rate
        First attitude (3, 3); eq. (5) (3,) [rad/s].
    covariance, unbounded
        Posterior (n, n) on what is bounded, and a basis (u, n) of what is not.
    finite
        Whether each reference error (n − 6) has a finite prior of its own.
    """
    if not len(directions):
        return []
    axes = tilt_axes(C_tb)
    to_tilts = np.array([axis.direction[:2] for axis in axes])
    names = [axes[0].name, axes[1].name, "azimuth error"]
    names += [f"angle of turn {k + 1}" for k in range(len(order) - 9)]
    tilts = directions[:, 6:8] @ to_tilts.T
    rows = _reduced(np.hstack([tilts, directions[:, 8:], directions[:, :6]]), len(names))
    found = []
    for row in rows:
        pivot = int(np.argmax(np.abs(row[: len(names)])))
        functional = np.zeros(len(order))
        if pivot < 2:
            size = float(np.hypot(*row[:2]))
            functional[6:8] = row[:2] @ to_tilts / size
            single = abs(row[pivot]) > 0.95 * size
            name = names[pivot] if single else f"tilt ({_mixture(row[:2], names[:2])})"
        else:
            size, name = row[pivot], names[pivot]
            functional[6 + pivot] = 1.0
        row = row / size
        values = [*row[len(names) :], *(row[:2] @ to_tilts), *row[2 : len(names)]]
        weights = {unknown: float(value) for unknown, value in zip(order, values, strict=True) if value}
        free = len(unbounded) > 0 and bool(np.max(np.abs(unbounded @ functional)) > 1e-6)
        sigma = math.inf if free else math.sqrt(max(float(functional @ covariance @ functional), 0.0))
        given = any(finite[:2]) if pivot < 2 else finite[pivot]
        bounded_by = "nothing" if free else ("reference" if given else "prior")
        text = describe(weights, name, C_tb, bounded_by, sigma, earth_rate)
        found.append((pivot, Unseen(weights, text, bounded_by, sigma)))
    return [unseen for _, unseen in sorted(found, key=lambda pair: pair[0])]
