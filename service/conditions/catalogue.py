"""The conditions: what each measures, its limit, how long it must be broken, what causes it, what mends it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from service.conditions.facts import Facts

Severity = Literal["critical", "warning"]
"""Critical: not fit, whatever anybody says. Warning: not fit until somebody takes it on himself by name."""


@dataclass(frozen=True)
class Measure:
    """One value against its limit. ``holds`` None: it cannot be told now."""

    holds: bool | None
    measured: float | str | None
    limit: float | str | None
    unit: str
    text: str


@dataclass(frozen=True)
class Definition:
    """One condition; ``persistence_s`` [simulated s]: how long it must be broken, or whole again, to count."""

    name: str
    title: str
    severity: Severity
    persistence_s: float
    cause: str
    remedy: str
    measure: Callable[[Facts], Measure]


def _frames_fresh(facts: Facts) -> Measure:
    holds = facts.link == "STREAMING"
    text = f"the line is {facts.link}"
    if facts.age_s is not None:
        text += f", the newest frame is {facts.age_s:.2f} s old"
    return Measure(holds, facts.age_s, facts.stale_after_s, "s", text)


def _settled(facts: Facts) -> Measure:
    words = {None: "not judged yet", True: "settled", False: "not settled"}[facts.settled]
    text = f"{words}: {facts.settling_evidence}" if facts.settling_evidence else words
    return Measure(facts.settled, words, "settled", "", text)


def _still(facts: Facts) -> Measure:
    words = {None: "no frames to judge by", True: "still", False: "moving"}[facts.still]
    return Measure(facts.still, words, "still", "", f"the block is {words}" if facts.still is not None else words)


def _temperature(facts: Facts) -> Measure:
    measured, limits = facts.temperature_c, facts.temperature_range_c
    if limits is None:
        return Measure(None, measured, None, "°C", "the calibration states no range of temperature")
    words = f"{limits[0]:g} … {limits[1]:g}"
    if measured is None:
        return Measure(None, None, words, "°C", "no temperature is measured")
    holds = limits[0] <= measured <= limits[1]
    return Measure(holds, measured, words, "°C", f"{measured:.1f} °C, calibrated for {words} °C")


def _calibration_age(facts: Facts) -> Measure:
    age, limit = facts.calibration_age_days, facts.calibration_age_limit_days
    if age is None:
        return Measure(None, None, limit, "d", "the calibration states no date")
    return Measure(0 <= age <= limit, round(age, 1), limit, "d", f"{age:.0f} days old, of {limit:g} allowed")


def _terms_expected(facts: Facts) -> Measure:
    share = facts.terms_share
    if share is None:
        return Measure(None, None, 1.0, "", "no terms yet")
    text = f"the largest, {facts.worst_term}, is {share:.2f} of what ageing explains"
    return Measure(share <= 1, round(share, 3), 1.0, "", text)


def _verification(facts: Facts) -> Measure:
    value, limit = facts.chi_square, facts.chi_square_limit
    if value is None or limit is None:
        return Measure(None, None, limit, "χ²", "not verified yet")
    text = f"χ² = {value:.1f} on fresh data, of {limit:.1f} allowed"
    return Measure(value <= limit, round(value, 2), round(limit, 2), "χ²", text)


def _validity(facts: Facts) -> Measure:
    left = facts.valid_for_s
    if left is None:
        return Measure(None, None, facts.validity_s, "s", "no result that could run out")
    holds = left > 0 and facts.ready
    text = f"valid for {left:.0f} s more" if holds else "what was vouched for no longer is"
    return Measure(holds, round(left, 1) if holds else 0.0, 0.0, "s", text)


def _clock(facts: Facts) -> Measure:
    jump, limit = facts.wall_jump_s, facts.wall_jump_limit_s
    text = f"the wall clock was set by {jump:+.2f} s since the service started"
    return Measure(abs(jump) <= limit, round(jump, 3), limit, "s", text)


def _disk_space(facts: Facts) -> Measure:
    free, limit = facts.disk_free_mb, facts.disk_limit_mb
    if free is None:
        return Measure(None, None, limit, "MB", "the disk cannot be asked")
    return Measure(free >= limit, round(free), limit, "MB", f"{free:.0f} MB are free, {limit:g} are needed")


def _rate(facts: Facts) -> Measure:
    error, limit = facts.rate_error, facts.rate_limit
    if error is None:
        return Measure(None, None, limit, "", "not watched for long enough")
    text = f"frames come off their stated rate by {-error:+.1e} ± {facts.rate_sigma:.0e}, of {limit:g} allowed"
    return Measure(abs(error) - 3 * facts.rate_sigma <= limit, error, limit, "", text)


CATALOGUE = (
    Definition(
        *("frames_fresh", "Frames are fresh", "critical", 0.0),
        "Line unplugged, block without power, wrong bit rate, or a host too busy to read.",
        "Check cable and power; `inertrim detect` tells what is on the line.",
        _frames_fresh,
    ),
    Definition(
        *("settled", "Settled", "critical", 0.0),
        "The block has not warmed up, or has warmed or cooled since its result.",
        "Wait; keep sun and wind off it. After READY, begin a new run.",
        _settled,
    ),
    Definition(
        *("still", "The block stands still", "critical", 0.0),
        "Wind, people or machinery move the launcher.",
        'Find out what moves it; a launcher that sways can align with "alignment": "inertial".',
        _still,
    ),
    Definition(
        *("temperature_in_range", "Temperature within the calibration", "warning", 5.0),
        "It is colder or hotter than the laboratory calibrated for.",
        "Heat or shade the block, or acknowledge knowing that scale factors are extrapolated.",
        _temperature,
    ),
    Definition(
        *("calibration_age", "Calibration is recent", "warning", 0.0),
        "The laboratory calibration is older than its term, or dated in the future.",
        "Have the block calibrated again; check the host's date.",
        _calibration_age,
    ),
    Definition(
        *("terms_expected", "Terms within expected ageing", "warning", 0.0),
        "The block changed by more than storage explains: shock, damage, or a wrong calibration file.",
        "Check that the calibration belongs to this block; have the block examined.",
        _terms_expected,
    ),
    Definition(
        *("verification", "Verified on fresh data", "critical", 0.0),
        "Navigation with the terms errs by more than its covariance predicts.",
        "Check reference and site, let nothing touch the launcher, acknowledge the fault and run again.",
        _verification,
    ),
    Definition(
        *("validity", "Result is valid", "critical", 0.0),
        "Its time ran out, or what happened since has made it void.",
        "Begin a new run.",
        _validity,
    ),
    Definition(
        *("clock", "Host clock is steady", "warning", 0.0),
        "The host's wall clock was set while the service ran; times in the records jump.",
        "See to time synchronisation, and restart the service.",
        _clock,
    ),
    Definition(
        *("disk_space", "Disk has room", "warning", 0.0),
        "The disk that holds store and recordings fills up.",
        "Move old runs away.",
        _disk_space,
    ),
    Definition(
        *("sample_rate", "Sample rate is as stated", "warning", 10.0),
        "The block's clock is wrong, or its rate is not what it says.",
        "Set [block] or the protocol's rate right; have the block's clock checked.",
        _rate,
    ),
)
