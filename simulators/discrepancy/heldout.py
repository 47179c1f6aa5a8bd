"""Prediction of data that a fit did not see: short blocks of the record, held out in turns, at one noise model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

from simulators.discrepancy.candidates import Slot
from simulators.discrepancy.evidence import Evidence, Fit

Array = NDArray[np.float64]

FOLDS = 4
_BLOCK_S = 4.0


@dataclass(frozen=True)
class HeldOut:
    """Whitened squares on blocks that the fit did not see, by slot: without and with the columns, and how many."""

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


def held_out(evidence: Evidence, fit: Fit, without: Sequence[int] = ()) -> HeldOut:
    """Fit amplitudes on three quarters of the blocks and predict the fourth, in turns.

    ``without`` are columns of the fit that stand for the state *before*; none: all that is not nuisance.
    """
    prior = evidence.prior
    tried = list(without) or [i for i in fit.ids if i not in prior]
    k = len(fit.ids)
    blocks = {slot: _blocks(evidence, fit, slot) for slot in evidence.slots}
    before = dict.fromkeys(evidence.slots, 0.0)
    after, count = dict(before), dict.fromkeys(evidence.slots, 0)
    keep = [p for p, i in enumerate(fit.ids) if i not in tried]
    for fold in range(FOLDS):
        matrix = np.diag([1.0 / prior[i] ** 2 if i in prior else 0.0 for i in fit.ids])
        right = np.zeros(k)
        for columns, residual, place in blocks.values():
            seen = place % FOLDS != fold
            matrix += np.tensordot(columns[seen], columns[seen], ((0, 1), (0, 1)))
            right += np.tensordot(columns[seen], residual[seen], ((0, 1), (0, 1)))
        full = _solve(matrix, right)
        some = np.zeros(k)
        some[keep] = _solve(matrix[np.ix_(keep, keep)], right[keep])
        for slot, (columns, residual, place) in blocks.items():
            unseen = place % FOLDS == fold
            before[slot] += float(np.sum((residual[unseen] - columns[unseen] @ some) ** 2))
            after[slot] += float(np.sum((residual[unseen] - columns[unseen] @ full) ** 2))
            count[slot] += int(residual[unseen].size)
    return HeldOut(before, after, count)


def _solve(matrix: Array, right: Array) -> Array:
    if not right.size:
        return right
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    unit = matrix / np.outer(scale, scale)
    unit[np.diag_indices(right.size)] += 1e-9
    return np.asarray(np.linalg.solve(unit, right / scale) / scale)


def _blocks(evidence: Evidence, fit: Fit, slot: Slot) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return whitened columns (blocks, length, k), residual (blocks, length) and the blocks' order."""
    basis = evidence.basis[slot]
    length = max(8, min(round(_BLOCK_S / basis.interval_s), basis.n // (4 * FOLDS)))
    count = basis.n // length
    frequency = np.maximum(np.arange(length), 0.5) / (2.0 * length * basis.interval_s)
    own = np.maximum(basis.frequency_hz, 0.5 / (2.0 * basis.n * basis.interval_s))
    sigma = np.sqrt(np.interp(frequency, own, fit.noise[slot].power))

    def cut(coefficients: Array) -> Array:
        values = idct(coefficients, norm="ortho")[: count * length].reshape(count, length)
        return np.asarray(dct(values, axis=1, norm="ortho") / sigma)

    library = evidence.library
    columns = np.zeros((count, length, len(fit.ids)))
    for place, i in enumerate(fit.ids):
        part = library.columns[i].parts.get(slot)
        if part is not None:
            columns[:, :, place] = cut(part)
    # blocks in an order that repeats with no motion: multiplication by a number prime to the count
    order = (np.arange(count) * 7 + np.arange(count) // 5) % FOLDS
    return columns, cut(library.residual[slot]), order.astype(np.int64)
