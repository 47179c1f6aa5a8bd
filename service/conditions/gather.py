"""Gathers what the conditions are judged by: quick things at every look, slow ones by a thread of their own."""

from __future__ import annotations

import math
import os
import threading
import time
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

from inertial.documents import Calibration, Result, parse_document
from service.acquisition import Line
from service.conditions.facts import Facts
from service.config import Settings
from service.monitors import DPH_RADPS, MG_MPS2
from service.sequencer import Judged, LineView

SLOW_EVERY_S = 2.0
RATE_WATCH_S = 20.0
"""Real seconds of frames before their rate is judged: a host that is late by 20 ms then errs by less than the limit."""


class Gatherer:
    """Makes :class:`Facts` of settings, line, sequencer and host.

    Parameters
    ----------
    settings
        Limits, and the calibration whose date and range of temperature count.
    line
        To the block; None without one.
    """

    def __init__(self, settings: Settings, line: Line | None) -> None:
        self._settings, self._line = settings, line
        self._calibration = _calibration(settings.block.calibration)
        self._wall_offset_s = time.time() - time.monotonic()
        self._disk_free_mb: float | None = None
        self._rate: tuple[float, float] | None = None
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._look, name="conditions", daemon=True)

    def start(self) -> None:
        """Begin to look at disk and clocks."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(5.0)

    def facts(self, view: LineView, judged: Judged, result: Result | None) -> Facts:
        """Return the facts of this moment; waits for nothing."""
        limits, calibration = self._settings.conditions, self._calibration
        share, worst = _terms_share(result, limits.accel_term_mg, limits.gyro_term_dph)
        verification = result.verification if result is not None else None
        rate, rate_sigma = self._rate or (None, 0.0)
        return Facts(
            **asdict(judged),
            link=view.state,
            age_s=view.age_s,
            stale_after_s=self._settings.link.stale_after_s,
            temperature_range_c=calibration.temperature_range_c if calibration is not None else None,
            calibration_age_days=_age_days(calibration),
            calibration_age_limit_days=limits.calibration_age_days,
            terms_share=share,
            worst_term=worst,
            chi_square=verification["chi_square"] if verification is not None else None,
            chi_square_limit=verification["limit"] if verification is not None else None,
            validity_s=self._settings.sequence.validity_s,
            wall_jump_s=time.time() - time.monotonic() - self._wall_offset_s,
            wall_jump_limit_s=limits.clock_jump_s,
            disk_free_mb=self._disk_free_mb,
            disk_limit_mb=limits.disk_free_mb,
            rate_error=rate,
            rate_sigma=rate_sigma,
            rate_limit=limits.rate_error,
        )

    def _look(self) -> None:
        while True:
            self._disk_free_mb = _free_mb(self._settings.store.path.parent)
            self._rate = self._rate_error()
            if self._stopping.wait(SLOW_EVERY_S):
                return

    def _rate_error(self) -> tuple[float, float] | None:
        """Return by what fraction frames come slower than stated, with σ; a block without clock has stated no time."""
        if self._line is None:
            return None
        if (wrong := self._line.link.wrong_rate()) is not None:
            return wrong, 0.0
        fit = self._line.link.clock()
        if fit is None or fit.span_s / self._settings.time.speed < RATE_WATCH_S:
            return None
        return (fit.skew, fit.skew_sigma) if math.isfinite(fit.skew + fit.skew_sigma) else None


def _calibration(path: Path | None) -> Calibration | None:
    return None if path is None else parse_document(Calibration, path.read_bytes(), str(path))


def _age_days(calibration: Calibration | None) -> float | None:
    """Return the calibration's age; its date is ISO 8601, and one that is not counts as none."""
    try:
        made = datetime.fromisoformat(calibration.date) if calibration is not None else None
    except ValueError:
        return None
    if made is None:
        return None
    made = made if made.tzinfo is not None else made.replace(tzinfo=UTC)
    return (datetime.now(UTC) - made).total_seconds() / 86_400


def _terms_share(result: Result | None, accel_mg: float, gyro_dph: float) -> tuple[float | None, str]:
    """Return the largest final term as a share of what it may be, and its name."""
    if result is None:
        return None, ""
    final = result.terms["final"]
    shares = [abs(term) / (accel_mg * MG_MPS2) for term in final.f_mps2]
    shares += [abs(term) / (gyro_dph * DPH_RADPS) for term in final.g_radps]
    worst = max(range(6), key=shares.__getitem__)
    return shares[worst], f"{'accelerometer' if worst < 3 else 'gyro'} {'xyz'[worst % 3]}"


def _free_mb(folder: Path) -> float | None:
    try:
        found = os.statvfs(folder)
    except OSError:
        return None
    return found.f_bavail * found.f_frsize / 1e6
