"""Messages made of fields that each tell their kind and length: like ones gathered and read together.

MIP and MTData2 are of this kind. A device sends the same fields again and again, so that the places of the fields are
worked out once for each combination.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.protocols.base import Frame
from drivers.protocols.readings import Bytes, table


class Field(NamedTuple):
    """One field of a message: what it is, and its data in ``message[start:stop]``."""

    kind: int
    start: int
    stop: int


Fields = tuple[Field, ...]


def alike(
    frames: Sequence[Frame], fields_of: Callable[[bytes], Fields]
) -> list[tuple[Fields, NDArray[np.intp], Bytes]]:
    """Return runs of neighbours with the same fields: fields, indices of frames and their bytes (n, length)."""
    runs: list[tuple[Fields, int, list[int]]] = []
    for index, frame in enumerate(frames):
        fields, length = fields_of(frame.data), len(frame.data)
        if not runs or runs[-1][:2] != (fields, length):
            runs.append((fields, length, []))
        runs[-1][2].append(index)
    found = []
    for fields, length, indices in runs:
        run = np.array(indices, np.intp)
        found.append((fields, run, table(frames, run, 0, length)))
    return found


def column(rows: Bytes, field: Field, dtype: str) -> NDArray[np.generic]:
    """Return the data of a field of every row as numbers (n, k)."""
    values: NDArray[np.generic] = np.ascontiguousarray(rows[:, field.start : field.stop]).view(dtype)
    return values
