"""How likely what a fit leaves is under given noise, and the variances of noise terms that make it most likely."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from simulators.discrepancy.candidates import Slot
from simulators.discrepancy.evidence import Evidence, Fit
from simulators.discrepancy.fisher_scoring import climb
from simulators.discrepancy.whitening import whittle

Array = NDArray[np.float64]

_START = 0.1  # of the most that the residual holds of a term, where the climb begins


def log_likelihood(evidence: Evidence, fit: Fit, power: Mapping[Slot, Array]) -> float:
    """Return the log-likelihood [nats] of what a fit leaves under noise of a power by slot (b,), the means left out."""
    return sum(whittle(fit.rss[slot], evidence.basis[slot].counts, now) for slot, now in power.items())


def most_likely(
    evidence: Evidence, fit: Fit, power: Mapping[Slot, Array], columns: Mapping[Slot, Array], start: Array
) -> Array:
    """Return the variances (k,) of columns (b, k) on top of a power (b,) that are most likely, the means left out.

    ``start`` (k,): where to begin.
    """
    slots = list(power)
    rows = np.ascontiguousarray(np.vstack([columns[slot][1:] for slot in slots]))
    rss, floor = (np.concatenate([by_slot[slot][1:] for slot in slots]) for by_slot in (fit.rss, power))
    counts = np.concatenate([evidence.basis[slot].counts[1:] for slot in slots])
    variances = np.array(start, dtype=np.float64)
    climb(rows, rss, counts, floor, variances, 0)
    return variances


def start_of(evidence: Evidence, fit: Fit, power: Mapping[Slot, Array], columns: Mapping[Slot, Array]) -> Array:
    """Return where to begin with columns (b, k): a share of what is left, at the place where each is largest."""
    largest = []
    for slot, column in columns.items():
        left = np.maximum(fit.rss[slot] / evidence.basis[slot].counts - power[slot], 0.01 * power[slot])
        peak = np.argmax(column, axis=0)
        largest.append(left[peak] / np.maximum(np.max(column, axis=0), 1e-300))
    return np.asarray(_START * np.max(largest, axis=0))
