"""Prediction of data that a fit did not see: short blocks of the record, held out in turns.

For each quarter that is held out, amplitudes and noise are fitted on the other three together, and that noise whitens
what is held out, before and after. A name stays if what is held out is more probable with it, all that the other blocks
leave open taken into account; an amplitude of which they say nothing is nothing, give or take the effect's size. What
the reference was off by in a block held out (a turn that came late) no other block can tell: it is fitted there, within
its own σ, before and after alike. What is known of the reference is held out in its turn: blocks that an attitude
explains as well as an effect do not speak against the effect where the attitude would have to be far off its σ.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

from simulators.discrepancy.candidates import Slot
from simulators.discrepancy.evidence import Evidence, Fit
from simulators.discrepancy.whitening import Basis, cosine_basis, fit_noise

Array = NDArray[np.float64]

FOLDS = 4
_BLOCK_S = 4.0
_UNKNOWN = 1e-6  # of what is known of the reference, where it is held out
_ROUNDS = 2  # of amplitudes and noise


@dataclass(frozen=True)
class Gap:
    """Whitened squares on blocks that the fit did not see, by slot: without and with some columns, and how many."""

    before: dict[Slot, float]
    after: dict[Slot, float]
    count: dict[Slot, int]

    def rms(self, slots: Sequence[Slot]) -> tuple[float, float]:
        """Return the whitened RMS over slots, before and after; noise alone gives 1."""
        count = max(sum(self.count[s] for s in slots), 1)
        return (
            float(np.sqrt(sum(self.before[s] for s in slots) / count)),
            float(np.sqrt(sum(self.after[s] for s in slots) / count)),
        )


class HeldOut:
    """All that the columns of one fit have to say on blocks held out, gathered once."""

    def __init__(self, evidence: Evidence, fit: Fit) -> None:
        self._ids, self._prior = fit.ids, evidence.prior
        # Where the other blocks say nothing of an effect, it is taken for nothing, give or take its size.
        sizes = [self._prior.get(i, abs(float(size))) for i, size in zip(fit.ids, fit.amplitude, strict=True)]
        self._steady = np.diag([max(size, 1e-300) ** -2.0 if size else 0.0 for size in sizes])
        self._blocks = {slot: _Blocks.of(evidence, fit, slot) for slot in evidence.slots}
        self._weights: list[dict[Slot, Array]] = []
        self._seen: list[tuple[Array, Array]] = []
        self._unseen: list[tuple[Array, Array]] = []
        self._circumstance = np.array([i in self._prior for i in fit.ids], dtype=np.bool_)
        first = {slot: 1.0 / one.power for slot, one in self._blocks.items()}
        self._whole = self._products(first, range(FOLDS))
        for fold in range(FOLDS):
            weights = first
            for _ in range(_ROUNDS):
                amplitude = _solve(*self._products(weights, _others(fold)))
                weights = {slot: 1.0 / one.noise(amplitude, fold) for slot, one in self._blocks.items()}
            self._weights.append(weights)
            self._seen.append(self._products(weights, _others(fold)))
            self._unseen.append(self._products(weights, [fold]))

    def _products(self, weights: dict[Slot, Array], folds: Sequence[int]) -> tuple[Array, Array]:
        matrix, right = self._steady.copy(), np.zeros(len(self._ids))
        for slot, one in self._blocks.items():
            place = one.place
            matrix[np.ix_(place, place)] += np.tensordot(weights[slot], one.gram[folds].sum(axis=0), 1)
            right[place] += weights[slot] @ one.cross[folds].sum(axis=0)
        return matrix, right

    def _predicted(self, fold: int, keep: Sequence[int]) -> Array:
        """Return amplitudes as the other folds give them, the reference's errors as this one has them."""
        amplitude = np.zeros(len(self._ids))
        matrix, right = self._seen[fold]
        amplitude[keep] = _solve(matrix[np.ix_(keep, keep)], right[keep])
        own, effects = self._circumstance, ~self._circumstance
        matrix, right = self._unseen[fold]
        known = matrix[np.ix_(own, effects)] @ amplitude[effects]
        amplitude[own] = _solve(matrix[np.ix_(own, own)], right[own] - known)
        return amplitude

    def gained(self, columns: Sequence[int]) -> float:
        """Return by how much better blocks are predicted with some columns than without: twice the log of the ratio.

        That is of the probabilities of what is held out, given the other blocks, with all that these leave open of
        every amplitude: an effect that shows in a single block is predicted by no other, but not contradicted either.
        """
        every, some = range(len(self._ids)), [p for p, i in enumerate(self._ids) if i not in columns]
        blocks = sum(self._log_predicted(fold, every) - self._log_predicted(fold, some) for fold in range(FOLDS))
        return 2.0 * (blocks + self._log_reference(every) - self._log_reference(some))

    def _log_reference(self, keep: Sequence[int]) -> float:
        """Return :meth:`_log_predicted` of what is known of the reference, given all blocks."""
        matrix, right = self._whole
        known = np.where(self._circumstance, (1.0 - _UNKNOWN) * np.diag(self._steady), 0.0)
        square = np.ix_(keep, keep)
        return _log_weight(matrix[square], right[keep]) - _log_weight((matrix - np.diag(known))[square], right[keep])

    def _log_predicted(self, fold: int, keep: Sequence[int]) -> float:
        """Return ln of the probability of one fold given the others, but for what is the same whatever is kept."""
        (seen, right), (unseen, more) = self._seen[fold], self._unseen[fold]
        square = np.ix_(keep, keep)
        everything = _log_weight((seen + unseen - self._steady)[square], (right + more)[keep])
        return everything - _log_weight(seen[square], right[keep])

    def gap(self, without: Sequence[int] = ()) -> Gap:
        """Return the gap before and after; before, the columns ``without`` are not there; none: all but priors."""
        tried = list(without) or [i for i in self._ids if i not in self._prior]
        keep = [p for p, i in enumerate(self._ids) if i not in tried]
        before, after = dict.fromkeys(self._blocks, 0.0), dict.fromkeys(self._blocks, 0.0)
        count = dict.fromkeys(self._blocks, 0)
        for fold in range(FOLDS):
            full, some = self._predicted(fold, range(len(self._ids))), self._predicted(fold, keep)
            for slot, one in self._blocks.items():
                weight = self._weights[fold][slot]
                before[slot] += float(weight @ one.left(some, [fold]))
                after[slot] += float(weight @ one.left(full, [fold]))
                count[slot] += int(one.counts[fold]) * one.basis.n
        return Gap(before, after, count)


def _others(fold: int) -> list[int]:
    return [other for other in range(FOLDS) if other != fold]


def _log_weight(matrix: Array, right: Array) -> float:
    """Return ln of ∫exp(right·a - a·matrix·a/2) da, but for a constant."""
    if not right.size:
        return 0.0
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    unit = matrix / np.outer(scale, scale)
    unit[np.diag_indices(right.size)] += 1e-9
    _, log_det = np.linalg.slogdet(unit)
    return float(0.5 * (right / scale) @ np.linalg.solve(unit, right / scale) - 0.5 * log_det - np.sum(np.log(scale)))


def _solve(matrix: Array, right: Array) -> Array:
    if not right.size:
        return right
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    unit = matrix / np.outer(scale, scale)
    unit[np.diag_indices(right.size)] += 1e-9
    return np.asarray(np.linalg.solve(unit, right / scale) / scale)


@dataclass(frozen=True)
class _Blocks:
    """One slot cut to blocks: inner products of cosine coefficients by fold and bin of frequency.

    Of the k columns that touch the slot, at ``place`` among the fit's: ``gram`` (folds, bins, k, k), ``cross`` (folds,
    bins, k) with the residual, ``squares`` (folds, bins) of the residual; ``counts`` (folds,) of blocks. ``power``
    (bins,) is the noise to begin with, ``floor`` (bins,) what it never undercuts.
    """

    basis: Basis
    place: NDArray[np.int64]
    gram: Array
    cross: Array
    squares: Array
    counts: NDArray[np.int64]
    power: Array
    floor: Array

    @classmethod
    def of(cls, evidence: Evidence, fit: Fit, slot: Slot) -> _Blocks:
        """Gather the products of one slot."""
        whole, library = evidence.basis[slot], evidence.library
        length = max(8, min(round(_BLOCK_S / whole.interval_s), whole.n // (4 * FOLDS)))
        count, basis = whole.n // length, cosine_basis(length, whole.interval_s, tilted=slot[1] < 3)
        place = np.array([p for p, i in enumerate(fit.ids) if slot in library.columns[i].parts], dtype=np.int64)
        parts = [library.residual[slot], *(library.columns[fit.ids[p]].parts[slot] for p in place)]
        cut = np.stack([_cut(part, count, length) for part in parts], axis=2)
        # an order that repeats with no motion
        order = (np.arange(count) * 7 + np.arange(count) // 5) % FOLDS
        products = np.zeros((FOLDS, len(basis.counts), len(parts), len(parts)))
        for fold in range(FOLDS):
            mine = cut[order == fold]
            for b, (first, end) in enumerate(itertools.pairwise(basis.bounds)):
                rows = mine[:, first:end].reshape(-1, len(parts))
                products[fold, b] = rows.T @ rows
        own = np.maximum(whole.frequency_hz, 0.5 / (2.0 * whole.n * whole.interval_s))
        frequency = np.maximum(basis.frequency_hz, 0.5 / (2.0 * length * whole.interval_s))
        return cls(
            basis,
            place,
            products[:, :, 1:, 1:],
            products[:, :, 1:, 0],
            products[:, :, 0, 0],
            np.bincount(order, minlength=FOLDS),
            np.interp(frequency, own, fit.noise[slot].power),
            np.interp(frequency, own, evidence.floor[slot]),
        )

    def left(self, amplitude: Array, folds: Sequence[int]) -> Array:
        """Return the sums of squares (bins,) that amplitudes of all the fit's columns leave in some folds."""
        mine = amplitude[self.place]
        gram, cross = self.gram[folds].sum(axis=0), self.cross[folds].sum(axis=0)
        squares = self.squares[folds].sum(axis=0)
        return np.asarray(np.maximum(squares - 2.0 * cross @ mine + (gram @ mine) @ mine, 1e-12 * squares))

    def noise(self, amplitude: Array, fold: int) -> Array:
        """Return the noise power (bins,) that the blocks not held out have."""
        others = _others(fold)
        rss, count = self.left(amplitude, others), int(self.counts[others].sum())
        power = fit_noise(self.basis, rss, self.basis.counts * count, None, self.floor, blocks=True).power.copy()
        # A block's mean wanders with all the record, which no noise of the block's own length tells.
        power[0] = max(power[0], float(rss[0]) / count)
        return power


def _cut(coefficients: Array, count: int, length: int) -> Array:
    """Return the cosine coefficients (count, length) of blocks of a column given by those of the whole."""
    values = idct(coefficients, norm="ortho")[: count * length].reshape(count, length)
    return np.asarray(dct(values, axis=1, norm="ortho"))
