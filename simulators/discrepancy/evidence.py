"""Fit of any set of columns together with the noise, from Gram matrices gathered once per bin of frequency.

With the noise diagonal in the cosine basis, all that a fit needs of a channel is, per bin, the inner products of its
columns and its residual. So a noise model can be changed, or a candidate tried, without touching the samples again.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from inertial.documents import CHANNELS, ChannelNoise
from inertial.rounding import error_covariance, error_spectrum, power_scatter
from simulators.discrepancy.atoms import Steps
from simulators.discrepancy.candidates import GYROS, Column, Kind, Library, Slot
from simulators.discrepancy.compare import Scene
from simulators.discrepancy.filled_noise import Filling, filled_white
from simulators.discrepancy.inner_products import InnerProducts, Products
from simulators.discrepancy.repair import Gaps
from simulators.discrepancy.resolution import last_place
from simulators.discrepancy.sway_ends import turned_ends
from simulators.discrepancy.sway_time import felt_sway
from simulators.discrepancy.whitening import FREE_SHARE, STATED, SWAY, WIDE, Basis, NoiseFit, cosine_basis, fit_noise

Array = NDArray[np.float64]
T = TypeVar("T")

_ROUNDS = 4  # of weights, amplitudes, weights … in a joint fit
RIDGE = 1e-14
"""On the diagonal of normal equations of columns of length one."""
_SETTLED = 1e-6  # share of itself by which noise may change from round to round and is found
_MOVED = 8.0  # χ² in a slot by which its noise is to be fitted anew
_RESPREAD = 0.01  # of its power in any bin by which stated noise must change to be other
_OF_LATE = 4  # fits
_KEPT = (0.3, 0.1, 0.03)  # times as well as it need be that a schedule may be kept
_FELT = 0.1  # σ of the data that an uncertainty of the reference must amount to
_ABOUT = 1.3  # times a correlation time, that it may be off
_FEWEST = 2  # gyros of which nothing else explains the noise, for a mount to sway beyond doubt
_MOMENTS = 128  # at which the motion is looked at
_FAST = 0.25  # of all frequencies, above which what is not noise has little power
_NOTHING = 1e-3  # σ of one channel's noise below which what there is of it is not there


def bayes_factor(gain: float, count: int, places: float) -> float:
    """Return ln of the Bayes factor [nats] of ``count`` amplitudes that raise the log-likelihood by ``gain``.

    Empirical-Bayes g-prior, 2 ln BF = LR - k·(ln(LR/k) + 1), less ln of the number of places looked at. What has no
    amplitude to be found has the likelihood ratio itself.
    """
    if count == 0:
        return gain - math.log(places)
    ratio = 2.0 * gain / count
    if ratio <= 1.0:
        return -math.log(places)
    return gain - 0.5 * count * (math.log(ratio) + 1.0) - math.log(places)


@dataclass(frozen=True)
class Fit:
    """Joint fit of active columns and noise: amplitudes, their covariance, log-likelihood [nats], noise by slot."""

    ids: tuple[int, ...]
    amplitude: Array
    covariance: Array
    value: float
    noise: dict[Slot, NoiseFit]
    rss: dict[Slot, Array]

    def with_parallel(self, old: int, new: int, ratio: float) -> Fit:
        """Return the same fit with a column ``new`` that is ``ratio`` times ``old`` in that one's place."""
        place = self.ids.index(old)
        amplitude, covariance = self.amplitude.copy(), self.covariance.copy()
        amplitude[place] /= ratio
        covariance[place] /= ratio
        covariance[:, place] /= ratio
        ids = (*self.ids[:place], new, *self.ids[place + 1 :])
        return replace(self, ids=ids, amplitude=amplitude, covariance=covariance)


class Evidence:
    """All inner products of a library, with the noise that its models state."""

    def __init__(self, library: Library) -> None:
        self.library = library
        library.closed = True
        self.base = len(library.columns)
        self.basis: dict[Slot, Basis] = {}
        self.stated: dict[Slot, Array | None] = {}
        self._about: dict[Slot, Array | None] = {}  # as stated, or in the size that a model is unsure of
        self.resolved: dict[Slot, Array] = {}
        """Power (bins,) below which nothing is told: what numbers are rounded by, and next to nothing of the noise."""
        self.floor: dict[Slot, Array] = {}
        self.eased: dict[Slot, float] = {}
        """Least share of the stated noise that the samples' weights may leave."""
        self.came: dict[Slot, Array] = {}
        """Share (bins,) of what was there to be seen that came: see :meth:`.repair.Gaps.seen`."""
        self.sways = True
        """Whether the mount may sway: see :meth:`stand`."""
        self.swaying: set[int] = set()
        """Recordings in which the mount sways beyond doubt, as two gyros or more feel it."""
        self._tilted: set[int] = set()  # recordings in which gyros said how the mount sways
        self._rounded: dict[Slot, tuple[ChannelNoise, Array]] = {}
        self._filling: dict[Slot, Filling] = {}
        self._scatter: dict[Slot, float] = {}
        self._done: deque[tuple[Fit, dict[tuple[str, Slot], object]]] = deque(maxlen=_OF_LATE)
        self.inner: dict[Slot, InnerProducts] = {}
        self._weighed: dict[Slot, tuple[Products, NoiseFit, Array, Array]] = {}
        for slot in library.residual:
            self._gather(slot)
        self.prior = self._felt()
        self._always = tuple(self.prior)
        self._own = [i for s in library.schedules.values() for late in (*s.starts, *s.ends) for i in late]
        self._own = [i for i in self._own if i in self.prior]
        self._timed = {i for h in library.hypotheses if h.kind is Kind.REFERENCE for i in h.columns}
        self._stacks: dict[Slot, tuple[tuple[int, ...], Array]] = {}
        self._steps: dict[Slot, Steps] = {}

    @property
    def slots(self) -> list[Slot]:
        """Every scene and channel."""
        return list(self.basis)

    def power(self, slot: Slot) -> Array:
        """Return the noise power (bins,) that the model states, or the rounding of the frame where it states none."""
        stated = self.stated[slot]
        return self.floor[slot] if stated is None else stated

    def steps(self, slot: Slot) -> Steps:
        """Return all steps that a slot's channel could have made."""
        if slot not in self._steps:
            self._steps[slot] = Steps(self.basis[slot], self.library.spread[slot])
        return self._steps[slot]

    def quiet(self, slot: Slot, rss: Array, above: float = 0.0) -> NoiseFit:
        """Return the noise in which nothing slow is random: as stated, in the model's proportions, or white alone.

        Rounding may go with each. Their sizes are those ``above`` a share of all frequencies.
        """
        basis, stated = self.basis[slot], self.stated[slot]
        fitted = fit_noise(basis, rss, basis.counts, None, self.floor[slot], slow=False, above=above)
        if stated is not None and np.median(fitted.power / stated) < 1.5:
            fitted = replace(fitted, power=stated)
        return fitted

    def scatter(self, slot: Slot) -> float:
        """Return by how much the power of rounding errors scatters more between records than Gaussian noise's would.

        1 where rounding is lost in the noise. Found by rounding the stated noise on the mean motion.
        """
        if slot not in self._scatter:
            scene, basis = self.library.scenes[slot[0]], self.basis[slot]
            noise = getattr(scene.model.noise, CHANNELS[slot[1]])
            rounded = basis.frequency_hz > scene.freely_rounded_hz(slot[1])
            self._scatter[slot] = 1.0
            if rounded.any():
                per_step = basis.interval_s / noise.quantisation
                sigma = noise.white / math.sqrt(basis.interval_s) * per_step
                scatter = power_scatter(scene.motion(slot[1]) * per_step, sigma, basis.bounds)
                weight = basis.counts * rounded
                self._scatter[slot] = max(1.0, float(weight @ scatter / weight.sum()))
        return self._scatter[slot]

    def restate(self, rss: Mapping[Slot, Array]) -> bool:
        """Take the stated noise to be spread as what is left says, which it cannot say while structure is in it.

        Return whether that changed it, so that fits made before are to be made again, noise and all.
        """
        changed = False
        for slot, (noise, stated) in self._rounded.items():
            before, after = self.power(slot), self.basis[slot].likeliest(stated, noise, rss[slot])
            changed |= bool(np.max(np.abs(after / before - 1.0)) > _RESPREAD)
            self.stated[slot] = after
        return changed

    def stand(self, fit: Fit) -> bool:
        """Take the mount to stand still where fewer than two channels sway, in whichever recording.

        And where gyros say how it sways, accelerometers to be tilted at no other correlation time: what is slower there
        is their own. Return whether that changed anything, so that fits made before are to be made again.
        """
        swaying = {channel for (_, channel), noise in fit.noise.items() if noise.level in (SWAY, WIDE)}
        before, self.sways = self.sways, len(swaying) > 1
        tilted = [self._tilt(scene, fit) for scene in {scene for scene, _ in self.slots} - self._tilted]
        return self.sways != before or any(tilted)

    def _tilt(self, scene: int, fit: Fit) -> bool:
        """Let a recording's mount sway as its gyros tell, if they tell it.

        Its accelerometers are tilted at that correlation time; what gyros feel of its angle at the record's ends is in
        the fit.
        """
        gyros = [slot for slot in self.slots if slot[0] == scene and slot[1] in GYROS]
        felt = felt_sway([(self.basis[g], fit.rss[g], self.power(g)) for g in gyros])
        if felt is None:
            return False
        self._tilted.add(scene)
        at_s = felt.correlation_s
        for slot in self.slots:
            if slot[0] == scene and slot not in gyros:
                self.basis[slot] = self.basis[slot].tilted_at([at_s / _ABOUT, at_s * _ABOUT])
        angles = [angle for g, angle in zip(gyros, felt.angle_rad, strict=True) if fit.noise[g].level == SWAY]
        if len(angles) >= _FEWEST:
            self.swaying.add(scene)
            self._feel_ends(gyros, at_s, math.sqrt(float(np.mean(np.square(angles)))))
        return True

    def _feel_ends(self, gyros: Sequence[Slot], correlation_s: float, angle_rad: float) -> None:
        """Let a recording's gyros feel where a mount that sways was at both ends, by the σ of its angle."""
        turns = [turn for _, turn in self.library.scenes[gyros[0][0]].turns()]
        for slot, ends in zip(gyros, turned_ends(turns, correlation_s), strict=True):
            self.basis[slot] = self.basis[slot].with_ends(float(ends))
            self.library.sway(slot, correlation_s)
            self.inner[slot] = InnerProducts(self.library, slot, self.basis[slot].bounds)
            self.prior |= dict.fromkeys(self.library.ends[slot], angle_rad)
        self._always = tuple(self.prior)
        self._stacks.clear()

    def is_told(self, slot: Slot, fit: Fit) -> bool:
        """Whether a slot's noise is as stated, or a sway beyond doubt; any other takes in what is no noise."""
        level = fit.noise[slot].level
        return level == STATED or (level == SWAY and slot[0] in self.swaying)

    def read_with(self, slot: Slot, noise: ChannelNoise) -> Array:
        """Return the power (bins,) of noise of any size, with its rounding as it jolts that, and with filled gaps."""
        scene, basis = self.library.scenes[slot[0]], self.basis[slot]
        moved = scene.motion(slot[1])
        power = basis.stated(noise, last_place(slot[1]) / math.sqrt(scene.group), moved)
        if slot in self._filling and noise.quantisation:
            power = power + _torn(scene, self._filling[slot], noise, moved, basis)
        return np.asarray(power)

    def jolted(self, slot: Slot, more: float) -> Array | None:
        """Return the stated power (bins,) with so much more white noise [y/√Hz]; none where rounding is lost in it."""
        if slot not in self._rounded:
            return None
        noise, _ = self._rounded[slot]
        return self.read_with(slot, noise.model_copy(update={"white": math.hypot(noise.white, more)}))

    def once(self, fit: Fit, what: tuple[str, Slot], work: Callable[[], T]) -> T:
        """Return what some work on a slot's part of a fit comes to, done once for the fits asked for of late."""
        done = next((known for of, known in self._done if of is fit), None)
        if done is None:
            done = {}
            self._done.append((fit, done))
        if what not in done:
            done[what] = work()
        return cast("T", done[what])

    def _gather(self, slot: Slot) -> None:
        scene = self.library.scenes[slot[0]]
        residual = self.library.residual[slot]
        basis = cosine_basis(len(residual), scene.interval_s, tilted=slot[1] < 3)
        gaps = Gaps.of(scene.data.missing[:, slot[1]])
        each_sample = basis.frequency_hz * scene.seen.interval_s
        if gaps.missing.size:
            self._filling[slot] = Filling.of(gaps, each_sample)
        basis, self.came[slot] = basis.with_gaps(filled_white(gaps, each_sample)), gaps.seen(each_sample)
        self.basis[slot] = basis
        self.eased[slot] = float(np.mean(gaps.came) * np.mean(self.library.spread[slot] ** -2.0))
        noise = getattr(scene.model.noise, CHANNELS[slot[1]])
        lsb = last_place(slot[1]) / math.sqrt(scene.group)
        says = any((noise.white, noise.flicker, noise.random_walk))
        declared = says and not scene.model.noise.free
        slow = noise.model_copy(update={"white": 0.0, "quantisation": 0.0})
        at_least = (FREE_SHARE**2 if scene.model.noise.free else 1.0) * basis.stated(slow, 0.0)
        about = self.read_with(slot, noise) if says else None
        self.resolved[slot] = basis.stated(noise.__class__(), lsb) + (0.0 if about is None else _NOTHING**2 * about)
        self.floor[slot] = self.resolved[slot] + at_least
        stated = about if declared else None
        if math.isfinite(scene.freely_rounded_hz(slot[1])):
            basis = basis.rounded(noise, scene.motion(slot[1]))
            if stated is not None:
                self._rounded[slot] = noise, stated
                stated = basis.likeliest(stated, noise, np.add.reduceat(residual**2, basis.bounds[:-1]))
        self.stated[slot] = stated
        self._about[slot] = about if stated is None else stated
        if says and not declared:
            shape = basis.stated(noise.model_copy(update={"quantisation": 0.0}), 0.0)
            basis = replace(basis, shape=shape, least_slow=at_least)
        self.basis[slot] = basis
        self.inner[slot] = InnerProducts(self.library, slot, basis.bounds)

    def _felt(self) -> dict[int, float]:
        """Return the uncertainties of the reference that are more than a tenth of σ of these data all together.

        Where one is next to nothing in a slot it is taken out of it.
        """
        known = {slot: self._least_power(slot) for slot in self.slots}
        felt = {}
        for i, sigma in self.library.nuisance:
            parts = self.library.columns[i].parts
            power = {s: sigma**2 * float(np.sum(self._squares(s, p) / known[s])) for s, p in parts.items()}
            if sum(power.values()) > _FELT**2:
                felt[i] = sigma
                self.library.columns[i] = Column({s: p for s, p in parts.items() if power[s] > _NOTHING**2})
        return felt

    def _least_power(self, slot: Slot) -> Array:
        """Return the power (bins,) of noise in which nothing is slow, or that stated, if only about, where it is less.

        As large as what is fast: what is slow, and may be far larger, is no noise before anything was fitted. Nor is
        what is fast where turns begin and end at other times than is said.
        """
        about, power = self._about[slot], self.quiet(slot, self.inner[slot].residual2, _FAST).power
        return power if about is None else np.minimum(power, about)

    def _squares(self, slot: Slot, part: Array) -> Array:
        """Return the sums of squares (bins,) of coefficients (n,)."""
        return np.asarray(np.add.reduceat(part**2, self.basis[slot].bounds[:-1]))

    def normal(self, ids: Sequence[int], power: Mapping[Slot, Array]) -> tuple[Array, Array]:
        """Return the normal equations of columns, less their priors: matrix (k, k) and right side (k,)."""
        matrix, right = np.zeros((len(ids), len(ids))), np.zeros(len(ids))
        for slot in self.slots:
            products = self.inner[slot].of(ids)
            gram, with_residual = products.weighted(self.came[slot] / power[slot])
            matrix[np.ix_(products.where, products.where)] += gram
            right[products.where] += with_residual
        return matrix, right

    def stack(self, slot: Slot) -> tuple[tuple[int, ...], Array]:
        """Return which of the columns always in the fit touch a slot, and their coefficients (n, k), side by side."""
        if slot not in self._stacks:
            ids = tuple(i for i in self._always if slot in self.library.columns[i].parts)
            parts = [self.library.columns[i].parts[slot] for i in ids]
            self._stacks[slot] = ids, np.column_stack(parts) if parts else np.zeros((self.basis[slot].n, 0))
        return self._stacks[slot]

    def information(self, power: Mapping[Slot, Array]) -> Array:
        """Return the Fisher information (k, k) of the library's first columns beyond what is always in the fit."""
        whole = np.zeros((self.base, self.base))
        for slot in self.slots:
            ids = np.array(list(self.inner[slot].place), dtype=np.int64)
            whole[np.ix_(ids, ids)] += self.inner[slot].weighted(self.came[slot] / power[slot])[0]
        always = list(self._always)
        if not always:
            return whole
        known = whole[np.ix_(always, always)] + np.diag([1.0 / self.prior[i] ** 2 for i in always])
        across = whole[:, always]
        return np.asarray(whole - across @ np.linalg.solve(known, across.T))

    def touched(self, ids: Sequence[int]) -> set[Slot]:
        """Return the slots that columns act on."""
        return {slot for i in ids for slot in self.library.columns[i].parts}

    def channels(self, ids: Sequence[int]) -> set[int]:
        """Return the channels that columns act on, in whichever recording."""
        return {channel for _, channel in self.touched(ids)}

    def fit(self, ids: Sequence[int], start: Fit | None = None, fixed: Sequence[int] = ()) -> Fit:
        """Fit columns and noise together.

        ``start`` gives the noise to begin with; slots that none of the columns new to it touches keep it, unless what
        the reference is unsure of is found to be other there.
        Columns in ``fixed`` have amplitude one.
        """
        free = tuple(i for i in dict.fromkeys((*self.prior, *ids)) if i not in fixed)
        everything = (*free, *fixed)
        changed = set(self.slots) if start is None else self.touched([i for i in everything if i not in start.ids])
        gone = [] if start is None else [i for i in start.ids if i not in everything]
        changed |= self.touched(gone)
        noise = {} if start is None else dict(start.noise)
        products = {slot: self.inner[slot].of(everything) for slot in self.slots}
        for slot in self.slots:
            if slot not in noise:
                counts = self.basis[slot].counts
                noise[slot] = fit_noise(
                    *(self.basis[slot], self.inner[slot].residual2, counts, self.stated[slot], self.floor[slot]),
                    eased=self.eased[slot],
                    sways=self.sways,
                )
        fit = self._joint(free, fixed, noise, products, changed)
        if start is not None:
            moved = {slot for slot in self.slots if slot not in changed and _moved(start, fit, slot)}
            if moved:
                fit = self._joint(free, fixed, fit.noise, products, changed | moved)
        return fit

    def _joint(
        self,
        free: tuple[int, ...],
        fixed: Sequence[int],
        noise: dict[Slot, NoiseFit],
        products: dict[Slot, Products],
        changed: set[Slot],
    ) -> Fit:
        """Fit amplitudes and, of the slots changed, noise, in turns."""
        k, f, noise = len(free), len(fixed), dict(noise)
        amplitude, covariance = np.zeros(k), np.zeros((k, k))
        rss: dict[Slot, Array] = {}
        kept = [slot for slot in self.slots if slot not in changed]
        moving = [slot for slot in self.slots if slot in changed]
        steady, steady_right = np.zeros((k + f, k + f)), np.zeros(k + f)
        for place, i in enumerate(free):
            steady[place, place] = 1.0 / self.prior[i] ** 2 if i in self.prior else 0.0
        for slot in kept:
            self._weigh(slot, products[slot], noise[slot], steady, steady_right)
        for _ in range(_ROUNDS):
            whole, right = steady.copy(), steady_right.copy()
            for slot in moving:
                self._weigh(slot, products[slot], noise[slot], whole, right)
            matrix, right = whole[:k, :k], right[:k] - whole[:k, k:].sum(axis=1)
            scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
            unit = matrix / np.outer(scale, scale)
            unit[np.diag_indices(k)] += RIDGE
            inverse = np.linalg.inv(unit) if k else unit
            covariance = inverse / np.outer(scale, scale)
            amplitude = np.linalg.solve(unit, right / scale) / scale
            full = np.concatenate([amplitude, np.ones(f)])
            before = {slot: noise[slot].power for slot in moving}
            for slot in moving:
                rss[slot] = self._rss(slot, products[slot], full)
                used = _known(products[slot], covariance) / noise[slot].power
                counts = self.basis[slot].counts
                freedom = np.maximum(counts - used, 0.02 * counts)
                noise[slot] = fit_noise(
                    *(self.basis[slot], rss[slot], freedom, self.stated[slot], self.floor[slot]),
                    eased=self.eased[slot],
                    sways=self.sways,
                )
            if all(np.max(np.abs(noise[slot].power / before[slot] - 1.0)) < _SETTLED for slot in moving):
                break
        for slot in kept:
            rss[slot] = self._rss(slot, products[slot], full)
        value = sum(self._value(slot, rss[slot], noise[slot]) for slot in self.slots)
        value -= 0.5 * sum((a / self.prior[i]) ** 2 for i, a in zip(free, amplitude, strict=True) if i in self.prior)
        value += self._kept_well(free, amplitude, covariance)
        return Fit((*free, *fixed), full, covariance, float(value), noise, rss)

    def _kept_well(self, free: tuple[int, ...], amplitude: Array, covariance: Array) -> float:
        """Return by how much likelier [nats] all is if the schedule was kept as well as it seems to have been.

        Then a delay, or a clock that runs wrong, is not what every turn happened to be late by. None where errors of
        timing are taken to be of any size.
        """
        if not self._own or not self._timed.isdisjoint(free):
            return 0.0
        return max(0.0, *self.if_kept(free, amplitude, covariance, _KEPT))

    def if_kept(
        self, free: tuple[int, ...], amplitude: Array, covariance: Array, shares: Sequence[float]
    ) -> list[float]:
        """Return by how much likelier [nats] all is if starts and ends of turns err by such shares of their prior σ.

        Ratios of marginal likelihoods, of amplitudes (k,) and their covariance (k, k) with the prior as it is: another
        prior changes a normal posterior in closed form, the noise as found.
        """
        where = [free.index(i) for i in self._own]
        sigma = np.array([self.prior[i] for i in self._own])
        spread, axes = np.linalg.eigh(covariance[np.ix_(where, where)] / np.outer(sigma, sigma))
        known = 1.0 / np.clip(spread, 1e-12, 1.0)  # of each combination, prior and data together
        along = known * (axes.T @ (amplitude[where] / sigma))
        found = []
        for share in shares:
            now = known - 1.0 + share**-2.0
            change = along**2 / now - along**2 / known - np.log(now / known)
            found.append(0.5 * float(np.sum(change)) - len(where) * math.log(share))
        return found

    def _weigh(self, slot: Slot, products: Products, noise: NoiseFit, matrix: Array, right: Array) -> None:
        """Add one slot's products to the normal equations, weighted by its noise."""
        known = self._weighed.get(slot)
        if known is None or known[0].gram is not products.gram or known[1] is not noise:
            known = products, noise, *products.weighted(self.came[slot] / noise.power)
            self._weighed[slot] = known
        matrix[np.ix_(products.where, products.where)] += known[2]
        right[products.where] += known[3]

    def _rss(self, slot: Slot, products: Products, amplitude: Array) -> Array:
        inner, size = self.inner[slot], amplitude[products.where]
        left = inner.residual2 - 2.0 * products.with_residual @ size + products.within(np.outer(size, size))
        return np.asarray(np.maximum(left, 1e-12 * inner.residual2))

    def noise_value(self, slot: Slot, noise: NoiseFit, left: Array) -> float:
        """Return the log-likelihood [nats] of coefficients (n,) left in a slot, less the penalty of its noise."""
        return self._value(slot, self._squares(slot, left), noise)

    def slot_value(self, slot: Slot, fit: Fit) -> float:
        """Return the log-likelihood [nats] of one slot, less the penalty of its noise."""
        return self._value(slot, fit.rss[slot], fit.noise[slot])

    def _value(self, slot: Slot, rss: Array, noise: NoiseFit) -> float:
        each = self.basis[slot].counts * np.log(noise.power) + rss / noise.power
        return float(-0.5 * self.came[slot] @ each) - noise.penalty


def _moved(start: Fit, fit: Fit, slot: Slot) -> bool:
    """Whether what is left in a slot whose noise was kept is no longer what that noise was fitted to."""
    return bool(np.sum(np.abs(fit.rss[slot] - start.rss[slot]) / fit.noise[slot].power) > _MOVED)


def _torn(scene: Scene, filling: Filling, noise: ChannelNoise, moved: Array, basis: Basis) -> Array:
    """Return the power (bins,) that filled gaps add to the rounding errors of a readout, or take from it, below zero.

    ``moved``: the mean motion (n,) [y], by which errors before and behind a gap are alike or opposite.
    """
    step, interval_s = noise.quantisation, scene.seen.interval_s
    advance = moved[:: max(1, moved.size // _MOMENTS)] * interval_s / step
    variance = noise.white**2 * interval_s / step**2

    def errors(apart: Array) -> Array:
        return error_covariance(np.abs(apart), advance, variance)

    def covariance(apart: Array) -> Array:
        return 2.0 * errors(apart) - errors(apart - 1.0) - errors(apart + 1.0)

    omega = 2.0 * np.pi * basis.frequency_hz * interval_s
    power = 4.0 * np.sin(0.5 * omega) ** 2 * error_spectrum(omega, advance, variance)
    return filling.beyond(power, covariance) * (step / interval_s) ** 2 / scene.group


def _known(products: Products, covariance: Array) -> Array:
    """Return how much of each bin (bins,) the columns whose amplitudes are found (k of them, the first) take up."""
    where = products.where[: np.searchsorted(products.where, len(covariance))]
    return products.within(covariance[np.ix_(where, where)])
