"""The influence of single samples: a glitch in the right place looks like an effect that acts there.

Heavy-tailed noise has such samples in every record. What is really there shows in others too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.fft import idct

from simulators.discrepancy.candidates import Hypothesis, Slot
from simulators.discrepancy.evidence import Evidence, Fit

Array = NDArray[np.float64]

_RIDGE = 1e-9


def gains_but_one(evidence: Evidence, hypothesis: Hypothesis, fit: Fit) -> tuple[float, float]:
    """Return what a hypothesis of a fit gains [nats] in its noise, from all samples and from all but the strongest.

    In the whitened record, with what all else in the fit can explain of the columns taken out of them (Frisch and
    Waugh 1933), each sample's part in the gain can be seen and left out (Cook 1977).
    """
    ids, slots, library = fit.ids, sorted(evidence.touched(hypothesis.columns)), evidence.library
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
    column = _white(evidence, fit, slots, [library.added(s, ids, sizes / scale) for s in slots])
    left = _white(evidence, fit, slots, [library.left(s, ids, fit.amplitude) for s in slots])
    score = whole - column * (left + column)
    others = whole - column**2
    but_one = np.divide(score**2, 2.0 * others, out=np.zeros_like(score), where=others > _RIDGE * whole)
    return 0.5 * whole, float(np.min(but_one))


def _white(evidence: Evidence, fit: Fit, slots: Sequence[Slot], coefficients: Sequence[Array]) -> Array:
    """Return the whitened samples of some slots, one slot after another, of which these are the coefficients (n,)."""
    roots = [evidence.basis[s].each(fit.noise[s].power ** -0.5) for s in slots]
    return np.concatenate([idct(root * one, norm="ortho") for root, one in zip(roots, coefficients, strict=True)])
