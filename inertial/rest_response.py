"""What a block at rest makes of sensor errors: the linear response of velocity and attitude, and its noise.

At rest the state (δv, φ) in the tangent frame, φ the rotation vector of C·C₀ᵀ, obeys, from δv = φ = 0 ::

    δv̇ = δa + φ × (0, 0, γ) − c·ω_t × δv        φ̇ = δω − ω_t × φ

to first order in the accelerometer and gyro errors δa, δω (tangent axes). Everything that the chained stages and their
verification do at rest is a weighted sum of δa and δω over time, so their covariances follow exactly from the noise
integrated over short spans (:mod:`inertial.increment_covariance`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from inertial.attitude import skew
from inertial.documents import Noise
from inertial.error_model import Terms
from inertial.increment_covariance import integral_covariance

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AtRest:
    """What an estimate makes of the readings of a block that goes on standing as it did.

    ``terms`` to apply, attitude ``C_tb`` (3, 3) and ``azimuth_rad`` that they go with. The compensated readings
    (f x, y, z [m/s²], g x, y, z [rad/s], body axes) are then off by ``weights`` (6, b, 6) on the mean noise of each
    sensor over ``spans_s`` (b, 2), and by a constant of covariance ``offset`` (6, 6) that is independent of noise: what
    the reference still shows at this attitude.
    """

    terms: Terms
    C_tb: Array
    azimuth_rad: float
    weights: Array
    spans_s: Array
    offset: Array


def transition(duration_s: float, gravity_mps2: float, earth_rate_radps: Array, coriolis: float) -> tuple[Array, Array]:
    """Return (Φ, Γ), each (6, 6): state after a span of constant errors e is Φ·state + Γ·e."""
    dynamics = np.zeros((12, 12))
    dynamics[0:3, 0:3] = -coriolis * skew(earth_rate_radps)
    dynamics[0:3, 3:6] = -skew(np.array([0.0, 0.0, gravity_mps2]))
    dynamics[3:6, 3:6] = -skew(earth_rate_radps)
    dynamics[0:6, 6:12] = np.eye(6)
    whole = expm(dynamics * duration_s)
    return whole[0:6, 0:6], whole[0:6, 6:12]


def node_response(
    duration_s: float, nodes: int, parts: int, gravity_mps2: float, earth_rate_radps: Array, coriolis: float
) -> Array:
    """Return the state at each of ``nodes`` equal steps of a stage to the errors in each of its spans.

    Returns
    -------
    (nodes, nodes·parts, 6, 6)
        State (δv, φ) at node k + 1 from the mean error (δa, δω) over span j, ``parts`` spans between two nodes.
    """
    spans = nodes * parts
    phi, gamma = transition(duration_s / spans, gravity_mps2, earth_rate_radps, coriolis)
    by_age = np.empty((spans, 6, 6))  # response to a span that began `age + 1` spans ago
    by_age[0] = gamma
    for age in range(1, spans):
        by_age[age] = phi @ by_age[age - 1]
    response = np.zeros((nodes, spans, 6, 6))
    for node in range(nodes):
        past = (node + 1) * parts
        response[node, :past] = by_age[past - 1 :: -1]
    return response


def functional_covariance(weights: Array, spans_s: Array, noise: Noise, reference_s: float) -> Array:
    """Return the covariance (m, m) of m weighted sums of the sensors' noise.

    Parameters
    ----------
    weights : (m, b, 6)
        Of the mean noise of each sensor (accelerometers x, y, z, gyros x, y, z) over each span.
    spans_s : (b, 2)
        Start and end [s].
    reference_s
        Instant at which a random walk is zero by definition.
    """
    channels = [noise.accel_x, noise.accel_y, noise.accel_z, noise.gyro_x, noise.gyro_y, noise.gyro_z]
    per_integral = weights / (spans_s[:, 1] - spans_s[:, 0])[:, None]
    known = {channel: integral_covariance(channel, spans_s, reference_s=reference_s) for channel in channels}
    total = np.zeros((len(weights), len(weights)))
    for index, channel in enumerate(channels):
        total += per_integral[:, :, index] @ known[channel] @ per_integral[:, :, index].T
    return total
