"""What filling gaps makes of noise: what stands for missing values repeats those beside it.

Of slow noise there is more then, of fast noise less. A readout in steps takes the error of each reading back with the
next: beside a gap it cannot.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import fft, ifft

from simulators.discrepancy.repair import Gaps

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_LONG = 48  # values missing in a row, beyond which each more is but one less
_MOST_WHITE = 0.999  # of noise, and next to nothing is left where next to nothing came
_MOST = 0.9  # of noise that gaps may take away, as far as gaps that are close to each other are like single ones


def filled_white(gaps: Gaps, frequency: Array) -> Array:
    """Return the power (b,) at frequencies [1/sample] of white noise whose gaps are filled, over that of whole."""
    if not gaps.missing.size:
        return np.ones(len(frequency))
    beside, gap, side, weight = _beside(gaps)
    values, which = np.unique(beside, return_inverse=True)
    known = np.zeros((2, len(gaps.spans)), dtype=np.bool_)
    known[side, gap] = True
    others, power = float(gaps.came.sum()) - values.size, np.empty(len(frequency))
    for k, omega in enumerate(2.0 * np.pi * frequency):
        turned = np.exp(1j * omega * gaps.missing)
        whole, late = (_over_gaps(gaps, of) for of in (turned, gaps.along * turned))
        left, right = np.where(known[1], whole - late, whole), np.where(known[0], late, whole)
        stands = weight * np.stack([left, right])[side, gap]
        counts = np.exp(1j * omega * values)
        counts += np.bincount(which, stands.real) + 1j * np.bincount(which, stands.imag)
        power[k] = (others + float(np.sum(np.abs(counts) ** 2))) / len(gaps.came)
    return np.maximum(power, 1.0 - _MOST_WHITE)


@dataclass(frozen=True)
class Filling:
    """What filled gaps make of noise of any colour: of b coefficients, by the covariance of values samples apart.

    ``pairs`` (b, m): how often values 0, 1 … samples apart count together, in and about the gaps; ``lost`` (b,): values
    that the coefficients lack; ``values`` of the record. Gaps are taken to be apart from each other: those that are not
    are counted in white noise alone, whose values are not alike (:func:`filled_white`).
    """

    pairs: Array
    lost: Array
    values: int

    @classmethod
    def of(cls, gaps: Gaps, frequency: Array) -> Filling:
        """Look at gaps, for coefficients of frequencies (b,) [1/sample]."""
        pairs, lost = np.zeros((len(frequency), 3 * _LONG)), np.zeros(len(frequency))
        for length, number in zip(*np.unique(gaps.lengths(), return_counts=True), strict=True):
            short = min(int(length), _LONG)
            change = _change(short, frequency)
            together = ifft(np.abs(fft(change, 6 * short, axis=1)) ** 2, axis=1).real[:, : 3 * short]
            together[:, 1:] *= 2.0
            pairs[:, : 3 * short] += number * together
            kept = np.sum(change * np.exp(-2j * np.pi * np.outer(frequency, np.arange(3 * short))), axis=1).real
            lost += number * (int(length) - short - 2.0 * kept)
        return cls(pairs, lost, len(gaps.came))

    def beyond(self, power: Array, covariance: Callable[[Array], Array]) -> Array:
        """Return the power (b,) that is there beyond that of whole noise (b,), or below zero what is lacking.

        ``covariance`` of the noise, of values so many samples (m,) apart.
        """
        own = self.pairs @ covariance(np.arange(float(self.pairs.shape[1])))
        return np.maximum((own - self.lost * power) / self.values, -_MOST * power)


def _change(length: int, frequency: Array) -> Complex:
    """Return what filling a gap makes of each value in it and beside it (b, 3 length) in each coefficient."""
    turned = np.exp(2j * np.pi * np.outer(frequency, np.arange(3 * length)))
    within = turned[:, length : 2 * length]
    later = within @ (np.arange(1.0, length + 1.0) / (length + 1.0))
    earlier = within.sum(axis=1) - later
    sides = [np.repeat(one[:, None] / length, length, axis=1) for one in (earlier, later)]
    return np.hstack([sides[0], -within, sides[1]])


def _over_gaps(gaps: Gaps, values: Complex) -> Complex:
    """Return the sum over each gap (gaps,) of values at the missing places (m,)."""
    return np.asarray(np.add.reduceat(values, np.flatnonzero(np.diff(gaps.gap, prepend=-1))))


def _beside(gaps: Gaps) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], Array]:
    """Return the places of the values that a mean beside a gap counts, their gap, side, and share of the mean."""
    found = []
    for side in (0, 1):
        begin, end = gaps.spans[:, 2 * side], gaps.spans[:, 2 * side + 1]
        gap = np.repeat(np.arange(len(begin)), end - begin)
        place = np.arange(len(gap)) + (end - np.cumsum(end - begin))[gap]
        place, gap = place[gaps.came[place]], gap[gaps.came[place]]
        share = 1.0 / np.bincount(gap, minlength=len(begin))[gap]
        found.append((place, gap, np.full(len(gap), side), share))
    place, gap, sides, share = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return place, gap, sides, share
