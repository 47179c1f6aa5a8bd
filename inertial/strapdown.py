"""Strapdown navigation in the tangent frame from body increments.

The tangent frame is fixed to the Earth, so its rate ω_t is constant (eq. 5)::

    Ċ_tb = C_tb·[ω_b×] − [ω_t×]·C_tb        v̇ = C_tb·a_b + g(p) − c·ω_t × v        ṗ = v

with c = 2 (Coriolis; the paper's eq. 4 prints it once) and g(p) = (−g·x/R, −g·y/R, −g + 2g·z/R). Per sample: rotation
vector with the coning term, velocity with rotation and sculling terms, both from this and the previous sample's
increments as if rate and force ran linearly over the two intervals (Savage, J. Guid. Control Dyn. 21(1), 1998, eqs 33,
36-38 and Part 2, eqs 25-31; the factor 1/12 generalised to unequal intervals). Constant rate and force are integrated
exactly, and the Earth's turn within the sample is counted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from inertial.attitude import matrix_of_quaternion, quaternion
from inertial.compiled import compiled
from inertial.earth import Site

Array = NDArray[np.float64]
CORIOLIS = 2.0
PAPER_CORIOLIS = 1.0
"""Eq. (4) as printed."""


@dataclass(frozen=True)
class Navigation:
    """A navigated trajectory, start included; row k+1 is the state at the end of sample k.

    ``time_s`` (n+1,) since the start; ``position_m``, ``velocity_mps`` (n+1, 3) tangent, relative to the Earth;
    ``quaternion_tb`` (n+1, 4) scalar-first, body to tangent.
    """

    time_s: Array
    position_m: Array
    velocity_mps: Array
    quaternion_tb: Array

    @property
    def C_tb(self) -> Array:
        """Return the attitude as matrices (n+1, 3, 3), body to tangent."""
        return matrix_of_quaternion(self.quaternion_tb)

    @property
    def radial_m(self) -> Array:
        """Return the distance from the origin (n+1,), the paper's eq. (10) for a block that stands there."""
        return np.asarray(np.linalg.norm(self.position_m, axis=1))


def navigate(
    dv_mps: ArrayLike,
    dtheta_rad: ArrayLike,
    interval_s: ArrayLike,
    C_tb0: ArrayLike,
    site: Site,
    azimuth_rad: float,
    *,
    coriolis: float = CORIOLIS,
    gravity_gradient: bool = True,
    velocity0_mps: ArrayLike = (0.0, 0.0, 0.0),
    position0_m: ArrayLike = (0.0, 0.0, 0.0),
) -> Navigation:
    """Navigate from body increments.

    Parameters
    ----------
    dv_mps, dtheta_rad : (n, 3)
        Velocity [m/s] and angle [rad] gained in each sample, body axes, errors already taken out.
    interval_s : (n,) or scalar
        Device interval of each sample [s].
    C_tb0 : (3, 3)
        Attitude before the first sample.
    azimuth_rad
        Azimuth of tangent axis 1, clockwise from north [rad].
    coriolis
        2 for velocity relative to the Earth, 1 for the paper's eq. (4).
    gravity_gradient
        False keeps gravity constant, as the paper does and as short closed forms do.

    Raises
    ------
    ValueError
        Shapes that do not match, an interval that is not positive, an attitude that is not a rotation.
    """
    dv, dtheta = _increments(dv_mps, "dv"), _increments(dtheta_rad, "dtheta")
    interval = np.ascontiguousarray(np.broadcast_to(np.asarray(interval_s, dtype=np.float64), (len(dv),)))
    if dtheta.shape != dv.shape:
        raise ValueError(f"dv has {len(dv)} samples and dtheta {len(dtheta)}; give one row of each per sample")
    if not np.all(interval > 0.0):
        raise ValueError(f"sample {int(np.argmin(interval > 0.0))}: the interval is not positive")
    C0 = np.asarray(C_tb0, dtype=np.float64)
    if C0.shape != (3, 3) or not np.allclose(C0 @ C0.T, np.eye(3), atol=1e-6) or np.linalg.det(C0) < 0:
        raise ValueError("the initial attitude C_tb0 is not a rotation matrix (3, 3)")
    time = np.concatenate([[0.0], np.cumsum(interval)])
    state = np.empty((len(dv) + 1, 10))
    state[0, 0:3], state[0, 3:6], state[0, 6:10] = position0_m, velocity0_mps, quaternion(C0)
    gradient = site.gravity_mps2 / site.radius_m if gravity_gradient else 0.0
    integrate(dv, dtheta, interval, site.earth_rate_radps(azimuth_rad), site.gravity_mps2, gradient, coriolis, state)
    return Navigation(time, state[:, 0:3], state[:, 3:6], state[:, 6:10])


def _increments(values: ArrayLike, name: str) -> Array:
    rows = np.ascontiguousarray(values, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise ValueError(f"{name} has shape {rows.shape}; give (n, 3): one row a sample, columns x, y, z")
    return rows


@compiled
def integrate(
    dv: Array,
    dtheta: Array,
    interval: Array,
    earth_rate: Array,
    gravity: float,
    gradient: float,
    coriolis: float,
    state: Array,
) -> None:
    """Fill ``state`` (n+1, 10) = position, velocity, quaternion from its first row; the hot loop, plain scalars.

    ``dv``, ``dtheta`` (n, 3), ``interval`` (n,), ``earth_rate`` (3,) tangent, ``gradient`` = g/R or 0 [1/s²].
    """
    ex, ey, ez = earth_rate[0], earth_rate[1], earth_rate[2]
    px, py, pz = state[0, 0], state[0, 1], state[0, 2]
    vx, vy, vz = state[0, 3], state[0, 4], state[0, 5]
    qw, qx, qy, qz = state[0, 6], state[0, 7], state[0, 8], state[0, 9]
    # Increments of the sample before; zero before the first, where nothing is known of it.
    ox = oy = oz = ux = uy = uz = 0.0
    before = interval[0] if interval.shape[0] else 1.0
    for k in range(dv.shape[0]):
        dt = interval[k]
        tx, ty, tz = dtheta[k, 0], dtheta[k, 1], dtheta[k, 2]
        wx, wy, wz = dv[k, 0], dv[k, 1], dv[k, 2]
        # Coning of a rate that runs linearly over both intervals.
        cone = 1.0 / 12.0 if dt == before else dt * dt / (6.0 * before * (before + dt))
        fx = tx + cone * (oy * tz - oz * ty)
        fy = ty + cone * (oz * tx - ox * tz)
        fz = tz + cone * (ox * ty - oy * tx)
        scull_x = cone * (oy * wz - oz * wy + uy * tz - uz * ty)
        scull_y = cone * (oz * wx - ox * wz + uz * tx - ux * tz)
        scull_z = cone * (ox * wy - oy * wx + ux * ty - uy * tx)
        before, ox, oy, oz, ux, uy, uz = dt, tx, ty, tz, wx, wy, wz
        # Velocity gained, in the body axes at the start of the sample: exact for constant rate and force.
        square = tx * tx + ty * ty + tz * tz
        if square < 0.01:
            first = 0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0 - square * (1.0 / 40320.0)))
            second = 1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0 - square * (1.0 / 362880.0)))
        else:
            angle = math.sqrt(square)
            first = (1.0 - math.cos(angle)) / square
            second = (1.0 - math.sin(angle) / angle) / square
        cx, cy, cz = ty * wz - tz * wy, tz * wx - tx * wz, tx * wy - ty * wx
        bx = wx + first * cx + second * (ty * cz - tz * cy) + scull_x
        by = wy + first * cy + second * (tz * cx - tx * cz) + scull_y
        bz = wz + first * cz + second * (tx * cy - ty * cx) + scull_z
        # Into tangent axes at the start of the sample (v + 2w(q×v) + 2q×(q×v)), then half the Earth's turn in it.
        cx, cy, cz = 2.0 * (qy * bz - qz * by), 2.0 * (qz * bx - qx * bz), 2.0 * (qx * by - qy * bx)
        ax = bx + qw * cx + qy * cz - qz * cy
        ay = by + qw * cy + qz * cx - qx * cz
        az = bz + qw * cz + qx * cy - qy * cx
        half = 0.5 * dt
        gx = ax - half * (ey * az - ez * ay)
        gy = ay - half * (ez * ax - ex * az)
        gz = az - half * (ex * ay - ey * ax)
        # Gravity and Coriolis at the middle of the sample.
        mx, my, mz = px + half * vx, py + half * vy, pz + half * vz
        gx -= gradient * mx * dt
        gy -= gradient * my * dt
        gz += (2.0 * gradient * mz - gravity) * dt
        mx, my, mz = vx + 0.5 * gx, vy + 0.5 * gy, vz + 0.5 * gz
        turn = coriolis * dt
        cx, cy, cz = ey * mz - ez * my, ez * mx - ex * mz, ex * my - ey * mx
        mx, my, mz = mx - 0.5 * turn * cx, my - 0.5 * turn * cy, mz - 0.5 * turn * cz
        nx = vx + gx - turn * (ey * mz - ez * my)
        ny = vy + gy - turn * (ez * mx - ex * mz)
        nz = vz + gz - turn * (ex * my - ey * mx)
        px += half * (vx + nx)
        py += half * (vy + ny)
        pz += half * (vz + nz)
        vx, vy, vz = nx, ny, nz
        # Attitude: the body's turn on the right, the Earth's (small: two terms of its series) taken off on the left.
        square = fx * fx + fy * fy + fz * fz
        if square < 0.01:
            scalar = 1.0 - square * (1.0 / 8.0 - square * (1.0 / 384.0 - square * (1.0 / 46080.0)))
            sine = 0.5 - square * (1.0 / 48.0 - square * (1.0 / 3840.0 - square * (1.0 / 645120.0)))
        else:
            angle = math.sqrt(square)
            scalar = math.cos(0.5 * angle)
            sine = math.sin(0.5 * angle) / angle
        fx, fy, fz = sine * fx, sine * fy, sine * fz
        rw = qw * scalar - qx * fx - qy * fy - qz * fz
        rx = qw * fx + qx * scalar + qy * fz - qz * fy
        ry = qw * fy - qx * fz + qy * scalar + qz * fx
        rz = qw * fz + qx * fy - qy * fx + qz * scalar
        hx, hy, hz = half * ex, half * ey, half * ez
        hw = 1.0 - 0.5 * (hx * hx + hy * hy + hz * hz)
        qw = hw * rw + hx * rx + hy * ry + hz * rz
        qx = hw * rx - hx * rw - hy * rz + hz * ry
        qy = hw * ry + hx * rz - hy * rw - hz * rx
        qz = hw * rz - hx * ry + hy * rx - hz * rw
        # One Newton step towards unit length; it is never farther off than rounding.
        scale = 1.5 - 0.5 * (qw * qw + qx * qx + qy * qy + qz * qz)
        qw, qx, qy, qz = scale * qw, scale * qx, scale * qy, scale * qz
        row = state[k + 1]
        row[0], row[1], row[2] = px, py, pz
        row[3], row[4], row[5] = vx, vy, vz
        row[6], row[7], row[8], row[9] = qw, qx, qy, qz
