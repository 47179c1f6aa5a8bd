"""Attitude: each sign by a physical example, and scipy's Rotation as the independent reference."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from inertial.attitude import (
    body_to_tangent,
    matrix_of_quaternion,
    quaternion,
    roll_pitch_heading,
    rotation_matrix,
    rotation_vector,
    skew,
)

FORWARD, LEFT, UP = np.eye(3)
SMALL = math.radians(10.0)
angle = st.floats(-math.pi, math.pi)


def test_level_block_along_the_azimuth_has_body_axes_along_tangent_axes() -> None:
    np.testing.assert_array_equal(body_to_tangent(0.0, 0.0, 0.0), np.eye(3))


def test_positive_pitch_lifts_the_nose() -> None:
    assert (body_to_tangent(0.0, SMALL, 0.0) @ FORWARD)[2] == pytest.approx(math.sin(SMALL))


def test_positive_roll_lowers_the_right_side() -> None:
    assert (body_to_tangent(SMALL, 0.0, 0.0) @ -LEFT)[2] == pytest.approx(-math.sin(SMALL))


def test_positive_heading_turns_the_nose_right() -> None:
    nose = body_to_tangent(0.0, 0.0, SMALL) @ FORWARD
    assert nose[1] == pytest.approx(-math.sin(SMALL))


def test_block_at_rest_reads_gravity_up() -> None:
    # Specific force is +g along tangent up; nose up, the forward accelerometer sees +g·sin(pitch).
    reading = body_to_tangent(0.0, SMALL, 1.0).T @ (9.8 * UP)
    np.testing.assert_allclose(reading, [9.8 * math.sin(SMALL), 0.0, 9.8 * math.cos(SMALL)], atol=1e-15)
    # Right side down, the left accelerometer points up a little.
    assert (body_to_tangent(SMALL, 0.0, 0.0).T @ (9.8 * UP))[1] == pytest.approx(9.8 * math.sin(SMALL))


@given(angle, angle, angle)
def test_matrix_is_the_stated_product_of_turns(roll: float, pitch: float, heading: float) -> None:
    expected = Rotation.from_euler("ZYX", [-heading, -pitch, roll]).as_matrix()
    np.testing.assert_allclose(body_to_tangent(roll, pitch, heading), expected, atol=1e-14)


@given(angle, st.floats(-1.57, 1.57), angle)
def test_angles_come_back(roll: float, pitch: float, heading: float) -> None:
    C = body_to_tangent(roll, pitch, heading)
    np.testing.assert_allclose(body_to_tangent(*roll_pitch_heading(C)), C, atol=1e-12)
    np.testing.assert_allclose(roll_pitch_heading(C)[1], pitch, atol=1e-12)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_nose_straight_up_keeps_the_attitude_though_not_the_angles(pitch: float) -> None:
    C = body_to_tangent(0.3, pitch, 0.5)
    roll, _, _ = roll_pitch_heading(C)
    assert roll == 0.0
    np.testing.assert_allclose(body_to_tangent(*roll_pitch_heading(C)), C, atol=1e-12)


def test_rotation_vector_turns_right_handed() -> None:
    np.testing.assert_allclose(rotation_matrix(math.pi / 2 * UP) @ FORWARD, LEFT, atol=1e-15)
    np.testing.assert_allclose(rotation_vector(rotation_matrix(np.array([0.1, -0.2, 0.3]))), [0.1, -0.2, 0.3])
    np.testing.assert_allclose(skew(FORWARD) @ LEFT, UP)


def test_quaternions_are_scalar_first() -> None:
    np.testing.assert_allclose(quaternion(np.eye(3)), [1.0, 0.0, 0.0, 0.0])
    C = body_to_tangent(0.1, 0.2, 0.3)
    np.testing.assert_allclose(matrix_of_quaternion(quaternion(C)), C, atol=1e-15)
