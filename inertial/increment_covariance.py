"""Covariance of integrated sensor noise over spans of time, from the noise terms of IEEE 952.

An increment is the integral of the sensor's output, so its noise is the integral of the sensor's noise. For stationary
noise with autocovariance R the integrals over spans (a, b) and (c, d) have covariance::

    D(d − a) + D(c − b) − D(c − a) − D(d − b)      with   D(τ) = ∫₀^τ (τ − u)·R(u) du,  D even

which is exact for any spans: with gaps between them, of unequal length, far apart, past and future.

* white, two-sided density N²:  D = N²·|τ|/2
* flicker, two-sided density B²/(2π|f|): relaxations of all times up to :data:`FLICKER_LONGEST_S`, evenly in their
  logarithm, so R(t) = B²/π·E₁(t/longest) and D in closed form
* random walk K: referred to an instant, where it is zero by definition, so that the term estimated beside it is the
  sensor's shift *at that instant*
* quantisation: the running total is rounded to a step q; a span's error is the rounding at its end less that at its
  start, each of variance q²/12
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import exp1

from inertial.documents import ChannelNoise

Array = NDArray[np.float64]

FLICKER_LONGEST_S = 2e4
"""What relaxes more slowly than this is no noise but part of the shift: a working day on the launcher."""

_SAME_INSTANT_S = 1e-5  # device clocks resolve 1 µs


def integral_covariance(
    noise: ChannelNoise, spans_s: Array, others_s: Array | None = None, reference_s: float = 0.0
) -> Array:
    """Return the covariance (n, m) of the noise integrated over ``spans_s`` (n, 2) and ``others_s`` (m, 2).

    Parameters
    ----------
    noise
        Terms of one channel; y = m/s² or rad/s, so the result is in (y·s)².
    spans_s, others_s
        Start and end of each span [s]; the others are the spans themselves unless given.
    reference_s
        Instant [s] at which the random walk is zero.
    """
    return integral_covariances([noise], spans_s, others_s, reference_s)[0]


def integral_covariances(
    noises: Sequence[ChannelNoise], spans_s: Array, others_s: Array | None = None, reference_s: float = 0.0
) -> list[Array]:
    """Return :func:`integral_covariance` of several channels, their common shapes worked out once."""
    others = spans_s if others_s is None else others_s
    a, b = spans_s[:, 0, None], spans_s[:, 1, None]
    c, d = others[None, :, 0], others[None, :, 1]
    # The spans' overlap is what the D form comes to for white noise, without its rounding.
    shapes = {"white": np.maximum(np.minimum(b, d) - np.maximum(a, c), 0.0)}
    if any(noise.flicker for noise in noises):
        shapes["flicker"] = _flicker(d - a) + _flicker(c - b) - _flicker(c - a) - _flicker(d - b)
    if any(noise.random_walk for noise in noises):
        shapes["random_walk"] = _random_walk(a - reference_s, b - reference_s, c - reference_s, d - reference_s)
    if any(noise.quantisation for noise in noises):
        shapes["quantisation"] = (_same(b, d) + _same(a, c) - _same(b, c) - _same(a, d)) / 12.0
    zero = np.zeros(np.broadcast_shapes(a.shape, c.shape))
    return [sum((getattr(noise, name) ** 2 * shape for name, shape in shapes.items()), zero) for noise in noises]


def _flicker(lag_s: Array) -> Array:
    """Return D for B = 1: with x = |τ|/longest, longest²/π·(x²·E₁(x)/2 + x − (1 + (x − 1)·e⁻ˣ)/2)."""
    x = np.maximum(np.abs(lag_s) / FLICKER_LONGEST_S, 1e-30)
    curve = 0.5 * x * x * exp1(x) + x + 0.5 * ((1.0 - x) * np.exp(-x) - 1.0)
    return np.asarray(FLICKER_LONGEST_S**2 / math.pi * curve)


def _random_walk(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return ∫∫ min(|s|, |t|) ds dt over (a, b) × (c, d) where s, t are on one side of zero, else 0."""
    after = _ramp_overlap(np.maximum(a, 0), np.maximum(b, 0), np.maximum(c, 0), np.maximum(d, 0))
    before = _ramp_overlap(np.maximum(-b, 0), np.maximum(-a, 0), np.maximum(-d, 0), np.maximum(-c, 0))
    return after + before


def _ramp_overlap(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return ∫∫ min(s, t) ds dt over positive spans, as the fourth difference of its second antiderivative."""
    return _ramp(b, d) - _ramp(b, c) - _ramp(a, d) + _ramp(a, c)


def _ramp(s: Array, t: Array) -> Array:
    """Return ∫₀^s∫₀^t min(u, v) du dv = m²·(3M − m)/6 with m the smaller and M the larger."""
    small, large = np.minimum(s, t), np.maximum(s, t)
    return np.asarray(small**2 * (3.0 * large - small) / 6.0)


def _same(first: Array, second: Array) -> Array:
    return (np.abs(first - second) < _SAME_INSTANT_S).astype(np.float64)
