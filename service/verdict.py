"""Is the block fit, and why: every check of a run in one list, and the verdict that follows from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from drivers.samples import SampleArray, Status
from inertial.increments import Increments
from inertial.verification import Verification
from service.methods import Findings

Verdict = Literal["shift compensated", "no significant shift", "not fit"]

SIGNIFICANT_SIGMA = 3.0
"""A term is a shift when it exceeds this many of its σ; six such terms pass by chance in 1.6 % of the runs."""
LOST_SHARE_LIMIT = 0.05
"""More lost frames than this in a window, and what was interpolated counts for too much."""
UNFIT_STATUS = (
    Status.OVERLOAD
    | Status.OUT_OF_RANGE
    | Status.SELF_TEST_FAILED
    | Status.INVALID_ACCEL_X
    | Status.INVALID_ACCEL_Y
    | Status.INVALID_ACCEL_Z
    | Status.INVALID_GYRO_X
    | Status.INVALID_GYRO_Y
    | Status.INVALID_GYRO_Z
)


@dataclass(frozen=True)
class Window:
    """What the checks look at in one window; ``moved`` says how it moved, None where it stood still."""

    span: Increments
    samples: SampleArray
    moved: str | None


@dataclass(frozen=True)
class Judgement:
    """The verdict with its reasons, the ones against first."""

    verdict: Verdict
    reasons: list[str]

    @property
    def fit(self) -> bool:
        """Whether the navigation data are fit."""
        return self.verdict != "not fit"


def judge(windows: Mapping[str, Window], found: Findings, verification: Verification) -> Judgement:
    """Check windows, terms and verification."""
    against = [reason for kind, window in windows.items() for reason in _against(kind, window)]
    if not verification.passed:
        against.append(
            f"verification_failed: navigation at rest on fresh data is off by χ² = {verification.statistic:.1f}, "
            f"where the covariance allows {verification.limit:.1f}"
        )
    if against:
        return Judgement("not fit", against)
    ratios = term_ratios(found)
    proof = (
        f"verified: navigation at rest on fresh data is off by χ² = {verification.statistic:.1f}, "
        f"of {verification.limit:.1f} allowed"
    )
    beyond = [name for name, ratio in ratios.items() if ratio is not None and ratio > SIGNIFICANT_SIGMA]
    if not beyond:
        largest = max((ratio for ratio in ratios.values() if ratio is not None), default=0.0)
        words = f"no term exceeds {SIGNIFICANT_SIGMA:g} of its σ (the largest is {largest:.1f})"
        return Judgement("no significant shift", [f"no_shift: {words}", proof])
    words = ", ".join(f"{name} ({ratios[name]:.1f} σ)" for name in beyond)
    return Judgement("shift compensated", [f"shift: beyond {SIGNIFICANT_SIGMA:g} σ lie {words}", proof])


def term_ratios(found: Findings) -> dict[str, float | None]:
    """Return |term|/σ by sensor; None where nothing bounds the term."""
    terms = np.concatenate([found.terms.f_mps2, found.terms.g_radps])
    names = [f"{kind} {axis}" for kind in ("accelerometer", "gyro") for axis in "xyz"]
    return {
        name: None if sigma is None else abs(float(term)) / sigma
        for name, term, sigma in zip(names, terms, found.sigma, strict=True)
    }


def _against(kind: str, window: Window) -> list[str]:
    """Return what speaks against one window."""
    reasons = []
    if window.moved is not None:
        reasons.append(f"moved_in_{kind}: {window.moved}")
    share = window.span.repaired / len(window.span)
    if share > LOST_SHARE_LIMIT:
        reasons.append(
            f"frames_lost_in_{kind}: {100 * share:.1f} % of the frames are missing "
            f"({100 * LOST_SHARE_LIMIT:g} % may be)"
        )
    status = int(np.bitwise_or.reduce(window.samples["status"])) & UNFIT_STATUS
    if status:
        names = ", ".join(flag.name.lower() for flag in Status if flag.name and flag & status)
        reasons.append(f"status_in_{kind}: the block reported {names}")
    return reasons
