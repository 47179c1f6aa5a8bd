"""Likelihood of a cosine spectrum under noise variances that are never negative, and where it is greatest."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from inertial.compiled import compiled

Array = npt.NDArray[np.float64]


@compiled
def evaluate(
    v: Array, power: Array, single: Array, freedom: Array, basis: Array, ramp: Array
) -> tuple[float, Array, Array, float, float]:
    """Return log-likelihood, score (4,), Fisher information (4, 4), ramp estimate and its information.

    The ramp is integrated out under a flat prior (restricted likelihood).
    """
    score = np.zeros(4)
    fisher = np.zeros((4, 4))
    weight = 0.0
    moment = 0.0
    for c in range(power.size):
        if ramp[c] != 0.0:
            s = basis[c, 0] * v[0] + basis[c, 1] * v[1] + basis[c, 2] * v[2] + basis[c, 3] * v[3]
            weight += freedom[c] * ramp[c] * ramp[c] / s
            moment += freedom[c] * ramp[c] * single[c] / s
    level = weight == 0.0
    estimate = 0.0 if level else moment / weight
    log_likelihood = 0.0 if level else -0.5 * np.log(weight)
    pull = np.zeros(4)
    for c in range(power.size):
        s = basis[c, 0] * v[0] + basis[c, 1] * v[1] + basis[c, 2] * v[2] + basis[c, 3] * v[3]
        residual2 = power[c] + estimate * ramp[c] * (estimate * ramp[c] - 2.0 * single[c])
        leverage = 0.0 if level else freedom[c] * ramp[c] * ramp[c] / (s * weight)
        ratio = residual2 / s
        log_likelihood -= 0.5 * freedom[c] * (np.log(s) + ratio)
        for i in range(4):
            gi = basis[c, i] / s
            score[i] += 0.5 * gi * (freedom[c] * (ratio - 1.0) + leverage)
            pull[i] += gi * leverage
            for j in range(i + 1):
                fisher[i, j] += 0.5 * gi * basis[c, j] / s * (freedom[c] - 2.0 * leverage)
    for i in range(4):
        for j in range(i + 1):
            fisher[i, j] += 0.5 * pull[i] * pull[j]
            fisher[j, i] = fisher[i, j]
    return log_likelihood, score, fisher, estimate, weight


@compiled
def _solve(a: Array, b: Array) -> None:
    """Solve a x = b, a symmetric positive definite, by elimination in place; x is left in b."""
    m = b.size
    for c in range(m):
        for r in range(c + 1, m):
            factor = a[r, c] / a[c, c]
            for q in range(c, m):
                a[r, q] -= factor * a[c, q]
            b[r] -= factor * b[c]
    for c in range(m - 1, -1, -1):
        for q in range(c + 1, m):
            b[c] -= a[c, q] * b[q]
        b[c] /= a[c, c]


@compiled
def _bounded_step(v: Array, score: Array, fisher: Array, fixed: int) -> tuple[Array, float]:
    """Return the quadratic model's maximum over v ≥ 0 and its gain; terms in the bit mask ``fixed`` stay."""
    scale = np.empty(4)
    for i in range(4):
        scale[i] = 1.0 / np.sqrt(fisher[i, i])
    gain_best = 0.0
    best = v.copy()
    for mask in range(16):
        if mask & fixed:
            continue
        free = np.empty(4, np.int64)
        m = 0
        delta = np.zeros(4)
        for i in range(4):
            if mask >> i & 1:
                free[m] = i
                m += 1
            elif not fixed >> i & 1:
                delta[i] = -v[i] / scale[i]
        a = np.zeros((m, m))
        b = np.zeros(m)
        for r in range(m):
            i = free[r]
            b[r] = score[i] * scale[i]
            for j in range(4):
                b[r] -= fisher[i, j] * scale[i] * scale[j] * delta[j]
            for q in range(m):
                a[r, q] = fisher[i, free[q]] * scale[i] * scale[free[q]]
            a[r, r] += 1e-10
        if m > 0:
            _solve(a, b)
            for r in range(m):
                delta[free[r]] = b[r]
        feasible = True
        gain = 0.0
        for i in range(4):
            if not fixed >> i & 1 and v[i] + delta[i] * scale[i] < 0.0:
                # a parameter held at zero lands there only to rounding
                feasible = feasible and not (mask >> i & 1)
            gain += score[i] * scale[i] * delta[i]
            for j in range(4):
                gain -= 0.5 * delta[i] * fisher[i, j] * scale[i] * scale[j] * delta[j]
        if feasible and gain > gain_best:
            gain_best = gain
            for i in range(4):
                best[i] = v[i] if fixed >> i & 1 else max(v[i] + delta[i] * scale[i], 0.0)
    return best, gain_best


@compiled
def maximise(
    start: Array,
    fixed: int,
    power: Array,
    single: Array,
    freedom: Array,
    basis: Array,
    ramp: Array,
) -> tuple[Array, float]:
    """Climb from ``start`` by Fisher scoring with step halving; variances in the bit mask ``fixed`` stay."""
    v = start.copy()
    value, score, fisher, _, _ = evaluate(v, power, single, freedom, basis, ramp)
    for _ in range(100):
        target, gain = _bounded_step(v, score, fisher, fixed)
        if gain < 1e-9:
            break
        moved = False
        step = 1.0
        for _ in range(30):
            trial = v + step * (target - v)
            trial_value, s, f, _, _ = evaluate(trial, power, single, freedom, basis, ramp)
            if trial_value > value:
                v, value, score, fisher, moved = trial, trial_value, s, f, True
                break
            step *= 0.5
        if not moved:
            break
    return v, value
