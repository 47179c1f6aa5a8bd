"""What the conditions are judged by: measured values and their limits, gathered by whoever can see them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Facts:
    """One look at the system; None means that a value cannot be told now.

    Times are simulated seconds but for ``wall_jump_s``, the real seconds by which the wall clock has been set since the
    service started. ``terms_share``: the largest final term as a share of what it may be; ``worst_term`` names it.
    ``rate_error``: seconds of the host per second by the block's clock, or by the rate stated for it, less 1, with 1σ
    ``rate_sigma``.
    """

    link: str = "DISCONNECTED"
    age_s: float | None = None
    stale_after_s: float = 0.5
    settled: bool | None = None
    settling_evidence: str = ""
    still: bool | None = None
    temperature_c: float | None = None
    temperature_range_c: tuple[float, float] | None = None
    calibration_age_days: float | None = None
    calibration_age_limit_days: float = 365.0
    terms_share: float | None = None
    worst_term: str = ""
    chi_square: float | None = None
    chi_square_limit: float | None = None
    ready: bool = False
    valid_for_s: float | None = None
    validity_s: float = 1_800.0
    wall_jump_s: float = 0.0
    wall_jump_limit_s: float = 2.0
    disk_free_mb: float | None = None
    disk_limit_mb: float = 200.0
    rate_error: float | None = None
    rate_sigma: float = 0.0
    rate_limit: float = 1e-3
