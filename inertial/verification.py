"""Proof of the terms on fresh data: navigation at rest with the terms in, against what their covariance predicts.

From C₀ and zero velocity over a window that the terms have not seen, velocity and attitude should stay zero to within
the noise that went into the terms, carried through the window, and the window's own. Both are sums over the same
sensors' noise, so slow noise that the two share is not counted twice. Errors of the reference's level and azimuth are
inside the terms and cancel at the same attitude: they are not tested here, but where stages in two attitudes disagree
about them. The squared length of the six errors in their own covariance is χ² with six degrees of freedom.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from inertial.attitude import rotation_vector
from inertial.compensation import body_to_tangent_pair, reading_sensitivity
from inertial.documents import Noise
from inertial.earth import Site
from inertial.error_model import Coefficients, Terms
from inertial.increments import Increments
from inertial.rest_response import AtRest, functional_covariance, node_response
from inertial.strapdown import CORIOLIS, navigate

Array = NDArray[np.float64]

CONFIDENCE = 0.999
_SPANS = 50


@dataclass(frozen=True)
class Verification:
    """Navigation errors at the end of the window, tangent axes, with what was predicted.

    ``velocity_mps`` (3,), ``attitude_rad`` (3,) rotation vector of C·C₀ᵀ; ``covariance`` (6, 6) predicted of both;
    ``statistic`` their χ² and ``limit`` its 99.9 % point.
    """

    velocity_mps: Array
    attitude_rad: Array
    covariance: Array
    statistic: float
    limit: float
    duration_s: float

    @property
    def passed(self) -> bool:
        """Return whether the errors lie within what the covariance predicts."""
        return self.statistic <= self.limit

    @property
    def sigma(self) -> Array:
        """Return the predicted 1σ (6,) of velocity [m/s] and attitude [rad]."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def rest_errors(
    window: Increments, C_tb: Array, azimuth_rad: float, site: Site, coefficients: Coefficients, terms: Terms
) -> tuple[Array, Array]:
    """Return velocity [m/s] and rotation vector of C·C₀ᵀ [rad], each (3,), after navigating a window from rest."""
    dv, dtheta = window.true(coefficients, terms)
    motion = navigate(dv, dtheta, window.interval_s, C_tb, site, azimuth_rad, gravity_gradient=False)
    return motion.velocity_mps[-1].copy(), rotation_vector(motion.C_tb[-1] @ C_tb.T)


def verify(window: Increments, found: AtRest, site: Site, coefficients: Coefficients, noise: Noise) -> Verification:
    """Navigate a fresh window at rest with the terms found and compare with the prediction.

    Parameters
    ----------
    window
        Later than the windows of the estimate and apart from them.
    noise
        The one the estimate's covariance was made with.
    """
    velocity, attitude = rest_errors(window, found.C_tb, found.azimuth_rad, site, coefficients, found.terms)
    turn = body_to_tangent_pair(found.C_tb)
    earth_rate = site.earth_rate_radps(found.azimuth_rad)
    response = node_response(window.duration_s, 1, _SPANS, site.gravity_mps2, earth_rate, CORIOLIS)[0] @ turn
    fresh = (response @ reading_sensitivity([window], coefficients)).transpose(1, 0, 2)
    whole = response.sum(axis=0)
    carried = np.einsum("ab,bjc->ajc", whole, found.weights)
    edges = window.start_s + np.linspace(0.0, window.duration_s, _SPANS + 1)
    spans = np.vstack([found.spans_s, np.column_stack([edges[:-1], edges[1:]])])
    weights = np.concatenate([carried, fresh], axis=1)
    covariance = functional_covariance(weights, spans, noise, reference_s=float(found.spans_s[-1, 1]))
    covariance += whole @ found.offset @ whole.T
    return Verification(
        velocity,
        attitude,
        covariance,
        *consistency(np.concatenate([velocity, attitude]), covariance),
        window.duration_s,
    )


def consistency(errors: Array, covariance: Array) -> tuple[float, float]:
    """Return χ² of errors (n,) in their covariance (n, n), and the limit they pass at 99.9 %."""
    scale = np.sqrt(np.diag(covariance))
    scaled = errors / scale
    statistic = float(scaled @ np.linalg.solve(covariance / np.outer(scale, scale), scaled))
    return statistic, float(chdtri(len(errors), 1.0 - CONFIDENCE))
