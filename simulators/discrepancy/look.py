"""A first look: what each hypothesis would gain beside a fit at a given noise, the noise not refitted.

Milliseconds for all that a library holds, so that only those that promise something are fitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simulators.discrepancy.candidates import Hypothesis, Slot
from simulators.discrepancy.evidence import RIDGE, Evidence, Fit
from simulators.discrepancy.whitening import NoiseFit

Array = NDArray[np.float64]
Sums = tuple[Array, Array, Array]
"""Weighted products of columns with each other, with the residual, and with the columns of the fit."""

_APART = 1e-3  # squared sine between two columns that are tried together
_FEW = 8  # columns that are multiplied one by one
_LEFT_OVER = 1e-9  # of a column's power, that the others must leave: of a clock's little more than turns' lateness


class Look:
    """What hypotheses would gain beside a fit.

    Parameters
    ----------
    evidence
        With the library that they are from.
    current : the fit.
    noise : by slot, in which to look.
    """

    def __init__(self, evidence: Evidence, current: Fit, noise: Mapping[Slot, NoiseFit]) -> None:
        self.evidence, self.active, self.noise = evidence, list(current.ids), noise
        self._weight = {slot: evidence.came[slot] / noise[slot].power for slot in evidence.slots}
        k = len(self.active)
        matrix, right = evidence.normal(self.active, {slot: fitted.power for slot, fitted in noise.items()})
        matrix += np.diag([1.0 / evidence.prior[i] ** 2 if i in evidence.prior else 0.0 for i in self.active])
        scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        unit = matrix / np.outer(scale, scale)
        unit[np.diag_indices(k)] += RIDGE
        self._inverse = np.linalg.inv(unit) / np.outer(scale, scale) if k else unit
        self._amplitude = self._inverse @ right
        self._each: dict[Slot, Array] = {}

    def gains(self, hypotheses: Sequence[Hypothesis]) -> Array:
        """Return by how much each hypothesis raises the log-likelihood [nats]."""
        gains = np.zeros(len(hypotheses))
        alike: dict[tuple[int, bool], list[int]] = {}
        late: dict[frozenset[Slot], list[int]] = {}
        for place, h in enumerate(hypotheses):
            if max(h.columns) < self.evidence.base:
                alike.setdefault((len(h.columns), h.unit_amplitude), []).append(place)
            else:
                late.setdefault(frozenset(self.evidence.touched(h.columns)), []).append(place)
        for places in late.values():
            gains[places] = self._late_gains([hypotheses[place] for place in places])
        for (_, unit), places in alike.items():
            columns = np.array([hypotheses[place].columns for place in places])
            found = self._explained(self._of_first(columns), unit)
            gains[places] = np.where(np.isin(columns, self.active).any(axis=1), 0.0, found)
        return gains

    def gain(self, hypothesis: Hypothesis) -> float:
        """Return by how much a hypothesis raises the log-likelihood [nats]."""
        return float(self.gains([hypothesis])[0])

    def pairs(self, ids: Sequence[int]) -> Array:
        """Return by how much each two of m of the library's first columns raise the log-likelihood (m, m)."""
        if not ids:
            return np.zeros((0, 0))
        (own,), (score,), (cross,) = self._of_first(np.array([ids]))
        left = score - cross @ self._amplitude
        inside = own - cross @ self._inverse @ cross.T
        size = np.sqrt(np.maximum(np.diag(inside), 1e-300))
        seen = np.diag(inside) > _LEFT_OVER * np.diag(own)
        along = np.where(seen, left / size, 0.0)
        alike = np.clip(inside / np.outer(size, size), -1.0, 1.0)
        apart = 1.0 - alike**2
        both = along[:, None] ** 2 + along**2 - 2.0 * alike * np.outer(along, along)
        told = (apart > _APART) & np.outer(seen, seen)
        return np.asarray(np.where(told, 0.5 * both / np.maximum(apart, _APART), 0.0))

    def _late_gains(self, hypotheses: Sequence[Hypothesis]) -> Array:
        """Return the gains (m,) of hypotheses that came after the library's and touch the same slots."""
        own, score, cross = self._of_late([i for h in hypotheses for i in h.columns])
        gains, first = np.zeros(len(hypotheses)), 0
        for place, h in enumerate(hypotheses):
            rows = slice(first, first + len(h.columns))
            first = rows.stop
            if not any(i in self.active for i in h.columns):
                sums = own[None, rows, rows], score[None, rows], cross[None, rows]
                gains[place] = self._explained(sums, h.unit_amplitude)[0]
        return gains

    def _explained(self, sums: Sums, unit_amplitude: bool) -> Array:
        """Return the gains (m,) of m hypotheses of k columns each, given their sums (m, k, k), (m, k), (m, k, active).

        What the others leave of columns that are nearly theirs is rounding and counts for nothing.
        """
        own, score, cross = sums
        left = score - cross @ self._amplitude
        inside = own - cross @ self._inverse @ cross.transpose(0, 2, 1)
        if unit_amplitude:
            return np.asarray(left.sum(axis=1) - 0.5 * inside.sum(axis=(1, 2)))
        size = np.sqrt(np.maximum(np.diagonal(own, axis1=1, axis2=2), 1e-300))
        values, vectors = np.linalg.eigh(inside / (size[:, :, None] * size[:, None, :]))
        along = np.einsum("mkj,mk->mj", vectors, left / size)
        seen = values > _LEFT_OVER
        return np.asarray(0.5 * np.sum(np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0), axis=1))

    def _of_first(self, columns: NDArray[np.int64]) -> Sums:
        """Return the sums of the library's first columns, k each of m hypotheses (m, k)."""
        if columns.size > _FEW:
            sums, places = self._first, columns
        else:
            sums, places = self._some(columns.ravel().tolist()), np.arange(columns.size).reshape(columns.shape)
        whole, score, cross = sums
        return whole[places[:, :, None], places[:, None, :]], score[places], cross[places]

    def _some(self, ids: list[int]) -> Sums:
        """Return the same as :meth:`_first` of a few columns, for which the others need not be summed."""
        evidence, parts = self.evidence, self.evidence.library.columns
        own, score, cross = np.zeros((len(ids), len(ids))), np.zeros(len(ids)), np.zeros((len(ids), len(self.active)))
        for slot in evidence.touched(ids):
            inner, weight = evidence.inner[slot], self._weight[slot]
            mine = [place for place, i in enumerate(ids) if i in inner.place]
            beside = [place for place, i in enumerate(self.active) if slot in parts[i].parts]
            some = [ids[place] for place in mine]
            sums = inner.between(some, [*some, *(self.active[place] for place in beside)], weight)
            own[np.ix_(mine, mine)] += sums[:, : len(mine)]
            cross[np.ix_(mine, beside)] += sums[:, len(mine) :]
            score[mine] += weight @ inner.with_residual[:, [inner.place[i] for i in some]]
        return own, score, cross

    @cached_property
    def _first(self) -> Sums:
        """Of the library's first: products with each other (base, base), the residual, the active ones (base, k)."""
        evidence, base = self.evidence, self.evidence.base
        whole, score, cross = np.zeros((base, base)), np.zeros(base), np.zeros((base, len(self.active)))
        for slot in evidence.slots:
            inner = evidence.inner[slot]
            ids = np.fromiter(inner.place, dtype=np.int64)
            gram, with_residual = inner.weighted(self._weight[slot])
            whole[np.ix_(ids, ids)] += gram
            score[ids] += with_residual
            for place, i in enumerate(self.active):
                if i in inner.place:
                    cross[ids, place] += gram[:, inner.place[i]]
                elif slot in evidence.library.columns[i].parts:
                    cross[ids, place] += inner.across(i, self._weight[slot])
        return whole, score, cross

    def _spread(self, slot: Slot) -> Array:
        """Return a slot's weight by coefficient (n,)."""
        if slot not in self._each:
            self._each[slot] = self.evidence.basis[slot].each(self._weight[slot])
        return self._each[slot]

    def _of_late(self, ids: Sequence[int]) -> Sums:
        """Return the sums of columns of which some came after the library's, without any binning."""
        columns, k = self.evidence.library.columns, len(ids)
        own, score, cross = np.zeros((k, k)), np.zeros(k), np.zeros((k, len(self.active)))
        for slot in self.evidence.touched(ids):
            mine = np.zeros((k, self.evidence.basis[slot].n))
            for place, i in enumerate(ids):
                if slot in columns[i].parts:
                    mine[place] = columns[i].parts[slot]
            weighted = mine * self._spread(slot)
            own += mine @ weighted.T
            score += weighted @ self.evidence.library.residual[slot]
            known, stack = self.evidence.stack(slot)
            # Row by row: BLAS multiplies a matrix by a vector as fast as memory goes, and by two or three far slower.
            together = np.array([row @ stack for row in weighted]) if k < _FEW else weighted @ stack
            for place, i in enumerate(self.active):
                if i in known:
                    cross[:, place] += together[:, known.index(i)]
                elif slot in columns[i].parts:
                    cross[:, place] += weighted @ columns[i].parts[slot]
        return own, score, cross
