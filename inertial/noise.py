"""Noise of a block's channels identified from a record at rest: quantisation, white, flicker, random walk and ramp.

What is fitted is the power spectrum (:mod:`inertial.noise_spectrum`, with the definition of each term), not the Allan
curve (:mod:`inertial.allan`), whose points are correlated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from inertial.documents import ChannelNoise, Noise
from inertial.noise_fit import NORMAL_975, SEEN_SIGMA, ChannelFit, NoiseTerm
from inertial.noise_spectrum import FLICKER, QUANTISATION, WALK, WHITE, cosine_spectrum

__all__ = ["MINIMUM_SAMPLES", "NoiseFit", "NoiseTerm", "identify_noise", "noise_of_block"]

Array = npt.NDArray[np.float64]

MINIMUM_SAMPLES = 64
_FLICKER_ALLAN = 2.0 * np.log(2.0) / np.pi


@dataclass(frozen=True)
class NoiseFit:
    """Noise of one channel; y is the channel's unit, m/s² or rad/s.

    Attributes
    ----------
    quantisation : step of the increments [y·s]
    white : angle or velocity random walk [y/√Hz]
    flicker : bias instability [y], the Allan floor divided by 0.664
    random_walk : rate random walk [y/√s]
    ramp : rate ramp [y/s], signed
    misfit : mean squared standardised residual of the spectrum; 1 when the five terms explain it
    interval_s, samples : the record's
    """

    quantisation: NoiseTerm
    white: NoiseTerm
    flicker: NoiseTerm
    random_walk: NoiseTerm
    ramp: NoiseTerm
    misfit: float
    interval_s: float
    samples: int

    def allan_deviation(self, averaging_s: npt.ArrayLike) -> Array:
        """Return the Allan deviation [y] of the fitted terms at averaging times [s] (IEEE Std 952-1997, C.1)."""
        tau = np.asarray(averaging_s, dtype=np.float64)
        variance = (
            self.quantisation.value**2 / (4.0 * tau**2)
            + self.white.value**2 / tau
            + _FLICKER_ALLAN * self.flicker.value**2
            + self.random_walk.value**2 * tau / 3.0
            + self.ramp.value**2 * tau**2 / 2.0
        )
        return np.asarray(np.sqrt(variance))


def identify_noise(rate: npt.ArrayLike, interval_s: float) -> NoiseFit:
    """Fit the five noise terms of IEEE Std 952 to one channel at rest.

    Parameters
    ----------
    rate : (n,) readings [m/s² or rad/s], each the mean over its interval (increment divided by interval)
    interval_s : sampling interval [s]

    Returns
    -------
    NoiseFit
        Terms not seen carry their most likely value (often 0) and an interval that starts at 0. That of a term just
        seen may reach 0 as well: of those too small to be seen, only the ones that chance enlarged are.

    Raises
    ------
    ValueError
        When the record is too short, not finite, not one channel, or constant.
    """
    readings = _checked(rate, interval_s)
    if np.ptp(readings) == 0.0:
        raise ValueError("all readings are equal: the channel is stuck or its increments are too coarse to show noise")
    fit = ChannelFit(cosine_spectrum(readings, interval_s))
    return NoiseFit(
        quantisation=fit.term(QUANTISATION, readings.size),
        white=fit.term(WHITE, readings.size),
        flicker=fit.term(FLICKER, readings.size),
        random_walk=fit.term(WALK, readings.size),
        ramp=fit.ramp(),
        misfit=fit.misfit,
        interval_s=interval_s,
        samples=readings.size,
    )


def noise_of_block(accel_mps2: npt.ArrayLike, gyro_radps: npt.ArrayLike, interval_s: float) -> Noise:
    """Find the noise of all six channels from a record at rest, to weight an estimate with.

    Most likely values; the white noise is never below what the record can exclude (a channel whose quantisation hides
    it gets its 95 % upper limit), so that σ built from it is not optimistic. A constant channel gets zeros.

    Parameters
    ----------
    accel_mps2, gyro_radps : (n, 3) readings
    interval_s : sampling interval [s]
    """
    accel, gyro = np.asarray(accel_mps2, dtype=np.float64), np.asarray(gyro_radps, dtype=np.float64)
    if accel.ndim != 2 or accel.shape[1] != 3 or gyro.shape != accel.shape:
        raise ValueError(f"accel and gyro must both be (n, 3), got {accel.shape} and {gyro.shape}")
    found = {
        f"{kind}_{axis}": _channel_noise(data[:, column], interval_s)
        for kind, data in (("accel", accel), ("gyro", gyro))
        for column, axis in enumerate("xyz")
    }
    return Noise(**found)


def _channel_noise(rate: Array, interval_s: float) -> ChannelNoise:
    readings = _checked(rate, interval_s)
    if np.ptp(readings) == 0.0:
        return ChannelNoise()
    fit = ChannelFit(cosine_spectrum(readings, interval_s))
    quantisation, white, flicker, walk = (float(np.sqrt(v)) for v in fit.best)
    if fit.significance(WHITE) < SEEN_SIGMA:
        white = fit.limit(WHITE, -NORMAL_975)
    quantisation = float(np.hypot(quantisation, fit.excess_step()))
    if fit.rounded is not None:
        quantisation = max(quantisation, fit.rounded.value)
    return ChannelNoise(white=white, flicker=flicker, random_walk=walk, quantisation=quantisation)


def _checked(rate: npt.ArrayLike, interval_s: float) -> Array:
    readings = np.asarray(rate, dtype=np.float64)
    if readings.ndim != 1:
        raise ValueError(f"readings of one channel are (n,), got {readings.shape}")
    if readings.size < MINIMUM_SAMPLES:
        raise ValueError(f"{readings.size} readings are too few to identify noise; give {MINIMUM_SAMPLES} or more")
    if not np.isfinite(interval_s) or interval_s <= 0.0:
        raise ValueError(f"sampling interval must be positive, got {interval_s} s")
    if not np.isfinite(np.sum(readings)):
        raise ValueError("readings hold NaN or infinity; cut them out first")
    return readings
