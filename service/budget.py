"""The navigation error that a result leaves, from the result document alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers.recording_meta import MotionMeta, TurnMeta
from inertial.budget import Errors, Profile, predict
from inertial.documents import Result, Uncertainty
from inertial.earth import Site
from service.errors import RefusedInput
from simulators.motion import Setup, Trajectory, Turn
from simulators.scenarios import vector

REST_S = (60.0, 300.0)
"""Times [s] of the budget that every result carries."""
STEP_S = 0.5


def rest_budget(result: Result) -> dict[str, Any]:
    """Return the budget of a block that goes on standing as it did, at 60 and 300 s."""
    return predicted(result, REST_S)


def predicted(result: Result, at_s: Sequence[float], motion: Sequence[MotionMeta] = ()) -> dict[str, Any]:
    """Predict the navigation error with the result's terms in, navigation beginning as its verification ends.

    Parameters
    ----------
    at_s
        Times asked for since the start [s].
    motion
        What the block does from the start on, as a recording's TOML describes it, about its own centre. Vibration has
        no mean and enters only by what the terms' errors do meanwhile; scale factors and misalignments that a turn
        would show are not in a result.

    Returns
    -------
    dict
        ``profile`` and, by time, 1σ of position [m], velocity [m/s] and attitude [deg] along tangent axes, radial
        50 and 95 %, CEP, and the largest contributors with their shares; null where nothing bounds the error.

    Raises
    ------
    RefusedInput
        A result without the numbers, as of a program before, or times that are none.
    """
    known = result.uncertainty
    if known is None:
        raise RefusedInput("result", "it tells nothing of what it is unsure of.", "Run `inertrim compensate` again.")
    if not at_s or not all(math.isfinite(time) and time > 0 for time in at_s):
        raise RefusedInput("--at", "these are no times after the start.", "Give seconds, as in 60,300.")
    site = Site.at(math.radians(result.site["latitude_deg"]), result.site["height_m"], result.site["gravity_mps2"])
    budget = predict(
        Errors.of_document(known),
        _profile(known, site, max(at_s), motion),
        site,
        known.azimuth_rad,
        result.noise,
        np.array(at_s, dtype=np.float64),
        after_s=result.windows[-1].end_s - known.spans_s[-1][1],
    )
    return {"profile": "motion" if motion else "rest", **budget.summary()}


def _profile(known: Uncertainty, site: Site, duration_s: float, motion: Sequence[MotionMeta]) -> Profile:
    C_tb = np.array(known.C_tb)
    turns = tuple(
        Turn(one.start_s, one.end_s, math.radians(one.rate_dps), vector(one.axis), one.frame)
        for one in motion
        if isinstance(one, TurnMeta)
    )
    if not turns:
        return Profile.rest(C_tb, duration_s, site)
    time_s = np.linspace(0.0, duration_s, max(1, math.ceil(duration_s / STEP_S)) + 1)
    attitude = Trajectory(Setup(site, known.azimuth_rad, C_tb, turns)).attitude(time_s)
    return Profile.on_the_spot(time_s, attitude, site)
