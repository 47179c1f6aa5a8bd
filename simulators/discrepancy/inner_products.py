"""Inner products of one slot's columns and residual, per bin of frequency, gathered once.

Those of the library's own columns are multiplied when it is closed; those of columns that come later, trials of other
shapes, when they are asked for.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulators.discrepancy.candidates import Library, Slot

Array = NDArray[np.float64]

_MANY = 64
_NOTHING = 1e-15  # share of a column's power: those of turns and of their errors are 1e5 σ, and cancel
_KEPT = 3  # sets of columns whose products are kept at hand
_WEIGHTS = 4  # ... and weights, of which a step of the search uses two or three again and again


@dataclass(frozen=True, eq=False)
class Products:
    """Of those columns that touch the slot, ``where`` (m,): Gram (bins, m, m), and with the residual (bins, m)."""

    where: NDArray[np.int64]
    gram: Array
    with_residual: Array


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
        self._lower = np.tril_indices(len(parts))
        self._gram, self.with_residual, self.residual2 = self._binned(parts, reach)
        self._late: dict[tuple[int, int], Array] = {}
        self._across: dict[int, Array] = {}
        self._at_hand: dict[tuple[int, ...], Products] = {}
        self._weighted: deque[tuple[Array, tuple[Array, Array]]] = deque(maxlen=_WEIGHTS)

    def _binned(self, parts: dict[int, Array], reach: dict[int, int]) -> tuple[Array, Array, Array]:
        """Return the Gram matrices' lower triangles (bins, m (m + 1) / 2), the products with the residual, and its own.

        Half of a matrix is all of it, and it is memory that a sum over bins waits for.
        """
        bins, n = len(self._bounds) - 1, len(self._residual)
        matrix = np.empty((n, len(parts) + 1))
        matrix[:, 0] = self._residual
        for i, place in self.place.items():
            matrix[:, place + 1] = parts[i]
        gram, with_residual = np.zeros((bins, len(self._lower[0]))), np.zeros((bins, len(parts)))
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
            gram[b, within] = products[1:, 1:][self._lower[0][within], self._lower[1][within]]
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
        gram, with_residual = np.empty((bins, count, count)), np.empty((bins, count))
        alike = max(self._at_hand, key=lambda other: _shared(other, ids), default=())
        begin = _shared(alike, ids)
        if begin:
            gram[:, :begin, :begin] = self._at_hand[alike].gram[:, :begin, :begin]
            with_residual[:, :begin] = self._at_hand[alike].with_residual[:, :begin]
        first = np.array([place for place, i in enumerate(ids) if i < self._base], dtype=np.int64)
        among = np.array([self.place[ids[place]] for place in first], dtype=np.int64)
        for place in range(begin, count):
            if ids[place] < self._base:
                local = self.place[ids[place]]
                high, low = np.maximum(among, local), np.minimum(among, local)
                products = self._gram[:, high * (high + 1) // 2 + low]
                gram[:, place, first] = gram[:, first, place] = products
                with_residual[:, place] = self.with_residual[:, local]
        for place in (place for place, i in enumerate(ids) if i >= self._base):
            with_residual[:, place] = self._product(ids[place], -1)
            for other in range(0 if place >= begin else begin, count):
                gram[:, place, other] = gram[:, other, place] = self._product(ids[place], ids[other])
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
        gram, (rows, columns) = np.empty((len(self.place), len(self.place))), self._lower
        gram[rows, columns] = gram[columns, rows] = weight @ self._gram
        found = gram, weight @ self.with_residual
        self._weighted.append((weight, found))
        return found

    def across(self, i: int, weight: Array) -> Array:
        """Return products (m,) of a late column with the library's, summed over bins with a weight."""
        if i not in self._across:
            part, starts = self._columns[i].parts[self._slot], self._bounds[:-1]
            others = (self._columns[j].parts.get(self._slot, 0.0) for j in self.place)
            self._across[i] = np.array([np.add.reduceat(other * part, starts) for other in others])
        return np.asarray(self._across[i] @ weight)


def _shared(one: Sequence[int], two: Sequence[int]) -> int:
    """Return how many columns two sets begin with alike."""
    return next((k for k, (i, j) in enumerate(zip(one, two, strict=False)) if i != j), min(len(one), len(two)))


def _reach(part: Array, bounds: NDArray[np.int64]) -> int:
    """Return in how many bins a column has any power to speak of; beyond them it is not multiplied."""
    power = np.add.reduceat(part**2, bounds[:-1])
    left = np.cumsum(power[::-1])[::-1]
    return int(np.sum(left > _NOTHING * left[0]))
