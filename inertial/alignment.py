"""Coarse alignment: the first rotation matrix of a block at rest, and how well it is known.

Level comes from a surveyed attitude or from the accelerometers, azimuth from the launcher or from the gyros
(gyrocompassing: the level part of the Earth's rate points north; Groves, *Principles of GNSS, Inertial and
Multisensor Integrated Navigation Systems*, 2nd ed., section 5.6).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from inertial.attitude import body_to_tangent
from inertial.documents import ChannelNoise, Noise
from inertial.earth import EARTH_RATE_RADPS, STANDARD_GRAVITY_MPS2, Site
from inertial.error_model import Coefficients, Terms
from inertial.increment_covariance import integral_covariance
from inertial.increments import Increments

Array = NDArray[np.float64]

ACCEL_BIAS_PRIOR_MPS2 = 1e-3 * STANDARD_GRAVITY_MPS2
"""1σ believed of an accelerometer bias where the block levels itself: it tilts the level by as many mrad as mg."""
GYRO_BIAS_PRIOR_RADPS = math.radians(3.0) / 3600.0
"""1σ believed of a gyro bias where the block finds its own azimuth."""


@dataclass(frozen=True)
class Reference:
    """What is known from outside of the attitude, angles in rad, σ as 1σ.

    ``azimuth_rad``: of tangent axis 1, clockwise from north; None = to be gyrocompassed. ``roll_rad``, ``pitch_rad``:
    None = to be levelled from the accelerometers. ``heading_rad``: of the block, relative to the azimuth.
    """

    azimuth_rad: float | None = None
    azimuth_sigma_rad: float = 0.0
    roll_rad: float | None = None
    pitch_rad: float | None = None
    heading_rad: float = 0.0
    level_sigma_rad: float = 0.0

    def __post_init__(self) -> None:
        """Refuse half a level and negative σ."""
        if (self.roll_rad is None) != (self.pitch_rad is None):
            raise ValueError("the reference gives only one of roll and pitch; give both, or neither to level by itself")
        if self.azimuth_sigma_rad < 0.0 or self.level_sigma_rad < 0.0:
            raise ValueError("a σ of the reference is negative; give 1σ as a positive angle")


@dataclass(frozen=True)
class Alignment:
    """Attitude of a block at rest in the tangent frame of ``azimuth_rad``.

    ``level_sigma_rad`` is 1σ of the tilt about each level axis, ``azimuth_sigma_rad`` of the turn about up. A level
    from the accelerometers holds their bias, an azimuth from the gyros theirs, at the size believed of them.
    """

    C_tb: Array
    azimuth_rad: float
    level_sigma_rad: float
    azimuth_sigma_rad: float
    level_source: Literal["given", "accelerometers"]
    azimuth_source: Literal["given", "gyrocompass"]

    @property
    def covariance(self) -> Array:
        """Return the covariance (3, 3) [rad²] of the attitude error as a tangent rotation vector."""
        return np.diag([self.level_sigma_rad**2, self.level_sigma_rad**2, self.azimuth_sigma_rad**2])


def coarse_alignment(
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
    """Return the attitude from the mean readings of a window at rest and what the reference gives.

    Parameters
    ----------
    noise
        Of the block; with the window's length it bounds what averaging leaves.
    accel_bias_sigma_mps2, gyro_bias_sigma_radps
        1σ believed of the biases that a level or an azimuth of the block's own takes in.

    Raises
    ------
    ValueError
        Mean specific force that is not gravity (the block moves, or units are wrong), or an azimuth asked of gyros
        within a degree of a pole.
    """
    dv, dtheta = window.true(coefficients, terms)
    force, rate = dv.sum(axis=0) / window.duration_s, dtheta.sum(axis=0) / window.duration_s
    if reference.roll_rad is not None and reference.pitch_rad is not None:
        roll, pitch, level_sigma = reference.roll_rad, reference.pitch_rad, reference.level_sigma_rad
    else:
        roll, pitch = level_of(force, site)
        level_noise = _mean_sigma(window.duration_s, noise.accel_x, noise.accel_y, noise.accel_z)
        level_sigma = math.hypot(accel_bias_sigma_mps2, level_noise) / site.gravity_mps2
    if reference.azimuth_rad is not None:
        azimuth, azimuth_sigma = reference.azimuth_rad, reference.azimuth_sigma_rad
    else:
        azimuth = azimuth_of(rate, roll, pitch, site) - reference.heading_rad
        rate_noise = _mean_sigma(window.duration_s, noise.gyro_x, noise.gyro_y, noise.gyro_z)
        level_rate = EARTH_RATE_RADPS * math.cos(site.latitude_rad)
        # A tilt about north mixes the vertical rate into the east gyro (Groves eq. 5.94).
        azimuth_sigma = math.hypot(
            math.hypot(gyro_bias_sigma_radps, rate_noise) / level_rate, level_sigma * math.tan(site.latitude_rad)
        )
    return Alignment(
        body_to_tangent(roll, pitch, reference.heading_rad),
        azimuth % (2.0 * math.pi),
        level_sigma,
        azimuth_sigma,
        "given" if reference.roll_rad is not None else "accelerometers",
        "given" if reference.azimuth_rad is not None else "gyrocompass",
    )


def level_of(force_mps2: Array, site: Site) -> tuple[float, float]:
    """Return roll, pitch [rad] that the mean specific force (3,) [m/s²] of a block at rest shows."""
    size = float(np.linalg.norm(force_mps2))
    if not abs(size - site.gravity_mps2) < 0.1 * site.gravity_mps2:
        raise ValueError(
            f"mean specific force is {size:.4g} m/s² where gravity is {site.gravity_mps2:.5g}: the block moves, or "
            "its calibration or units are wrong; it cannot be levelled from its accelerometers"
        )
    x, y, z = force_mps2
    return math.atan2(y, z), math.atan2(x, math.hypot(y, z))


def azimuth_of(rate_radps: Array, roll_rad: float, pitch_rad: float, site: Site) -> float:
    """Return the azimuth [rad] of the block's forward axis from its mean rate (3,) [rad/s] at rest."""
    if abs(site.latitude_rad) > math.radians(89.0):
        raise ValueError("this close to a pole the gyros show no north; give the azimuth")
    ahead, left, _ = body_to_tangent(roll_rad, pitch_rad, 0.0) @ rate_radps
    return math.atan2(left, ahead)


def _mean_sigma(duration_s: float, *channels: ChannelNoise) -> float:
    """Return 1σ [y] of the mean over a time from its start, of the worst of some channels."""
    span = np.array([[0.0, duration_s]])
    worst = max(float(integral_covariance(channel, span)[0, 0]) for channel in channels)
    return math.sqrt(worst) / duration_s
