"""Error model: eqs (1), (2), (8), (9) by hand, exact inverse, refusal of what cannot be inverted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from inertial.documents import ChannelCoefficients
from inertial.error_model import Coefficients, Terms, readings_from_true, true_from_readings

small = st.floats(-0.2, 0.2)
reading = st.one_of(st.just(0.0), st.floats(-200.0, 200.0), st.floats(-1e-6, 1e-6))


def matrix(draw: st.DrawFn) -> NDArray[np.float64]:
    return np.eye(3) + np.array(draw(st.lists(small, min_size=9, max_size=9))).reshape(3, 3)


@st.composite
def coefficients(draw: st.DrawFn) -> Coefficients:
    def vector() -> NDArray[np.float64]:
        return np.array(draw(st.lists(small, min_size=3, max_size=3)))

    return Coefficients(
        matrix(draw), matrix(draw), vector(), matrix(draw), matrix(draw), vector(), 0.1 * (matrix(draw) - np.eye(3))
    )


def test_equations_by_hand() -> None:
    positive = np.array([[1.1, 0.01, 0.02], [0.03, 1.2, 0.04], [0.05, 0.06, 1.3]])
    negative = np.array([[0.9, -0.01, -0.02], [-0.03, 0.8, -0.04], [-0.05, -0.06, 0.7]])
    c = Coefficients(positive, negative, np.array([1.0, 2.0, 3.0]), positive, negative, np.array([4.0, 5.0, 6.0]))
    c = replace(c, g_sensitivity=np.array([[0.0, 0.5, 0.0], [0.25, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    terms = Terms(np.array([0.1, 0.2, 0.3]), np.array([0.4, 0.5, 0.6]))
    A, G = true_from_readings([[10.0, -20.0, 30.0]], [[-1.0, 2.0, -3.0]], c, terms)
    # x: 1.1·10 (positive) − 0.01·(−20) (negative) + 0.02·30 + 1 + 0.1
    np.testing.assert_allclose(A[0], [11 + 0.2 + 0.6 + 1.1, 0.3 - 16 + 1.2 + 2.2, 0.5 + 1.2 + 39 + 3.3], rtol=1e-15)
    # x: 0.9·(−1) + 0.01·2 − 0.02·(−3) + 4 + 0.4 and F: 0.5·a_y
    np.testing.assert_allclose(
        G[0], [-0.9 + 0.02 + 0.06 + 4.4 - 10, 0.03 + 2.4 + 0.12 + 5.5 + 2.5, 0.05 + 0.12 - 2.1 + 6.6], rtol=1e-14
    )


def test_ideal_block_reads_the_truth() -> None:
    rows = np.random.default_rng(1).normal(size=(50, 3))
    for values in true_from_readings(rows, rows, Coefficients.ideal(), Terms.zero()):
        np.testing.assert_array_equal(values, rows)


@settings(max_examples=200, deadline=None)
@given(coefficients(), st.lists(st.tuples(*[reading] * 6), min_size=1, max_size=8))
def test_inverse_is_exact(c: Coefficients, rows: list[tuple[float, ...]]) -> None:
    try:
        readings_from_true(np.zeros((1, 3)), np.zeros((1, 3)), c)
    except ValueError:
        return  # not one-to-one; that such sets are refused rightly is tested below
    sent = np.array(rows)
    terms = Terms(np.array([0.3, -0.2, 0.1]), np.array([-0.1, 0.2, -0.3]))
    A, G = true_from_readings(sent[:, :3], sent[:, 3:], c, terms)
    accel, gyro = readings_from_true(A, G, c, terms)
    size = 1.0 + np.abs(sent).max()
    assert np.abs(accel - sent[:, :3]).max() <= 1e-12 * size
    assert np.abs(gyro - sent[:, 3:]).max() <= 1e-12 * size


def test_truth_comes_back_from_a_strongly_asymmetric_block() -> None:
    rng = np.random.default_rng(7)
    positive = np.diag([2.0, 0.5, 1.0]) + 0.2 * rng.uniform(-1, 1, (3, 3))
    negative = np.diag([0.5, 2.0, 1.5]) + 0.2 * rng.uniform(-1, 1, (3, 3))
    c = Coefficients(positive, negative, np.array([0.1, -0.2, 0.3]), positive, negative, np.zeros(3))
    truth = rng.normal(size=(20_000, 3))
    A, G = true_from_readings(*readings_from_true(truth, -truth, c), c)
    assert max(np.abs(A - truth).max(), np.abs(G + truth).max()) < 1e-14


@pytest.mark.parametrize(
    "accel_positive",
    [
        np.diag([1.0, 0.0, 1.0]),
        np.diag([1.0, -1.0, 1.0]),
        np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        np.full((3, 3), np.nan),
    ],
    ids=["zero scale", "sign by direction", "row twice", "not finite"],
)
def test_refuses_coefficients_without_an_inverse(accel_positive: NDArray[np.float64]) -> None:
    c = replace(Coefficients.ideal(), accel_positive=accel_positive)
    with pytest.raises(ValueError, match="accelerometer"):
        readings_from_true(np.ones((1, 3)), np.ones((1, 3)), c)


def test_refused_coefficients_really_have_two_readings_for_one_truth() -> None:
    c = replace(Coefficients.ideal(), accel_positive=np.diag([-1.0, 1.0, 1.0]))
    A, _ = true_from_readings([[-2.0, 0.0, 0.0], [2.0, 0.0, 0.0]], np.zeros((2, 3)), c)
    np.testing.assert_array_equal(A[0], A[1])


@settings(max_examples=50, deadline=None)
@given(coefficients())
def test_document_keeps_every_coefficient(c: Coefficients) -> None:
    text = c.to_document().canonical_json()
    back = Coefficients.from_document(ChannelCoefficients.model_validate_json(text))
    for name in vars(c):
        np.testing.assert_array_equal(getattr(back, name), getattr(c, name), err_msg=name)


def test_misalignment_onto_itself_is_refused() -> None:
    document = ChannelCoefficients.model_validate({"gyro_y": {"misalignment_positive": {"gyro_y": 0.1}}})
    with pytest.raises(ValueError, match="gyro_y names gyro_y itself"):
        Coefficients.from_document(document)


def test_wrong_shape_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"gyro values have shape \(3,\)"):
        true_from_readings(np.zeros((1, 3)), np.zeros(3), Coefficients.ideal())
