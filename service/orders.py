"""What the sequencer orders of those who work for it, and what they reply."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from drivers.samples import SampleArray
from inertial.documents import Result, StageTerms, WindowRecord

Question = Literal["identity", "read", "start", "self_test", "write", "read_back"]


@dataclass(frozen=True)
class AskBlock:
    """Have the block asked; the reply carries the same token."""

    token: int
    what: Question
    terms: StageTerms | None = None


@dataclass(frozen=True)
class MeasuredTurn:
    """A turn of the block between two windows, as gyros and accelerometers measured it (rotation vector, body)."""

    start_s: float
    end_s: float
    rotation_rad: NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """Have the windows estimated, for progress or (``final``) as the run's result."""

    token: int
    run_id: str
    windows: tuple[WindowRecord, ...]
    turns: tuple[MeasuredTurn, ...]
    samples: SampleArray
    final: bool


@dataclass(frozen=True)
class Conclude:
    """Have the result kept as the run's, with the state that the run ends in and why; READY waits for the reply."""

    token: int
    run_id: str
    state: Literal["READY", "FAULT"]
    reason: str
    result: Result


@dataclass(frozen=True)
class Keep:
    """Have the samples of a run that ends without a result kept as its recording."""

    run_id: str
    windows: tuple[WindowRecord, ...]
    turns: tuple[MeasuredTurn, ...]
    samples: SampleArray


Order = AskBlock | Estimate | Conclude | Keep


@dataclass(frozen=True)
class Reply:
    """What became of an order. ``unsupported``: the block's protocol has no such question."""

    token: int
    what: str
    value: Any = None
    error: str | None = None
    unsupported: bool = False
