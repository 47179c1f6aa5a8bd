"""Whether noise of a larger white term goes on all the time, as the term says, or is that of one burst.

What comes and goes is looked for at low frequencies, where structure is. A burst of white noise has little of itself
there and makes the whole record's noise seem larger, so where that has the name of white noise all frequencies are
asked.
"""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray
from scipy.fft import idct

from inertial.documents import CHANNELS
from simulators.discrepancy.candidates import Slot
from simulators.discrepancy.evidence import Evidence, Fit
from simulators.discrepancy.nonstationarity import MARGIN, Unsteady, clipped_white

Array = NDArray[np.float64]

_BLOCKS, _FEWEST = 400, 16  # of a record, and coefficients that a block has at least
_LONGEST = 0.25  # of the record that a burst lasts; what lasts longer may be noise of another level
_SHARE_SEEN = 0.8  # of a block that must have been measured


def find_bursts(evidence: Evidence, fit: Fit, channels: Collection[str]) -> list[Unsteady]:
    """Return the slots of some channels in which one span has more noise, of all frequencies, than the rest."""
    found = [_of_slot(evidence, fit, slot) for slot in evidence.slots if CHANNELS[slot[1]] in channels]
    return [one for one in found if one.nats > MARGIN]


def _of_slot(evidence: Evidence, fit: Fit, slot: Slot) -> Unsteady:
    basis, scene = evidence.basis[slot], evidence.library.scenes[slot[0]]
    left = idct(evidence.library.left(slot, fit.ids, fit.amplitude), norm="ortho")
    # Above, rounding errors come and go.
    highest = int(min(basis.n, 2.0 * basis.n * basis.interval_s * scene.freely_rounded_hz(slot[1])))
    white = clipped_white(evidence, fit, slot, left)
    white[highest:] = 0.0
    count = max(min(_BLOCKS, highest // _FEWEST), 1)
    came = ~(scene.data.missing[:, slot[1]] | scene.shaking())[: basis.n * scene.group]
    seen = np.array([part.mean() for part in np.array_split(came, count)]) > _SHARE_SEEN
    power = np.array([part.mean() for part in np.array_split(np.square(idct(white, norm="ortho")), count)])
    if seen.sum() < 1.0 / _LONGEST:
        return Unsteady(CHANNELS[slot[1]], 0.0, 0.0)
    nats, middle = _one_burst(power[seen], highest / count)
    place = (np.flatnonzero(seen)[middle] + 0.5) / count
    when_s = float(scene.time_s[0] + place * (scene.time_s[-1] - scene.time_s[0]))
    return Unsteady(CHANNELS[slot[1]], when_s, nats - math.log(len(CHANNELS)))


def _one_burst(power: Array, freedom: float) -> tuple[float, int]:
    """Return by how much [nats] one span of blocks with a power of its own is likelier, and the block at its middle.

    ``power`` (k,) of each block, of so many degrees of ``freedom``; less the logarithm of the number of spans. How much
    blocks scatter by themselves, the ordinary ones say: where more than Gaussian noise's, it is evidence of less.
    """
    power = np.maximum(power, 1e-300)
    k, total = power.size, np.concatenate([[0.0], np.cumsum(power)])
    first, end = np.triu_indices(k + 1, 1)
    kept = end - first <= _LONGEST * k
    first, end = first[kept], end[kept]
    length = (end - first).astype(np.float64)
    within = (total[end] - total[first]) / length
    beside = (total[-1] - total[end] + total[first]) / (k - length)
    mean = total[-1] / k
    gain = 0.5 * freedom * (k * math.log(mean) - length * np.log(within) - (k - length) * np.log(beside))
    gain[within < beside] = 0.0
    best = int(np.argmax(gain))
    return float(gain[best]) / _scatter(power, freedom) - math.log(gain.size), int(first[best] + end[best] - 1) // 2


def _scatter(power: Array, freedom: float) -> float:
    """Return by how much the middle half of blocks (k,) scatters more than χ² of such a ``freedom``, 1 or more."""
    low, middle, high = np.quantile(power, (0.25, 0.5, 0.75))
    return max(1.0, float((high - low) / (1.349 * middle)) ** 2 * 0.5 * freedom)
