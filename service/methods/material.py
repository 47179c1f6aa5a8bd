"""What every method is given and what it gives back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.recording_meta import TurnMeta
from inertial.alignment import Alignment
from inertial.budget import Errors
from inertial.documents import Combination, Noise, Observability, WindowRecord
from inertial.error_model import Terms
from inertial.increments import Increments
from inertial.rest_response import AtRest
from service.physical import Physical

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Material:
    """The stages there are so far: ``windows`` with their ``spans``, and the ``noise`` that was known after each.

    ``alignment`` is the attitude before the first of them.
    """

    physical: Physical
    alignment: Alignment
    windows: Sequence[WindowRecord]
    spans: Sequence[Increments]
    noise: Sequence[Noise]

    def turns_before(self, stage: int) -> list[TurnMeta]:
        """Return the turns described between a stage and the one before it."""
        if stage == 0:
            return []
        return self.physical.turns_between(self.windows[stage - 1].end_s, self.windows[stage].start_s)


@dataclass(frozen=True)
class Findings:
    """What a method found.

    ``stages``: terms after each, in total; the last are the result's. ``order``, ``covariance`` (n, n), ``unseen``
    (n,): errors by name, the six terms first; the unseen are bounded by nothing but belief. ``unobservable`` says so
    in words. ``at_rest`` is for verification on fresh data, ``errors`` for the error budget, ``noise`` what the
    covariance was made with. ``alignment`` is the attitude of the last stage, as the method knows it by then.
    """

    stages: Sequence[Terms]
    order: tuple[str, ...]
    covariance: Array
    unseen: NDArray[np.bool_]
    unobservable: Sequence[Combination]
    at_rest: AtRest
    errors: Errors
    noise: Noise
    alignment: Alignment
    observability: Observability | None = None

    @property
    def terms(self) -> Terms:
        """Return the terms after the last stage."""
        return self.stages[-1]

    @property
    def sigma(self) -> list[float | None]:
        """Return 1σ of the six terms, None where nothing bounds the term."""
        deviation = np.sqrt(np.diag(self.covariance))
        return [None if unseen else float(s) for s, unseen in zip(deviation[:6], self.unseen[:6], strict=True)]
