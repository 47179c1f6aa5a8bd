"""Earth: published WGS-84 values (NIMA TR8350.2, table 3.4 and 3.3) and the signs of eq. (5)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from inertial.earth import EARTH_RATE_RADPS, Site, earth_rate_tangent_radps, mean_radius_m, normal_gravity_mps2


def test_gravity_at_equator_and_pole_is_as_published() -> None:
    assert normal_gravity_mps2(0.0) == pytest.approx(9.7803253359, abs=1e-10)
    assert normal_gravity_mps2(math.pi / 2) == pytest.approx(9.8321849378, abs=2e-10)
    assert normal_gravity_mps2(-math.pi / 2) == pytest.approx(9.8321849378, abs=2e-10)


def test_mean_of_gravity_over_the_ellipsoid_is_as_published() -> None:
    # Weighted by the area of the ellipsoid's zones, M·N·cos(latitude); published 9.7976432222 m/s².
    node, weight = np.polynomial.legendre.leggauss(40)
    latitude = node * math.pi / 2
    zone = np.array([mean_radius_m(x) ** 2 * math.cos(x) for x in latitude]) * weight
    gravity = np.array([normal_gravity_mps2(x) for x in latitude])
    assert zone @ gravity / zone.sum() == pytest.approx(9.7976432222, abs=1e-9)


def test_gravity_falls_off_with_height_by_the_free_air_gradient() -> None:
    # 0.30877·(1 − 0.00142 sin²φ) mGal/m at the ellipsoid (Heiskanen & Moritz 1967, eq. 2-124, rounded).
    latitude = math.radians(45.0)
    gradient = (normal_gravity_mps2(latitude, 10.0) - normal_gravity_mps2(latitude, -10.0)) / 20.0
    assert gradient == pytest.approx(-0.30877e-5 * (1 - 0.00142 / 2), rel=2e-4)


def test_gravity_at_an_aircrafts_height_agrees_with_the_inverse_square_law() -> None:
    # GM/r² less the centrifugal part, on the equator where both are along the plumb line; J2 is worth 3/2·J2·(a/r)².
    gm, a, j2, height = 3.986004418e14, 6378137.0, 1.082629821e-3, 10_000.0
    r = a + height
    expected = gm / r**2 * (1 + 1.5 * j2 * (a / r) ** 2) - EARTH_RATE_RADPS**2 * r
    assert normal_gravity_mps2(0.0, height) == pytest.approx(expected, abs=5e-5)


def test_radius_agrees_with_published_radii_of_curvature() -> None:
    assert mean_radius_m(math.pi / 2) == pytest.approx(6399593.6258, abs=1e-3)
    assert mean_radius_m(0.0) == pytest.approx(math.sqrt(6335439.3273 * 6378137.0), abs=1e-3)
    assert Site.at(0.0, 1234.0).radius_m == pytest.approx(mean_radius_m(0.0) + 1234.0)


def test_earth_rate_points_north_and_up_in_the_north() -> None:
    latitude = math.radians(30.0)
    level, up = EARTH_RATE_RADPS * math.cos(latitude), EARTH_RATE_RADPS / 2
    northward = earth_rate_tangent_radps(latitude, 0.0)
    np.testing.assert_allclose(northward, [level, 0.0, up], atol=1e-18)
    # Facing east, north is to the left; facing south, behind; facing west, to the right.
    np.testing.assert_allclose(earth_rate_tangent_radps(latitude, math.pi / 2), [0.0, level, up], atol=1e-18)
    np.testing.assert_allclose(earth_rate_tangent_radps(latitude, math.pi), [-level, 0.0, up], atol=1e-18)
    np.testing.assert_allclose(earth_rate_tangent_radps(latitude, -math.pi / 2), [0.0, -level, up], atol=1e-18)
    assert earth_rate_tangent_radps(-latitude, 0.0)[2] == pytest.approx(-up)


def test_site_takes_surveyed_gravity_over_the_normal_one() -> None:
    assert Site.at(0.6, 100.0, 9.8).gravity_mps2 == 9.8
    assert Site.at(0.6, 100.0).gravity_mps2 == normal_gravity_mps2(0.6, 100.0)


@pytest.mark.parametrize(
    ("latitude", "height", "gravity", "word"),
    [
        (35.7, 0.0, None, "latitude"),
        (0.6, 2e5, None, "height"),
        (0.6, 0.0, 980.0, "gravity"),
        (math.nan, 0.0, None, "latitude"),
    ],
)
def test_site_refuses_what_is_nowhere(latitude: float, height: float, gravity: float | None, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        Site.at(latitude, height, gravity)
