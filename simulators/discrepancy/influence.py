"""The influence of single samples: a glitch in the right place looks like an effect that acts there.

Heavy-tailed noise has such samples in every record. What is really there shows in others too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

from simulators.discrepancy.candidates import Hypothesis, Slot
from simulators.discrepancy.evidence import Evidence, Fit

Array = NDArray[np.float64]

_RIDGE = 1e-9
_TOO_FEW, _TOO_FEW_OF_A_STEP = 1, 3  # samples


def too_few_samples(hypothesis: Hypothesis) -> int:
    """Return how many samples are too few for a name to rest on: more of a step, which another may soon undo."""
    return _TOO_FEW_OF_A_STEP if hypothesis.effect == "bias_step" else _TOO_FEW


def gains_but(evidence: Evidence, hypothesis: Hypothesis, fit: Fit, strongest_count: int) -> tuple[float, float]:
    """Return what a hypothesis of a fit gains [nats] in its noise, from all samples, and without the strongest.

    With what all else in the fit can explain of the columns taken out of them (Frisch and Waugh 1933), each sample's
    part in the gain can be seen and left out (Cook 1977): one by one, where the noise makes them depend on each other.
    """
    slots = sorted(evidence.touched(hypothesis.columns))
    whole, sizes = _alone(evidence, hypothesis, fit)
    weight = [fit.noise[s].power ** -1.0 for s in slots]
    column = _weighed(evidence, slots, weight, [evidence.library.added(s, fit.ids, sizes) for s in slots])
    left = _weighed(evidence, slots, weight, [evidence.library.left(s, fit.ids, fit.amplitude) for s in slots])
    own = np.concatenate(
        [np.full(evidence.basis[s].n, _mean(evidence, s, w)) for s, w in zip(slots, weight, strict=True)]
    )
    measured, score, size, gain = left + column, whole, whole, 0.5 * whole
    roots: list[Array] = []  # of the inverse covariance, of the samples left out so far (pivoted Cholesky)
    for _ in range(strongest_count):
        share = np.divide(column, own, out=np.zeros_like(column), where=own > _RIDGE * own.max())
        scores, others = score - share * measured, size - share * column
        but = np.divide(scores**2, 2.0 * others, out=np.zeros_like(scores), where=others > _RIDGE * whole)
        strongest = int(np.argmin(but))
        score, size, gain = float(scores[strongest]), float(others[strongest]), float(but[strongest])
        root = _tied(evidence, slots, weight, strongest)
        root -= sum(one * one[strongest] for one in roots)
        root /= np.sqrt(root[strongest])
        column = column - root * (column[strongest] / root[strongest])
        measured = measured - root * (measured[strongest] / root[strongest])
        own = own - root**2
        roots.append(root)
    return 0.5 * whole, gain


def _alone(evidence: Evidence, hypothesis: Hypothesis, fit: Fit) -> tuple[float, Array]:
    """Return χ² of a hypothesis beside all else in a fit, and of its columns without that the amplitudes (k,)."""
    ids = fit.ids
    gram, _ = evidence.normal(ids, {slot: noise.power for slot, noise in fit.noise.items()})
    own = np.array([i in hypothesis.columns for i in ids], dtype=np.bool_)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    unit = gram / np.outer(scale, scale)
    sizes = np.where(own, fit.amplitude * scale, 0.0)
    prior = np.array([evidence.prior.get(i, np.inf) for i in ids])[~own] * scale[~own]
    across = unit[np.ix_(~own, own)] @ sizes[own]
    known = np.linalg.solve(unit[np.ix_(~own, ~own)] + np.diag(prior**-2.0 + _RIDGE), across)
    whole = float(sizes[own] @ unit[np.ix_(own, own)] @ sizes[own] - across @ known)
    sizes[~own] = -known
    return whole, np.asarray(sizes / scale)


def _mean(evidence: Evidence, slot: Slot, weight: Array) -> float:
    """Return the mean of a weight (bins,) over all coefficients of a slot."""
    return float(weight @ evidence.basis[slot].counts / evidence.basis[slot].n)


def _weighed(evidence: Evidence, slots: Sequence[Slot], weight: Sequence[Array], parts: Sequence[Array]) -> Array:
    """Return samples of some slots, one slot after another, of coefficients (n,) times a weight (bins,) of each."""
    each = [evidence.basis[s].each(w) * part for s, w, part in zip(slots, weight, parts, strict=True)]
    return np.concatenate([idct(one, norm="ortho") for one in each])


def _tied(evidence: Evidence, slots: Sequence[Slot], weight: Sequence[Array], place: int) -> Array:
    """Return by how much each sample of some slots depends on that at one place: a column of the inverse covariance."""
    ends = np.cumsum([evidence.basis[s].n for s in slots])
    mine = int(np.searchsorted(ends, place, side="right"))
    parts = [np.zeros(evidence.basis[s].n) for s in slots]
    parts[mine][place - (ends[mine] - parts[mine].size)] = 1.0
    parts[mine] = dct(parts[mine], norm="ortho")
    return _weighed(evidence, slots, weight, parts)
