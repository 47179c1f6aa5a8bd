"""Earth at the launcher: gravity, rotation rate, radius.

Gravity is WGS-84 normal gravity (NIMA TR8350.2, third edition, eqs 4-1 and 4-3); the rotation rate in the tangent
frame is eq. (5) of the paper. Plumb-bob gravity, so the centrifugal part is in it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

EARTH_RATE_RADPS = 7.292115e-5
"""Rotation rate of the Earth [rad/s], WGS-84."""

STANDARD_GRAVITY_MPS2 = 9.80665
"""Unit "g" of specifications [m/s²]; a mg is a thousandth of it."""

SEMI_MAJOR_AXIS_M = 6378137.0
FLATTENING = 1.0 / 298.257223563
_ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)
_EQUATOR_GRAVITY_MPS2 = 9.7803253359
_SOMIGLIANA = 0.00193185265241
_GRAVITY_RATIO = 0.00344978650684  # m = ω²a²b/GM


def normal_gravity_mps2(latitude_rad: float, height_m: float = 0.0) -> float:
    """Return normal gravity [m/s²] at a geodetic latitude [rad] and ellipsoidal height [m].

    Somigliana's closed formula on the ellipsoid, continued to second order in height (TR8350.2 eqs 4-1, 4-3).
    """
    sine_squared = math.sin(latitude_rad) ** 2
    surface = (
        _EQUATOR_GRAVITY_MPS2
        * (1.0 + _SOMIGLIANA * sine_squared)
        / math.sqrt(1.0 - _ECCENTRICITY_SQUARED * sine_squared)
    )
    first = 2.0 / SEMI_MAJOR_AXIS_M * (1.0 + FLATTENING + _GRAVITY_RATIO - 2.0 * FLATTENING * sine_squared)
    second = 3.0 / SEMI_MAJOR_AXIS_M**2
    return surface * (1.0 - first * height_m + second * height_m**2)


def mean_radius_m(latitude_rad: float) -> float:
    """Return the Gaussian mean radius of curvature √(M·N) [m] of the WGS-84 ellipsoid."""
    return (
        SEMI_MAJOR_AXIS_M
        * math.sqrt(1.0 - _ECCENTRICITY_SQUARED)
        / (1.0 - _ECCENTRICITY_SQUARED * math.sin(latitude_rad) ** 2)
    )


def earth_rate_tangent_radps(latitude_rad: float, azimuth_rad: float) -> NDArray[np.float64]:
    """Return the Earth's rotation rate (3,) [rad/s] in the tangent frame, eq. (5).

    Axis 1 level along ``azimuth_rad`` (clockwise from north), axis 2 level to its left, axis 3 up.
    """
    level = EARTH_RATE_RADPS * math.cos(latitude_rad)
    return np.array(
        [
            level * math.cos(azimuth_rad),
            level * math.sin(azimuth_rad),
            EARTH_RATE_RADPS * math.sin(latitude_rad),
        ]
    )


@dataclass(frozen=True)
class Site:
    """Where the launcher stands. ``gravity_mps2`` is the magnitude of plumb-bob gravity there."""

    latitude_rad: float
    height_m: float
    gravity_mps2: float

    @classmethod
    def at(cls, latitude_rad: float, height_m: float = 0.0, gravity_mps2: float | None = None) -> Site:
        """Return a site with its surveyed gravity, or with normal gravity where none was surveyed.

        Raises
        ------
        ValueError
            Latitude beyond the poles, height outside −1 to 100 km, or gravity that no place on Earth has.
        """
        if not abs(latitude_rad) <= math.pi / 2:
            raise ValueError(f"latitude {latitude_rad} rad lies beyond a pole; give radians between −π/2 and π/2")
        if not -1e3 <= height_m <= 1e5:
            raise ValueError(f"height {height_m} m is not between −1 and 100 km; give metres above the ellipsoid")
        if gravity_mps2 is None:
            gravity_mps2 = normal_gravity_mps2(latitude_rad, height_m)
        if not 9.4 <= gravity_mps2 <= 9.9:
            raise ValueError(f"gravity {gravity_mps2} m/s² is found nowhere on Earth; give m/s², not mg or Gal")
        return cls(latitude_rad, height_m, gravity_mps2)

    @property
    def radius_m(self) -> float:
        """Distance [m] that the level gravity gradient −g·x/R falls off with."""
        return mean_radius_m(self.latitude_rad) + self.height_m

    def earth_rate_radps(self, azimuth_rad: float) -> NDArray[np.float64]:
        """Return eq. (5) (3,) [rad/s] here for a tangent frame of this azimuth."""
        return earth_rate_tangent_radps(self.latitude_rad, azimuth_rad)
