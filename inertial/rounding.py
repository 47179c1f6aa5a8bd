"""What an integrator read out in whole steps adds to its increments.

The readout rounds the integral, so an increment is the true one plus the difference of two rounding errors. Their
variance is step²/12 each; white they are only when the noise moves the integral by a good part of a step between
samples. Otherwise successive errors are related: with the integral moving by μ steps a sample on average and σ steps
at random, the sawtooth's harmonic h of size 1/(π h) turns by 2π h μ and fades by exp(−2π² h² σ²) (B. Widrow and
I. Kollár, *Quantization Noise*, 2008, ch. 20). A laser gyro without dither is such an instrument.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from inertial.compiled import compiled

Array = npt.NDArray[np.float64]

_HARMONICS = 8
LOOKED_AT = 1 << 16  # readings are enough to show a lattice
_OFF_LATTICE = 0.02  # rms distance from the lattice, in steps; readings on none have 0.29


def increment_step(increments: Array) -> tuple[float, float, float] | None:
    """Find the lattice on which increments lie.

    Parameters
    ----------
    increments : (n,) readings times interval [y·s]

    Returns
    -------
    step, its 1σ, and the lattice's origin [y·s], or None where the increments lie on no lattice that shows.
    """
    values = np.unique(increments)
    if values.size < 2 or values.size > increments.size // 4:
        return None
    gaps = np.diff(values)
    # neighbours closer than that are one step apart from each other by the frame's own finer step only
    step = float(gaps[gaps > 0.05 * gaps.max()].min())
    for _ in range(3):
        index = np.round((values - values[0]) / step)
        step, origin = (float(c) for c in np.polyfit(index, values, 1))
    residual = values - origin - step * index
    rms = float(np.sqrt(np.mean(residual**2)))
    if rms > _OFF_LATTICE * step:
        return None
    return step, rms / float(np.std(index) * np.sqrt(values.size)) + 1e-6 * step, origin


@compiled
def error_spectrum(omega: Array, advance: Array, variance: float) -> Array:
    """Return the spectrum of the rounding error, variance per coefficient in units of step².

    Parameters
    ----------
    omega : (m,) angular frequency [rad per sample]
    advance : (b,) mean motion of the integral [steps per sample], over which the spectrum is averaged
    variance : of its random motion [steps² per sample]
    """
    total = np.full(omega.size, 1.0 / 12.0)
    for h in range(1, _HARMONICS + 1):
        size = 1.0 / (2.0 * np.pi**2 * h**2)
        fade = np.exp(-2.0 * np.pi**2 * h**2 * variance)
        if fade < 1e-4:
            break
        for stretch in range(advance.size):
            turn = 2.0 * np.pi * h * advance[stretch]
            for i in range(omega.size):
                left = 1.0 - 2.0 * fade * np.cos(omega[i] - turn) + fade**2
                right = 1.0 - 2.0 * fade * np.cos(omega[i] + turn) + fade**2
                line = 0.5 * (1.0 - fade**2) * (1.0 / left + 1.0 / right)
                total[i] += size * (line - 1.0) / advance.size
    return total
