"""Fit of any set of columns together with the noise, from Gram matrices gathered once per bin of frequency.

With the noise diagonal in the cosine basis, all that a fit needs of a channel is, per bin, the inner products of its
columns and its residual. So a noise model can be changed, or a candidate tried, without touching the samples again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.protocols.native import DTHETA_LSB_RAD, DV_LSB_MPS
from inertial.documents import CHANNELS
from simulators.discrepancy.candidates import Hypothesis, Library, Slot
from simulators.discrepancy.whitening import Basis, NoiseFit, cosine_basis, fit_noise

Array = NDArray[np.float64]

_ROUNDS = 4  # of weights, amplitudes, weights … in a joint fit
_RIDGE = 1e-11


def bayes_factor(gain: float, count: int, places: float) -> float:
    """Return ln of the Bayes factor [nats] of ``count`` amplitudes that raise the log-likelihood by ``gain``.

    Empirical-Bayes g-prior, 2 ln BF = LR - k·(ln(LR/k) + 1), less ln of the number of places looked at.
    """
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


class Evidence:
    """All inner products of a library, with the noise that its models state."""

    def __init__(self, library: Library) -> None:
        self.library = library
        self.prior = dict(library.nuisance)
        self.base = len(library.columns)
        self.basis: dict[Slot, Basis] = {}
        self.stated: dict[Slot, Array | None] = {}
        self.floor: dict[Slot, Array] = {}
        self._local: dict[Slot, dict[int, int]] = {}
        self._gram: dict[Slot, Array] = {}
        self._with_residual: dict[Slot, Array] = {}
        self._residual2: dict[Slot, Array] = {}
        self._extra: dict[tuple[Slot, int, int], Array] = {}
        for slot in library.residual:
            self._gather(slot)

    @property
    def slots(self) -> list[Slot]:
        """Every scene and channel."""
        return list(self.basis)

    def _gather(self, slot: Slot) -> None:
        scene = self.library.scenes[slot[0]]
        residual = self.library.residual[slot]
        basis = cosine_basis(len(residual), scene.interval_s)
        self.basis[slot] = basis
        noise = getattr(scene.model.noise, CHANNELS[slot[1]])
        lsb = (DV_LSB_MPS if slot[1] < 3 else DTHETA_LSB_RAD) / math.sqrt(scene.group)
        declared = not scene.model.noise.free and any((noise.white, noise.flicker, noise.random_walk))
        self.floor[slot] = basis.stated(noise.__class__(), lsb)
        self.stated[slot] = basis.stated(noise, lsb) if declared else None
        ids = [i for i, column in enumerate(self.library.columns) if slot in column.parts]
        self._local[slot] = {i: place for place, i in enumerate(ids)}
        matrix = np.empty((len(residual), len(ids) + 1))
        for place, i in enumerate(ids):
            matrix[:, place] = self.library.columns[i].parts[slot]
        matrix[:, -1] = residual
        gram = np.empty((len(basis.counts), len(ids) + 1, len(ids) + 1))
        for b, (first, end) in enumerate(zip(basis.bounds[:-1], basis.bounds[1:], strict=True)):
            rows = matrix[first:end]
            gram[b] = rows.T @ rows
        self._gram[slot] = gram[:, :-1, :-1]
        self._with_residual[slot] = gram[:, :-1, -1]
        self._residual2[slot] = gram[:, -1, -1]

    def products(self, slot: Slot, ids: Sequence[int]) -> tuple[Array, Array]:
        """Return Gram (bins, k, k) and products with the residual (bins, k) of columns in one slot."""
        bins, count = len(self.basis[slot].counts), len(ids)
        local = self._local[slot]
        gram, with_residual = np.zeros((bins, count, count)), np.zeros((bins, count))
        known = [(place, local[i]) for place, i in enumerate(ids) if i in local]
        if known:
            places, where = np.array([p for p, _ in known]), np.array([w for _, w in known])
            gram[:, places[:, None], places] = self._gram[slot][:, where[:, None], where]
            with_residual[:, places] = self._with_residual[slot][:, where]
        for place, i in enumerate(ids):
            if i < self.base:
                continue
            with_residual[:, place] = self._product(slot, i, -1)
            for other, j in enumerate(ids):
                gram[:, place, other] = gram[:, other, place] = self._product(slot, i, j)
        return gram, with_residual

    def _product(self, slot: Slot, i: int, j: int) -> Array:
        """Return binned products of a late column with another, or with the residual (-1)."""
        key = (slot, max(i, j), min(i, j))
        if key not in self._extra:
            one = self.library.columns[i].parts.get(slot)
            two = self.library.residual[slot] if j < 0 else self.library.columns[j].parts.get(slot)
            bounds = self.basis[slot].bounds[:-1]
            self._extra[key] = (
                np.zeros(len(bounds)) if one is None or two is None else np.add.reduceat(one * two, bounds)
            )
        return self._extra[key]

    def touched(self, ids: Sequence[int]) -> set[Slot]:
        """Return the slots that columns act on."""
        return {slot for i in ids for slot in self.library.columns[i].parts}

    def fit(self, ids: Sequence[int], start: Fit | None = None, fixed: Sequence[int] = ()) -> Fit:
        """Fit columns and noise together.

        ``start`` gives the noise to begin with; slots that none of the columns new to it touches keep it.
        Columns in ``fixed`` have amplitude one.
        """
        free = tuple(i for i in dict.fromkeys((*self.prior, *ids)) if i not in fixed)
        everything = (*free, *fixed)
        changed = set(self.slots) if start is None else self.touched([i for i in everything if i not in start.ids])
        gone = [] if start is None else [i for i in start.ids if i not in everything]
        changed |= self.touched(gone)
        noise = {} if start is None else dict(start.noise)
        products = {slot: self.products(slot, everything) for slot in self.slots}
        for slot in self.slots:
            if slot not in noise:
                counts = self.basis[slot].counts
                noise[slot] = fit_noise(
                    self.basis[slot], self._residual2[slot], counts, self.stated[slot], self.floor[slot]
                )
        k, f = len(free), len(fixed)
        amplitude, covariance = np.zeros(k), np.zeros((k, k))
        rss: dict[Slot, Array] = {}
        for _ in range(_ROUNDS):
            matrix = np.diag([1.0 / self.prior[i] ** 2 if i in self.prior else 0.0 for i in free])
            right = np.zeros(k)
            for slot, (gram, with_residual) in products.items():
                weight = 1.0 / noise[slot].power
                whole = np.tensordot(weight, gram, 1)
                matrix += whole[:k, :k]
                right += weight @ with_residual[:, :k] - whole[:k, k:].sum(axis=1)
            scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
            unit = matrix / np.outer(scale, scale)
            unit[np.diag_indices(k)] += _RIDGE
            inverse = np.linalg.inv(unit) if k else unit
            covariance = inverse / np.outer(scale, scale)
            amplitude = covariance @ right
            full = np.concatenate([amplitude, np.ones(f)])
            for slot, (gram, with_residual) in products.items():
                left = self._residual2[slot] - 2.0 * with_residual @ full + np.einsum("bij,i,j->b", gram, full, full)
                rss[slot] = np.maximum(left, 1e-12 * self._residual2[slot])
                if slot in changed:
                    used = np.einsum("bij,ij->b", gram[:, :k, :k], covariance) / noise[slot].power
                    counts = self.basis[slot].counts
                    freedom = np.maximum(counts - used, 0.02 * counts)
                    noise[slot] = fit_noise(self.basis[slot], rss[slot], freedom, self.stated[slot], self.floor[slot])
        value = sum(self._value(slot, rss[slot], noise[slot]) for slot in self.slots)
        value -= 0.5 * sum((a / self.prior[i]) ** 2 for i, a in zip(free, amplitude, strict=True) if i in self.prior)
        return Fit(everything, np.concatenate([amplitude, np.ones(f)]), covariance, float(value), noise, rss)

    def _value(self, slot: Slot, rss: Array, noise: NoiseFit) -> float:
        penalty = noise.penalty
        return float(-0.5 * np.sum(self.basis[slot].counts * np.log(noise.power) + rss / noise.power)) - penalty

    def scan(self, hypotheses: Sequence[Hypothesis], current: Fit, noise: dict[Slot, NoiseFit]) -> Array:
        """Return by how much each hypothesis raises the log-likelihood [nats] at a given noise."""
        active = list(current.ids)
        k = len(active)
        matrix = np.diag([1.0 / self.prior[i] ** 2 if i in self.prior else 0.0 for i in active])
        right = np.zeros(k)
        weighted: dict[Slot, tuple[Array, Array, NDArray[np.int64]]] = {}
        for slot in self.slots:
            weight = 1.0 / noise[slot].power
            gram, with_residual = self.products(slot, active)
            matrix += np.tensordot(weight, gram, 1)
            right += weight @ with_residual
            known = np.array([self._local[slot].get(i, -1) for i in active], dtype=np.int64)
            weighted[slot] = np.tensordot(weight, self._gram[slot], 1), weight @ self._with_residual[slot], known
        scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        unit = matrix / np.outer(scale, scale)
        unit[np.diag_indices(k)] += _RIDGE
        inverse = np.linalg.inv(unit) / np.outer(scale, scale) if k else unit
        amplitude = inverse @ right
        gains = np.zeros(len(hypotheses))
        for place, hypothesis in enumerate(hypotheses):
            if any(i in active for i in hypothesis.columns):
                continue
            own, score, cross = self._of_hypothesis(hypothesis, active, noise, weighted)
            left = score - cross @ amplitude
            inside = own - cross @ inverse @ cross.T
            if hypothesis.unit_amplitude:
                gains[place] = float(np.sum(left) - 0.5 * np.sum(inside))
                continue
            size = np.sqrt(np.maximum(np.diag(own), 1e-300))
            unit = inside / np.outer(size, size)
            values, vectors = np.linalg.eigh(unit)
            seen = values > 1e-7
            along = (vectors.T @ (left / size))[seen]
            gains[place] = 0.5 * float(np.sum(along**2 / values[seen]))
        return gains

    def _of_hypothesis(
        self,
        hypothesis: Hypothesis,
        active: Sequence[int],
        noise: dict[Slot, NoiseFit],
        weighted: dict[Slot, tuple[Array, Array, NDArray[np.int64]]],
    ) -> tuple[Array, Array, Array]:
        ids = hypothesis.columns
        own, score, cross = np.zeros((len(ids), len(ids))), np.zeros(len(ids)), np.zeros((len(ids), len(active)))
        late = any(i >= self.base for i in ids)
        for slot in self.touched(ids):
            if late:
                gram, with_residual = self.products(slot, [*ids, *active])
                weight = 1.0 / noise[slot].power
                whole = np.tensordot(weight, gram, 1)
                own += whole[: len(ids), : len(ids)]
                cross += whole[: len(ids), len(ids) :]
                score += (weight @ with_residual)[: len(ids)]
                continue
            gram, with_residual, known = weighted[slot]
            local = [self._local[slot].get(i, -1) for i in ids]
            there = [p for p, w in enumerate(local) if w >= 0]
            where = np.array([local[p] for p in there])
            own[np.ix_(there, there)] += gram[np.ix_(where, where)]
            score[there] += with_residual[where]
            inside = np.flatnonzero(known >= 0)
            cross[np.ix_(there, inside)] += gram[np.ix_(where, known[inside])]
            for column in np.flatnonzero(known < 0):
                if active[column] >= self.base:
                    for p in there:
                        cross[p, column] += float(
                            (1.0 / noise[slot].power) @ self._product(slot, active[column], ids[p])
                        )
        return own, score, cross
