"""Spans without gaps: what is lost is interpolated, counted, and never touches what came."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from inertial.error_model import Coefficients, Terms
from inertial.increments import Increments, increments_of

INTERVAL = 0.01


def samples(count: int = 50, seed: int = 0) -> tuple[NDArray[np.float64], ...]:
    rng = np.random.default_rng(seed)
    return (
        np.arange(count, dtype=np.float64) + 2**32 - 10,  # the counter wraps inside
        100.0 + INTERVAL * np.arange(1, count + 1),
        rng.normal(size=(count, 3)),
        rng.normal(size=(count, 3)),
        np.full(count, INTERVAL),
    )


def span(rows: tuple[NDArray[np.float64], ...], keep: NDArray[np.bool_] | None = None) -> Increments:
    sequence, *rest = rows
    counter = (sequence.astype(np.int64) % 2**32).astype(np.uint32)
    chosen = np.ones(len(counter), dtype=bool) if keep is None else keep
    return increments_of(counter[chosen], *(column[chosen] for column in rest))


def test_whole_span_is_taken_as_sent() -> None:
    rows = samples()
    whole = span(rows)
    np.testing.assert_array_equal(whole.dv_mps, rows[2])
    np.testing.assert_array_equal(whole.dtheta_rad, rows[3])
    assert (whole.repaired, len(whole)) == (0, 50)
    assert whole.start_s == pytest.approx(100.0)
    assert whole.duration_s == pytest.approx(0.5)


def test_lost_samples_lie_on_the_line_between_their_neighbours() -> None:
    rows = samples()
    keep = np.ones(50, dtype=bool)
    keep[[8, 9, 10, 30]] = False
    whole = span(rows, keep)
    assert (whole.repaired, len(whole)) == (4, 50)
    assert whole.duration_s == pytest.approx(0.5)
    np.testing.assert_array_equal(whole.dv_mps[keep], rows[2][keep])
    np.testing.assert_array_equal(whole.dtheta_rad[keep], rows[3][keep])
    expected = rows[2][7] + np.outer([0.25, 0.5, 0.75], rows[2][11] - rows[2][7])
    np.testing.assert_allclose(whole.dv_mps[8:11], expected, atol=1e-14)
    np.testing.assert_allclose(whole.dtheta_rad[30], (rows[3][29] + rows[3][31]) / 2, atol=1e-14)


def test_repair_of_a_steady_span_changes_nothing() -> None:
    sequence, time, dv, dtheta, interval = samples()
    steady = (sequence, time, np.tile([0.1, -0.2, 0.098], (50, 1)), np.tile([1e-6, 2e-6, -3e-6], (50, 1)), interval)
    keep = np.arange(50) % 7 != 3
    np.testing.assert_allclose(span(steady, keep).dv_mps, steady[2], rtol=1e-14)
    assert dv.shape == dtheta.shape


def test_repair_is_the_same_every_time() -> None:
    keep = np.random.default_rng(5).random(50) > 0.2
    keep[[0, -1]] = True
    first, second = span(samples(), keep), span(samples(), keep)
    assert first.dv_mps.tobytes() == second.dv_mps.tobytes()
    assert first.dtheta_rad.tobytes() == second.dtheta_rad.tobytes()


def test_coefficients_and_terms_act_on_each_reading() -> None:
    # S⁺ = 1.1, S⁻ = 0.9 on x: readings ±2 m/s² become 2.2 and −1.8, plus f.
    c = Coefficients(accel_positive=np.diag([1.1, 1.0, 1.0]), accel_negative=np.diag([0.9, 1.0, 1.0]))
    dv = np.array([[0.02, 0.0, 0.0], [-0.04, 0.0, 0.0]])
    window = Increments(0.0, dv, np.zeros((2, 3)), np.array([0.01, 0.02]))
    true_dv, _ = window.true(c, Terms(np.array([0.5, 0.0, 0.0]), np.zeros(3)))
    np.testing.assert_allclose(true_dv[:, 0], [(2.2 + 0.5) * 0.01, (-1.8 + 0.5) * 0.02], rtol=1e-13)


def test_what_does_not_fit_is_refused() -> None:
    _, time, dv, dtheta, interval = samples()
    with pytest.raises(ValueError, match="sample 1: the sequence does not increase"):
        increments_of(np.zeros(50), time, dv, dtheta, interval)
    with pytest.raises(ValueError, match="do not match"):
        increments_of(np.arange(50), time, dv[:3], dtheta, interval)
    with pytest.raises(ValueError, match="sample 4: the interval"):
        increments_of(np.arange(50), time, dv, dtheta, np.where(np.arange(50) == 4, 0.0, interval))
