"""Inner products of one slot's columns and residual, per bin of frequency, gathered once.

Those of the library's own columns are multiplied when it is closed; those of columns that come later, trials of other
shapes, when they are asked for.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from simulators.discrepancy.candidates import Library, Slot

Array = NDArray[np.float64]
Place = TypeVar("Place", int, NDArray[np.int64])

_MANY = 64
_NOTHING = 1e-15  # share of a column's power: those of turns and of their errors are 1e5 σ, and cancel
_KEPT = 3  # sets of columns whose products are kept at hand
_WEIGHTS = 4  # ... and weights, of which a step of the search uses two or three again and again


@dataclass(frozen=True, eq=False)
class Products:
    """Of those columns that touch the slot, ``where`` (m,): with each other, and with the residual (bins, m).

    Those with each other are the Gram matrices' lower triangles, row by row: ``gram`` (bins, m (m + 1) / 2). Half of a
    matrix is all of it, and it is memory that a sum over bins or columns waits for.
    """

    where: NDArray[np.int64]
    gram: Array
    with_residual: Array

    def weighted(self, weight: Array) -> tuple[Array, Array]:
        """Return Gram (m, m) and products with the residual (m,), summed over bins with a weight (bins,)."""
        return unpacked(weight @ self.gram, len(self.where)), weight @ self.with_residual

    def within(self, matrix: Array) -> Array:
        """Return the sum (bins,) of the first columns' products, each times its entry of a symmetric matrix (k, k)."""
        rows, columns = lower(len(matrix))
        twice = np.where(rows == columns, 1.0, 2.0) * matrix[rows, columns]
        return np.asarray(self.gram[:, : len(rows)] @ twice)


class InnerProducts:
    """All inner products of one slot.

    Parameters
    ----------
    library, slot
        Whose columns; the library gathers no more.
    bounds : (bins + 1,)
        First coefficient of each bin, and the end.
    """

    def __init__(self, library: Library, slot: Slot, bounds: NDArray[np.int64]) -> None:
        self._columns, self._slot, self._bounds = library.columns, slot, bounds
        self._base = len(library.columns)
        self._residual = library.residual[slot]
        self._exact = bool(library.scenes[slot[0]].turns())
        parts = {i: column.parts[slot] for i, column in enumerate(library.columns) if slot in column.parts}
        reach = {i: _reach(part, bounds) for i, part in parts.items()}
        ids = sorted(parts, key=lambda i: -reach[i])  # the widest bands first
        self.place = {i: place for place, i in enumerate(ids)}
        """Of the library's columns that touch the slot, which rows and columns of the Gram matrices are theirs."""
        self._gram, self.with_residual, self.residual2 = self._binned(parts, reach)
        self._late: dict[tuple[int, int], Array] = {}
        self._across: dict[int, Array] = {}
        self._at_hand: dict[tuple[int, ...], Products] = {}
        self._weighted: deque[tuple[Array, tuple[Array, Array]]] = deque(maxlen=_WEIGHTS)

    def _binned(self, parts: dict[int, Array], reach: dict[int, int]) -> tuple[Array, Array, Array]:
        """Return the Gram matrices' lower triangles (bins, m (m + 1) / 2), the products with the residual, its own."""
        bins, n = len(self._bounds) - 1, len(self._residual)
        matrix = np.empty((n, len(parts) + 1))
        matrix[:, 0] = self._residual
        for i, place in self.place.items():
            matrix[:, place + 1] = parts[i]
        rows_of, columns_of = lower(len(parts))
        gram, with_residual = np.zeros((bins, len(rows_of))), np.zeros((bins, len(parts)))
        residual2 = np.zeros(bins)
        reaches = np.array([bins] + [reach[i] for i in self.place])
        for b, (first, end) in enumerate(itertools.pairwise(self._bounds)):
            count = int(np.sum(reaches > b))
            rows = matrix[first:end, :count]
            # Far from the few coefficients that tell slow effects apart. But errors in the timing of turns are known a
            # ten-thousandth as well beforehand as they show, so that a delay is told from them in the last digits.
            if end - first >= _MANY and not self._exact:
                rows = rows.astype(np.float32)
            products = rows.T @ rows
            residual2[b], with_residual[b, : count - 1] = products[0, 0], products[1:, 0]
            within = slice(count * (count - 1) // 2)
            gram[b, within] = products[1:, 1:][rows_of[within], columns_of[within]]
        return gram, with_residual, residual2

    def of(self, ids: Sequence[int]) -> Products:
        """Return the products of columns with each other and with the residual."""
        where = [place for place, i in enumerate(ids) if self._slot in self._columns[i].parts]
        mine = tuple(ids[place] for place in where)
        found = self._at_hand.pop(mine, None) or self._gathered(mine)
        self._at_hand[mine] = found  # the last one asked for goes last
        if len(self._at_hand) > _KEPT:
            del self._at_hand[next(iter(self._at_hand))]
        return Products(np.array(where, dtype=np.int64), found.gram, found.with_residual)

    def _gathered(self, ids: tuple[int, ...]) -> Products:
        """Return products put together; those of columns that a set at hand begins with as well are taken from it."""
        bins, count = len(self.residual2), len(ids)
        gram, with_residual = np.empty((bins, _entry(count, 0))), np.empty((bins, count))
        alike = max(self._at_hand, key=lambda other: _shared(other, ids), default=())
        begin = _shared(alike, ids)
        known = _entry(begin, 0)
        if begin:
            gram[:, :known] = self._at_hand[alike].gram[:, :known]
            with_residual[:, :begin] = self._at_hand[alike].with_residual[:, :begin]
        local = np.array([self.place[i] if i < self._base else -1 for i in ids], dtype=np.int64)
        rows, columns = (local[one[known:]] for one in lower(count))
        first = np.minimum(rows, columns) >= 0
        high, low = np.maximum(rows, columns)[first], np.minimum(rows, columns)[first]
        gram[:, known + np.flatnonzero(first)] = self._gram[:, _entry(high, low)]
        early = begin + np.flatnonzero(local[begin:] >= 0)
        with_residual[:, early] = self.with_residual[:, local[early]]
        for place in np.flatnonzero(local < 0).tolist():
            with_residual[:, place] = self._product(ids[place], -1)
            for other in range(0 if place >= begin else begin, count):
                entry = _entry(max(place, other), min(place, other))
                gram[:, entry] = self._product(ids[place], ids[other])
        return Products(np.arange(count), gram, with_residual)

    def _product(self, i: int, j: int) -> Array:
        """Return the products (bins,) of a late column with another, or with the residual (-1)."""
        key = (max(i, j), min(i, j))
        if key not in self._late:
            other = self._residual if j < 0 else self._columns[j].parts[self._slot]
            self._late[key] = np.add.reduceat(self._columns[i].parts[self._slot] * other, self._bounds[:-1])
        return self._late[key]

    def weighted(self, weight: Array) -> tuple[Array, Array]:
        """Return Gram and products with the residual of the library's columns, summed over bins with a weight."""
        for known, found in self._weighted:
            if np.array_equal(known, weight):
                return found
        found = unpacked(weight @ self._gram, len(self.place)), weight @ self.with_residual
        self._weighted.append((weight, found))
        return found

    def between(self, some: Sequence[int], others: Sequence[int], weight: Array) -> Array:
        """Return products (k, m) of some of the library's columns with others, late ones too, summed with a weight."""
        found = np.empty((len(some), len(others)))
        early = [place for place, i in enumerate(others) if i < self._base]
        mine = np.array([self.place[i] for i in some], dtype=np.int64)[:, None]
        among = np.array([self.place[others[place]] for place in early], dtype=np.int64)
        entries = _entry(np.maximum(mine, among), np.minimum(mine, among))
        found[:, early] = (weight @ self._gram[:, entries.ravel()]).reshape(entries.shape)
        for place, i in enumerate(others):
            if i >= self._base:
                found[:, place] = [weight @ self._product(i, j) for j in some]
        return found

    def across(self, i: int, weight: Array) -> Array:
        """Return products (m,) of a late column with the library's, summed over bins with a weight."""
        if i not in self._across:
            part, starts = self._columns[i].parts[self._slot], self._bounds[:-1]
            others = (self._columns[j].parts.get(self._slot, 0.0) for j in self.place)
            self._across[i] = np.array([np.add.reduceat(other * part, starts) for other in others])
        return np.asarray(self._across[i] @ weight)


@cache
def lower(count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows and columns of the lower triangle of a matrix (count, count), row by row."""
    return np.tril_indices(count)


def unpacked(triangle: Array, count: int) -> Array:
    """Return the symmetric matrix (count, count) of which a lower triangle is given."""
    matrix, (rows, columns) = np.empty((count, count)), lower(count)
    matrix[rows, columns] = matrix[columns, rows] = triangle
    return matrix


def _entry(row: Place, column: Place) -> Place:
    """Return where in a lower triangle a row's entry stands, or where the row begins."""
    return row * (row + 1) // 2 + column


def _shared(one: Sequence[int], two: Sequence[int]) -> int:
    """Return how many columns two sets begin with alike."""
    return next((k for k, (i, j) in enumerate(zip(one, two, strict=False)) if i != j), min(len(one), len(two)))


def _reach(part: Array, bounds: NDArray[np.int64]) -> int:
    """Return in how many bins a column has any power to speak of; beyond them it is not multiplied."""
    power = np.add.reduceat(part**2, bounds[:-1])
    left = np.cumsum(power[::-1])[::-1]
    return int(np.sum(left > _NOTHING * left[0]))
