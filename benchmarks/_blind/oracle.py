"""How large an effect is, in σ: the square root of the likelihood ratio of somebody who knows it, true noise and all.

Beyond the nuisance parameters, whose priors are part of the covariance: d² = δᵀ(C + JPJᵀ)⁻¹δ.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace

import numpy as np
from scipy.fft import dct
from scipy.linalg import solve_triangular

from benchmarks._blind.motion import STANDARD_GRAVITY_MPS2, Setup, Shake
from benchmarks._blind.noise import Spectrum
from benchmarks._blind.world import World

TIMING_SIGMA_S = 1e-3
"""Schedule against block clock, and each edge of a turn, always: what such an error hides does not count."""
ONE_SIGMA = TIMING_SIGMA_S, 0.0
"""So late [s], and so much more a second."""
_BIN_S = 0.5


class Metric:
    """Whitens readings (n, 6) into one flat vector, and removes what nuisance parameters could explain."""

    def __init__(
        self, world: World, spectra: list[Spectrum], extra: Callable[[np.ndarray], np.ndarray] | None = None
    ) -> None:
        self.world, self.spectra = world, spectra
        self.per_bin = round(_BIN_S / world.dt) if world.setup.shakes else 1
        count = world.count // self.per_bin
        step = world.dt * self.per_bin
        frequency = np.arange(count) / (2 * count * step)
        frequency[0] = 0.276 / (count * step)  # where a random walk's density gives the variance of its mean
        self.density = np.array([s.density(frequency, world.dt if self.per_bin == 1 else step) for s in spectra])
        if extra is not None:
            self.density += extra(frequency)
        self.density = self.density / step
        self.factors = [self._factor(channel, count) for channel in range(6)] if self.per_bin > 1 else None
        self.nuisance = np.empty((0, 6 * count))

    def _factor(self, channel: int, count: int) -> np.ndarray:
        """Cholesky factor of one channel's covariance of bin means, vibration included."""
        basis = dct(np.eye(count), axis=0, norm="ortho")
        covariance = basis.T @ (self.density[channel][:, None] * basis)
        for shake in self.world.setup.shakes:
            share = abs(shake.axis[channel]) if channel < 3 else 0.0
            if share:
                covariance += share**2 * _shaken(shake, self.world, count, self.per_bin)
        return np.linalg.cholesky(covariance)

    def whiten(self, readings: np.ndarray) -> np.ndarray:
        """Flat vector (6m,), unit white when ``readings`` (n, 6) are noise."""
        count = self.density.shape[1]
        if self.factors is None:
            return (dct(readings, axis=0, norm="ortho").T / np.sqrt(self.density)).ravel()
        bins = readings[: count * self.per_bin].reshape(count, self.per_bin, 6).mean(axis=1)
        return np.concatenate([solve_triangular(f, bins[:, i], lower=True) for i, f in enumerate(self.factors)])

    def channel(self, flat: np.ndarray, channel: int) -> np.ndarray:
        """One channel's part of a flat vector."""
        return flat.reshape(6, -1)[channel]

    def beside(self, columns: list[np.ndarray]) -> Metric:
        """Return the metric beside nuisance parameters, of each the shift (n, 6) of one σ."""
        other = copy(self)
        other.nuisance = np.array([self.whiten(column) for column in columns])
        return other

    def project(self, flat: np.ndarray) -> np.ndarray:
        """What is left of a whitened vector (or rows of them) when the nuisance has taken its share."""
        return project(flat, self.nuisance)

    def size(self, shift: np.ndarray) -> float:
        """d of a shift of the readings (n, 6)."""
        return float(np.linalg.norm(self.project(self.whiten(shift))))

    def got(self, shift: np.ndarray, noise: np.ndarray, errors: np.ndarray) -> float:
        """d that a shift (n, 6) comes to beside the noise (n, 6) that there is: √ of twice ln of the likelihood ratio.

        ``errors`` (k,): of the nuisance parameters, in σ. 0 where the readings are likelier without.
        """
        effect, beside = self.project(self.whiten(shift)), self.project(self.whiten(noise) + errors @ self.nuisance)
        return float(np.sqrt(max(effect @ effect + 2.0 * (effect @ beside), 0.0)))

    def noise_got(self, channel: int, other: Spectrum, left: np.ndarray) -> float:
        """d of another noise on one channel, of which this (n,) is left."""
        count, dt = self.world.count, self.world.dt
        frequency = np.arange(1, count) / (2 * count * dt)
        usual = self.spectra[channel].density(frequency, dt)
        ratio = other.density(frequency, dt) / usual
        power = dct(left, norm="ortho")[1:] ** 2 / (usual / dt)
        return float(np.sqrt(max(np.sum(power * (1 - 1 / ratio) - np.log(ratio)), 0.0)))

    def noise_size(self, channel: int, other: Spectrum) -> float:
        """d of another noise on one channel: twice the Kullback-Leibler divergence of the two, by Whittle."""
        count, dt = self.world.count, self.world.dt
        frequency = np.arange(1, count) / (2 * count * dt)
        ratio = other.density(frequency, dt) / self.spectra[channel].density(frequency, dt)
        return float(np.sqrt(np.sum(ratio - 1 - np.log(ratio))))


def project(flat: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Return (I + JᵀJ)^(-1/2) applied to whitened rows: lengths after it are those of (C + JPJᵀ)⁻¹."""
    if not len(J):
        return flat
    values, vectors = np.linalg.eigh(J @ J.T)
    kept = values > 1e-12 * values.max()
    rows = (vectors[:, kept] / np.sqrt(values[kept])).T @ J
    shrink = 1 - 1 / np.sqrt(1 + values[kept])
    return flat - ((flat @ rows.T) * shrink) @ rows


def errors_of(
    true: Setup, stated: Setup, sigma: dict[str, float], rides: bool, priors: list[tuple[float, float]]
) -> np.ndarray:
    """Errors (k,) [σ] of the nuisance parameters as they are, in the order of :func:`nuisance`.

    They are known, and need no chords: what one adds that moves a turn's end into another sample is not in proportion.
    ``priors``: by how much each bias of the model is off, and its σ.
    """
    tilt = true.block_tilt if rides else true.room_tilt
    off = [(true.azimuth - stated.azimuth, sigma["azimuth"]), *((angle, sigma["level"]) for angle in tilt)]
    off += [(turn.angle_error_rad, turn.angle_sigma_rad) for turn in true.turns if turn.angle_sigma_rad]
    off += [(s, TIMING_SIGMA_S) for turn in true.turns for s in (turn.start_shift_s, turn.end_shift_s)]
    off += [(true.offset_s, TIMING_SIGMA_S)] if true.turns else []
    return np.array([error / one if one else 0.0 for error, one in [*off, *priors]])


def _shaken(shake: Shake, world: World, count: int, per_bin: int) -> np.ndarray:
    """Covariance of bin means under a vibration: differences of a stationary velocity, under its span."""
    edges = np.arange(count + 1) * world.dt * per_bin
    live = np.clip(np.minimum(edges - shake.start_s, shake.end_s - edges) / 0.1, 0, 1)
    lag = edges - edges[0]
    omega = 2 * np.pi * np.linspace(*shake.band_hz, 1000)
    power = (shake.grms * STANDARD_GRAVITY_MPS2) ** 2 / omega**2
    correlation = (np.cos(np.outer(lag, omega)) @ power) / len(omega)
    first = np.arange(count + 1)
    covariance = correlation[np.abs(first[:, None] - first)] * np.outer(live, live)
    return np.diff(np.diff(covariance, axis=0), axis=1) / (world.dt * per_bin) ** 2


def nuisance(
    world: World,
    sigma: dict[str, float],
    rides: bool,
    priors: list[tuple[int, float]],
    late: tuple[float, float] = ONE_SIGMA,
) -> list[np.ndarray]:
    """Shifts of one σ: azimuth, level, angle and timing of every turn, timing of all, biases of the model.

    Those of timing are chords to ``late`` (so much [s], and so much more a second): what is late by as much as an
    effect makes it is all that the effect is, whatever a sample's edge between makes of it.
    """
    setup = world.setup

    def late_s(time_s: float) -> float:
        return late[0] + late[1] * time_s

    others = [replace(setup, azimuth=setup.azimuth + sigma["azimuth"])]
    for axis in range(2):
        which = "block_tilt" if rides else "room_tilt"
        tilt = list(getattr(setup, which))
        tilt[axis] += sigma["level"]
        others.append(replace(setup, **{which: tuple(tilt)}))
    timed: list[tuple[float, Setup]] = []
    for number, turn in enumerate(setup.turns):
        if turn.angle_sigma_rad:
            others.append(setup.with_turn(number, angle_error_rad=turn.angle_error_rad + turn.angle_sigma_rad))
        start_s, end_s = late_s(turn.start_s), late_s(turn.end_s)
        timed.append((start_s, setup.with_turn(number, start_shift_s=turn.start_shift_s + start_s)))
        timed.append((end_s, setup.with_turn(number, end_shift_s=turn.end_shift_s + end_s)))
    still = world if not setup.shakes else replace(world, setup=replace(setup, shakes=()))
    base = still.inputs
    columns = [still.inputs_of(replace(other, shakes=())) - base for other in others]

    def late_by_one_sigma(shift_s: float, other: Setup) -> np.ndarray:
        return (still.inputs_of(replace(other, shakes=())) - base) * (TIMING_SIGMA_S / shift_s)

    edges = [late_by_one_sigma(*one) for one in timed]
    columns += edges
    if edges and late[1]:  # by the same chords, or it and they would not add up
        columns.append(np.sum(edges, axis=0))
    elif edges:
        columns.append(late_by_one_sigma(late[0], replace(setup, offset_s=setup.offset_s + late[0])))
    for channel, one in priors:
        column = np.zeros_like(base)
        column[:, channel] = one
        columns.append(column)
    return columns
