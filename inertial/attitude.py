"""Attitude: body axes (forward, left, up) in tangent axes (along the azimuth, left of it, up).

``C_tb`` takes a vector's body components to tangent components: ``C_tb = Rz(−heading)·Ry(−pitch)·Rx(roll)``.
Pitch is positive nose up, roll right side down, heading clockwise seen from above. Quaternions are scalar-first.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def body_to_tangent(roll_rad: float, pitch_rad: float, heading_rad: float) -> Array:
    """Return ``C_tb`` (3, 3) of an attitude [rad]; heading is relative to the tangent frame's azimuth."""
    sr, cr = math.sin(roll_rad), math.cos(roll_rad)
    sp, cp = math.sin(pitch_rad), math.cos(pitch_rad)
    sh, ch = math.sin(heading_rad), math.cos(heading_rad)
    about_up = np.array([[ch, sh, 0.0], [-sh, ch, 0.0], [0.0, 0.0, 1.0]])
    about_left = np.array([[cp, 0.0, -sp], [0.0, 1.0, 0.0], [sp, 0.0, cp]])
    about_forward = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return np.asarray(about_up @ about_left @ about_forward)


def roll_pitch_heading(C_tb: Array) -> tuple[float, float, float]:
    """Return roll, pitch, heading [rad] of ``C_tb`` (3, 3).

    With the nose straight up or down only heading ∓ roll is defined; roll is then zero.
    """
    cos_pitch = math.hypot(C_tb[2, 1], C_tb[2, 2])
    pitch = math.atan2(C_tb[2, 0], cos_pitch)
    if cos_pitch < 1e-12:
        return 0.0, pitch, math.atan2(C_tb[0, 1], C_tb[1, 1])
    return math.atan2(C_tb[2, 1], C_tb[2, 2]), pitch, math.atan2(-C_tb[1, 0], C_tb[0, 0])


def skew(vector: Array) -> Array:
    """Return the matrix (3, 3) with ``skew(u) @ w == cross(u, w)``."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_matrix(rotation_vector_rad: Array) -> Array:
    """Return the matrix (..., 3, 3) that turns by a rotation vector (..., 3) [rad], right-handed."""
    return np.asarray(Rotation.from_rotvec(rotation_vector_rad).as_matrix())


def rotation_vector(C: Array) -> Array:
    """Return the rotation vector (..., 3) [rad] of a rotation matrix (..., 3, 3)."""
    return np.asarray(Rotation.from_matrix(C).as_rotvec())


def quaternion(C: Array) -> Array:
    """Return the scalar-first quaternion (..., 4) of a rotation matrix (..., 3, 3); its scalar is not negative."""
    return np.asarray(Rotation.from_matrix(C).as_quat(canonical=True, scalar_first=True))


def matrix_of_quaternion(q: Array) -> Array:
    """Return the rotation matrix (..., 3, 3) of a scalar-first quaternion (..., 4) of any length but zero."""
    return np.asarray(Rotation.from_quat(q, scalar_first=True).as_matrix())
