"""Square-root covariance Kalman filter for unknowns that stand still, and the batch least squares that checks it.

The covariance is carried as a root, P = S·Sᵀ, so that it can lose neither symmetry nor sign however exact a
measurement is (the paper's [13]; here the array form of Kailath, Sayed & Hassibi, *Linear Estimation*, section 12.2).
For ``z = H·x + v`` with ``cov v = V·Vᵀ`` an orthogonal rotation Θ makes the left array triangular::

    [ V   H·S ]       [ E   0  ]        E·Eᵀ = H·P·Hᵀ + V·Vᵀ       x ← x + K̄·E⁻¹·(z − H·x)
    [ 0    S  ] Θ  =  [ K̄   S' ]        S'·S'ᵀ = P after the measurement
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

Array = NDArray[np.float64]


class SquareRootFilter:
    """Estimate of constant unknowns, measurement by measurement.

    Parameters
    ----------
    mean : (n,)
        What is believed at first.
    root : (n, n)
        Any root S of the first covariance.
    """

    def __init__(self, mean: Array, root: Array) -> None:
        self.mean = np.array(mean, dtype=np.float64)
        self.root = np.array(root, dtype=np.float64)
        self.chi_square = 0.0

    @property
    def covariance(self) -> Array:
        """Return P = S·Sᵀ (n, n)."""
        return np.asarray(self.root @ self.root.T)

    def update(self, z: Array, H: Array, noise_root: Array) -> Array:
        """Take a measurement (m,) with its rows (m, n) and the root (m, m) of its noise.

        Returns
        -------
        innovation : (m,)
            ``z − H·x`` before the update in units of its own root E: independent and of unit variance if the model
            holds. Its squares add up in ``chi_square``.
        """
        m, n = H.shape
        before = np.block([[noise_root, H @ self.root], [np.zeros((n, m)), self.root]])
        after = np.asarray(np.linalg.qr(before.T, mode="r")).T
        innovation = np.asarray(solve_triangular(after[:m, :m], z - H @ self.mean, lower=True))
        self.mean += after[m:, :m] @ innovation
        self.root = after[m:, m:]
        self.chi_square += float(innovation @ innovation)
        return innovation


def batch_least_squares(z: Array, H: Array, sigma: Array, prior_sigma: Array) -> tuple[Array, Array]:
    """Return mean (n,) and covariance (n, n) from all measurements at once, about a prior of zero.

    Parameters
    ----------
    z, H, sigma : (m,), (m, n), (m,)
        Measurements, rows, and 1σ of independent noise.
    prior_sigma : (n,)
        1σ of the unknowns before.
    """
    # In units of the prior: its information is the identity, and no column is out of scale with another.
    rows = np.vstack([H * prior_sigma / sigma[:, None], np.eye(len(prior_sigma))])
    target = np.concatenate([z / sigma, np.zeros(len(prior_sigma))])
    Q, R = np.linalg.qr(rows)
    mean = solve_triangular(R, Q.T @ target)
    spread = solve_triangular(R, np.eye(len(R))) * prior_sigma[:, None]
    return np.asarray(mean * prior_sigma), np.asarray(spread @ spread.T)
