"""Neighbouring samples summed to one, for recordings too long to be kept whole.

Increments are integrals, so that the sum of some is the increment over their joint interval, exactly. What acts on
every sample by itself (a dead band, a limit, a register that stands still for a moment) is seen in the sums alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from drivers.samples import SampleArray, empty_samples


def summed(pieces: Iterable[SampleArray], together: int) -> SampleArray:
    """Return samples of ``together`` frames each, their numbers counting from 0.

    A sample of which a frame was lost is left out, as a lost frame is. Increments are added up, temperature and supply
    averaged, conditions joined; ``time`` is that of the last frame, as of every sample.
    """
    parts = [_sums(rows, group, together) for rows, group in _whole_groups(pieces, together)]
    return np.concatenate(parts) if parts else empty_samples()


def _whole_groups(pieces: Iterable[SampleArray], together: int) -> Iterator[tuple[SampleArray, NDArray[np.int64]]]:
    """Yield samples in pieces that end where a group does, with the group of each."""
    held: SampleArray | None = None
    base = 0  # frames since the first, of the first that is held
    for piece in pieces:
        rows = piece if held is None else np.concatenate([held, piece])
        steps = np.diff(rows["sequence"]).astype(np.int32).astype(np.int64)  # modulo 2³²: a wrap counts as one
        place = base + np.concatenate([[0], np.cumsum(steps)])
        group = place // together
        begun = group == group[-1]
        if not begun.all():
            yield rows[~begun], group[~begun]
        first = int(np.argmax(begun))
        held, base = rows[first:].copy(), int(place[first])
    if held is not None:
        yield held, np.full(len(held), base // together, dtype=np.int64)


def _sums(rows: SampleArray, group: NDArray[np.int64], together: int) -> SampleArray:
    first = np.flatnonzero(np.diff(group, prepend=-1))
    count = np.diff(np.append(first, len(rows)))
    out = empty_samples(len(first), rows["temperature"].shape[1])
    out["sequence"] = group[first]
    out["time"] = rows["time"][first + count - 1]
    for name in ("dv", "dtheta"):
        out[name] = np.add.reduceat(rows[name], first, axis=0)
    for name in ("temperature", "supply"):
        mean = np.add.reduceat(rows[name].astype(np.float64), first, axis=0)
        out[name] = mean / (count if mean.ndim == 1 else count[:, None])
    out["status"] = np.bitwise_or.reduceat(rows["status"], first)
    return np.asarray(out[count == together])
