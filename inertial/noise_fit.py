"""One channel's noise terms: the most likely, their intervals, and which of them the record shows.

Variances are never negative. Each parameter's interval comes from its profile likelihood with all others free, and it
is *seen* when the record refuses its absence by more than :data:`SEEN_SIGMA`. The interval of a seen parameter allows
for its having been looked at only because it was seen.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy.optimize
import scipy.special

from inertial.noise_likelihood import evaluate, maximise
from inertial.noise_spectrum import FLICKER, QUANTISATION, SINGLE, WALK, WHITE, Rounding, Spectrum, rounded_basis

Array = npt.NDArray[np.float64]

SEEN_SIGMA = 3.0
"""Likelihood ratio (as a normal deviate) from which a parameter counts as seen."""
NORMAL_975 = 1.959963984540054
_MISFIT_SIGMA = 6.0  # misfit beyond what chance gives, from which the spectrum is not a sum of the terms
_DROPPED = 3.0  # a cell this many times above what would be clipped says nothing about the terms
_MODEL_TRUST = 0.3  # relative 1σ of the terms' sum as a model of such a spectrum
_COARSE = 0.7  # random motion a sample [steps] below which rounding errors are related from sample to sample


@dataclass(frozen=True)
class NoiseTerm:
    """One parameter: best value, 1σ, 95 % interval, and whether the record shows it at all."""

    value: float
    sigma: float
    interval95: tuple[float, float]
    seen: bool


class ChannelFit:
    """The maximum of the likelihood and its profiles."""

    def __init__(self, spectrum: Spectrum) -> None:
        self._known = np.full(4, np.nan)
        self._use(spectrum)
        self.best, self.value = self._global()
        self.rounded = self._rounded()
        self.misfit = self._misfit()
        self.excess = np.zeros_like(spectrum.power)
        if self.misfit > 1.0 + _MISFIT_SIGMA * np.sqrt(2.0 / spectrum.power.size):
            self._set_excess_aside(self._spectrum)
            rounding = spectrum.rounding
            if rounding is not None and self.best[WHITE] * spectrum.interval_s < (_COARSE * rounding.step) ** 2:
                self.rounded = _step_of(
                    rounding
                )  # few, or hardly any, turns of the readout: lines, but its step is plain

    def _use(self, spectrum: Spectrum) -> None:
        self._spectrum = spectrum
        self._cells = (spectrum.power, spectrum.single, spectrum.freedom, spectrum.basis, spectrum.ramp)

    def _rounded(self) -> NoiseTerm | None:
        """Take coarse rounding for what it is, where the increments lie on a lattice and the spectrum agrees.

        Its error is then no white angle noise, and its step is known from the lattice. It is not Gaussian either, so
        cells count by how much of them is other noise; the intervals, which know no better, are then a little wide.
        """
        plain, best, value = self._spectrum, self.best, self.value
        rounding = plain.rounding
        if rounding is None:
            return None
        self._known[QUANTISATION] = rounding.step**2
        if self._settle_on_rounding(plain, rounding):
            whole = (plain.power, plain.single, plain.freedom, self._spectrum.basis, plain.ramp)
            if evaluate(self.best, *whole)[0] > value - 0.5 * SEEN_SIGMA**2:
                return _step_of(rounding)
        self._known[QUANTISATION] = np.nan
        self._use(plain)
        self.best, self.value = best, value
        return None

    def _settle_on_rounding(self, plain: Spectrum, rounding: Rounding) -> bool:
        """Fit the other terms, the rounding error's spectrum following the white noise; False if it is not coarse."""
        coarse = _COARSE * rounding.step / np.sqrt(plain.interval_s)
        for _ in range(12):
            white = float(np.sqrt(self.best[WHITE]))
            if white > coarse:
                return False
            basis = rounded_basis(plain, max(white, 0.03 * coarse))
            error = basis[:, QUANTISATION] * rounding.step**2
            others = np.maximum(basis[:, WHITE:] @ self.best[WHITE:], 1e-6 * error)
            trust = (others / (others + error)) ** 2
            self._use(replace(plain, basis=basis, freedom=plain.freedom * trust))
            self.best, self.value = self._global()
            if abs(np.sqrt(self.best[WHITE]) - white) < 1e-3 * white:
                break
        return True

    def _misfit(self) -> float:
        """Return the mean deviance of a cell: 1 (1.27 for cells of one coefficient) when the model holds."""
        ratio = self._spectrum.power / (self._spectrum.basis @ self.best)
        return float(np.mean(self._spectrum.freedom * (ratio - 1.0 - np.log(np.maximum(ratio, 1e-300)))))

    def _set_excess_aside(self, spectrum: Spectrum) -> None:
        """Fit the floor under resonances and lines (a vehicle's sway, a dither) that the five terms cannot make.

        Such a spectrum is no sum of power laws, and counting every coefficient as an independent witness would let a
        resonance with many of them decide what the noise is at frequencies where it has none. Each cell is trusted
        to :data:`_MODEL_TRUST`, and what stands out above the fit by more than 2.5 σ of that is set aside (Huber).
        """
        freedom = np.minimum(spectrum.freedom, 2.0 / _MODEL_TRUST**2)
        pooled = spectrum.freedom > 3.0
        if not pooled.any():
            return
        floors = np.quantile(spectrum.power[pooled, None] / spectrum.basis[pooled], (0.05, 0.2, 0.5), axis=0)
        tops = [self._clipped(replace(spectrum, freedom=freedom), start) for start in (self.best, *floors)]
        _, clipped, self.best, self.value = min(tops, key=lambda top: top[0])
        self._use(clipped)
        self.excess = np.maximum(spectrum.power - np.minimum(clipped.power, clipped.basis @ self.best), 0.0)
        self.excess[clipped.power == spectrum.power] = 0.0

    def _clipped(self, spectrum: Spectrum, start: Array) -> tuple[float, Spectrum, Array, float]:
        """Refit with what stands out clipped or dropped until that settles; mean absolute log residual, fit."""
        allowed = 1.0 + 2.5 * np.sqrt(2.0 / spectrum.freedom)
        clipped, best, value = spectrum, start, -np.inf
        for _ in range(60):
            level = spectrum.basis @ best
            ratio = np.maximum(spectrum.power, 1e-300) / level
            kept = np.minimum(1.0, allowed / ratio)
            dropped = ratio > _DROPPED * allowed
            clipped = replace(
                spectrum,
                power=spectrum.power * kept,
                single=spectrum.single * np.sqrt(kept),
                freedom=np.where(dropped, 1e-6, spectrum.freedom),
            )
            self._use(clipped)
            best, value = self._climb(best)
            if np.max(np.abs(np.log(spectrum.basis @ best / level))) < 1e-2:
                break
        ratio = np.maximum(spectrum.power, 1e-300) / (spectrum.basis @ best)
        return float(np.mean(np.minimum(np.abs(np.log(ratio)), np.log(_DROPPED)))), clipped, best, value

    def excess_step(self) -> float:
        """Return the step [y·s] of a quantisation whose angle noise equals that of the pooled cells' excess."""
        spectrum = self._spectrum
        share = spectrum.fraction * self.excess / spectrum.basis[:, QUANTISATION]
        return float(np.sqrt(np.sum(share[SINGLE:])))

    def _global(self) -> tuple[Array, float]:
        """Start from each term explaining all, and from all together: the likelihood can have more than one top."""
        spectrum = self._spectrum
        scaled = np.maximum(spectrum.power, 1e-12 * spectrum.power.max())[:, None] / spectrum.basis
        whole = spectrum.freedom @ scaled / spectrum.freedom.sum()
        starts = (whole, np.exp(np.mean(np.log(scaled), axis=0)), np.min(scaled, axis=0))
        return max((self._climb(start) for start in starts), key=lambda top: top[1])

    def _climb(self, start: Array, fixed: int = 0) -> tuple[Array, float]:
        """Return the top reached from ``start`` with the terms of the bit mask ``fixed`` held, and known ones."""
        begin = np.where(np.isnan(self._known), start, self._known)
        known = 1 << QUANTISATION if self._known[QUANTISATION] > 0.0 else 0
        v, value = maximise(begin, fixed | known, *self._cells)
        return np.asarray(v), float(value)

    def profile(self, term: int, variance: float) -> float:
        """Return the signed root of the likelihood ratio between the best fit and ``variance`` of one term."""
        start = np.maximum(self.best, 1e-6 * self._spread())
        start[term] = variance
        _, value = self._climb(start, 1 << term)
        root = np.sqrt(max(2.0 * (self.value - value), 0.0))
        return float(np.copysign(root, self.best[term] - variance))

    def _spread(self) -> Array:
        fisher = evaluate(self.best, *self._cells)[2]
        return np.asarray(1.0 / np.sqrt(np.diag(fisher)))

    def significance(self, term: int) -> float:
        """Return by how many σ the record refuses the absence of a term."""
        return self.profile(term, 0.0) if self.best[term] > 0.0 else 0.0

    def limit(self, term: int, root: float) -> float:
        """Return the parameter (not its square) where the profile's signed root is ``root``; 0 where it never is."""
        best = float(np.sqrt(self.best[term]))
        if root >= 0.0:
            if self.significance(term) <= root:
                return 0.0
            low, high = 0.0, best
        else:
            step = float(np.sqrt(self._spread()[term]))
            low, high = best, best + step
            while self.profile(term, high**2) > root:
                low, high = high, best + 2.0 * (high - best)
        return float(
            scipy.optimize.brentq(lambda p: self.profile(term, p**2) - root, low, high, xtol=1e-12 * high, rtol=1e-4)
        )

    def term(self, term: int, samples: int) -> NoiseTerm:
        """Return quantisation, white, flicker or random walk."""
        if term == QUANTISATION and self.rounded is not None:
            return self.rounded
        sharpness = self._sharpness(samples) if term == QUANTISATION else 1.0
        significance = self.significance(term) * sharpness
        seen = significance >= SEEN_SIGMA
        low = self.limit(term, _root_after_selection(significance) / sharpness) if seen else 0.0
        high = self.limit(term, -NORMAL_975 / sharpness)
        sigma = 0.5 * (self.limit(term, -1.0 / sharpness) - self.limit(term, 1.0 / sharpness))
        return NoiseTerm(float(np.sqrt(self.best[term])), sigma, (low, high), seen)

    def _sharpness(self, samples: int) -> float:
        """Return by how much quantisation is known better than Gaussian noise of its size would be.

        Rounding errors are uniform: their square scatters less (excess kurtosis −1.2), and the cumulant enters the
        estimate of their variance alone. How much of it is there is taken from the readings' own fourth cumulant.
        """
        spectrum, v = self._spectrum, self.best[QUANTISATION]
        free = self.best > 0.0
        if not free[QUANTISATION] or self.excess.any():
            return 1.0
        fisher = evaluate(self.best, *self._cells)[2][np.ix_(free, free)]
        relative = np.linalg.inv(fisher * np.outer(self.best[free], self.best[free]))[0, 0]
        kurtosis = spectrum.kurtosis / (v / 12.0) ** 2
        return float(np.sqrt(relative / (relative + np.clip(kurtosis, -1.2, 0.0) / samples)))

    def ramp(self) -> NoiseTerm:
        """Return the ramp, averaged over what flicker and random walk may be.

        A ramp shows in the same few lowest coefficients as they do; taking them at their most likely values, often 0,
        would promise too much. Each pair (B, K) of a grid gives a normal distribution of the ramp, weighted by its
        restricted likelihood under a flat prior: the interval then holds the ramp in 95 % of records that show a
        random walk about as large as the ramp, and in more where there is none, which no record can prove.
        """
        weight, centre, sigma = self._ramp_mixture()

        def tail(slope: float) -> float:
            return float(weight @ scipy.special.ndtr((slope - centre) / sigma))

        def quantile(deviate: float) -> float:
            ends = centre + deviate * sigma
            low, high = float(ends.min()), float(ends.max())
            probability = float(scipy.special.ndtr(deviate))
            if high - low <= 1e-9 * sigma.max():
                return low
            return float(scipy.optimize.brentq(lambda slope: tail(slope) - probability, low, high))

        negative = min(tail(0.0), 1.0 - tail(0.0))
        significance = -float(scipy.special.ndtri(max(negative, 1e-300)))
        value = quantile(0.0)
        sign = 1.0 if value > 0.0 else -1.0
        ends = (quantile(-sign * _root_after_selection(significance)), quantile(sign * NORMAL_975))
        spread = 0.5 * (quantile(1.0) - quantile(-1.0))
        return NoiseTerm(value, spread, (min(ends), max(ends)), significance >= SEEN_SIGMA)

    def _ramp_mixture(self) -> tuple[Array, Array, Array]:
        """Return weights, means and σ [y/s] of the ramp over a grid of flicker and random walk."""
        spectrum = self._spectrum
        rest = spectrum.basis[:, :FLICKER] @ self.best[:FLICKER]
        scale = np.sqrt(np.maximum(rest[0], 1e-3 * spectrum.power[:SINGLE].max()) / spectrum.basis[0, FLICKER:])
        grids = [self._amplitudes(term, float(scale[term - FLICKER])) for term in (FLICKER, WALK)]
        prior = np.outer(*(np.gradient(grid) for grid in grids)).ravel()
        log_likelihood, centre, information = np.empty((3, prior.size))
        v = self.best.copy()
        for index, (flicker, walk) in enumerate(itertools.product(*grids)):
            v[FLICKER], v[WALK] = flicker**2, walk**2
            log_likelihood[index], _, _, centre[index], information[index] = evaluate(v, *self._cells)
        weight = prior * np.exp(log_likelihood - log_likelihood.max())
        return weight / weight.sum(), spectrum.slope + centre, 1.0 / np.sqrt(information)

    def _amplitudes(self, term: int, unit: float) -> Array:
        """Return a grid of one parameter over all that its likelihood does not exclude by 6 σ."""
        low, top = self.limit(term, 6.0), 1.5 * self.limit(term, -6.0)
        if low > 0.0:
            return np.geomspace(low, top, 32)
        top = max(unit, top)
        return np.concatenate([[0.0], np.geomspace(1e-2 * min(unit, top), top, 31)])


def _step_of(rounding: Rounding) -> NoiseTerm:
    reach = NORMAL_975 * rounding.sigma
    return NoiseTerm(rounding.step, rounding.sigma, (rounding.step - reach, rounding.step + reach), True)


def _root_after_selection(significance: float) -> float:
    """Return the signed root at the lower end of the 95 % interval of a term that was looked at because seen.

    Given that the deviate exceeded the threshold, a root r has the upper tail Φ(−r)/Φ(excess − r), which is set to
    2.5 %. Far above the threshold that is 1.96; just above it the interval reaches to zero, as it must: terms too
    small to be seen are seen only when chance makes them look large.
    """
    excess = significance - SEEN_SIGMA
    if excess < 0.0:
        return NORMAL_975
    log_ndtr = scipy.special.log_ndtr

    def tail(root: float) -> float:
        return float(log_ndtr(-root) - log_ndtr(excess - root) - np.log(0.025))

    if tail(significance) > 0.0:
        return significance
    return float(scipy.optimize.brentq(tail, NORMAL_975 - 1e-9, significance))
