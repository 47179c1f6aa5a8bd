"""Evidence that a single sample gives (its influence): a glitch in the right place looks like an effect there.

Heavy-tailed noise has such samples in every record. What is really there shows in others too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import idct

from simulators.discrepancy.candidates import Hypothesis
from simulators.discrepancy.evidence import Evidence, Fit

Array = NDArray[np.float64]

_RIDGE = 1e-9


def gains_but_one(evidence: Evidence, hypothesis: Hypothesis, fit: Fit) -> tuple[float, float]:
    """Return what a hypothesis of a fit gains [nats] in its noise, from all samples and from all but the strongest.

    In the whitened record, with what all else in the fit can explain of the columns taken out of them (Frisch and
    Waugh 1933), each sample's part in the gain can be seen.
    """
    slots = sorted(evidence.touched(hypothesis.columns))
    others = [i for i in fit.ids if i not in hypothesis.columns and evidence.touched([i]) & set(slots)]
    known = np.column_stack([_whitened(evidence, fit, slots, {i: 1.0}) for i in others])
    size = {i: float(fit.amplitude[fit.ids.index(i)]) for i in hypothesis.columns}
    own = _whitened(evidence, fit, slots, size)
    left = np.concatenate([_white(evidence, fit, s, evidence.library.left(s, fit.ids, fit.amplitude)) for s in slots])
    scale = np.maximum(np.linalg.norm(known, axis=0), 1e-300)
    known = known / scale
    prior = [
        (evidence.prior[i] * s) ** -2.0 if i in evidence.prior else 0.0 for i, s in zip(others, scale, strict=True)
    ]
    gram = known.T @ known + np.diag(prior) + _RIDGE * np.eye(len(others))
    own = own - known @ np.linalg.solve(gram, known.T @ own)
    whole = float(own @ own)
    score = whole - own * (left + own)
    return 0.5 * whole, float(np.min(score**2 / np.maximum(2.0 * (whole - own**2), 1e-300)))


def _whitened(evidence: Evidence, fit: Fit, slots: list[tuple[int, int]], sizes: dict[int, float]) -> Array:
    """Return what columns of some sizes add to the whitened record of some slots, one behind the other."""
    rows = []
    for slot in slots:
        total = np.zeros(evidence.basis[slot].n)
        for i, size in sizes.items():
            part = evidence.library.columns[i].parts.get(slot)
            if part is not None:
                total += size * part
        rows.append(_white(evidence, fit, slot, total))
    return np.concatenate(rows)


def _white(evidence: Evidence, fit: Fit, slot: tuple[int, int], coefficients: Array) -> Array:
    weight = np.repeat(fit.noise[slot].power ** -0.5, evidence.basis[slot].counts.astype(np.int64))
    return np.asarray(idct(weight * coefficients, norm="ortho"))
