"""``/ageing``: how the blocks of the store drift, when they leave their limit, what shook them."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query
from pydantic import BaseModel

from service.ageing import Limits, ageing_facts
from service.ageing_history import BlockHistory, StoreHistories
from service.api.common import ControllerHere
from service.api.problems import ProblemError, responses
from service.store import Store

router = APIRouter(tags=["ageing"])


class LeavesLimit(BaseModel):
    """When a block leaves its limit: months since calibration, and days; null: beyond the horizon, or no such date."""

    median_months: float | None
    low_months: float | None
    high_months: float | None
    median_date: str | None
    low_date: str | None
    high_date: str | None
    outside_now: float
    beyond_horizon: float
    first_term: dict[str, float]


class AgeingStep(BaseModel):
    """A step between two checks: sudden, and so no drift. Size and 1σ in SI; ``z`` against its ``threshold``."""

    term: str
    after_months: float
    before_months: float
    found_months: float
    after_date: str | None
    before_date: str | None
    size: float
    sigma: float
    z: float
    threshold: float


class Curve(BaseModel):
    """Rows of one term, SI: of ``history`` ``value``, of ``forecast`` ``mean``, each with 1σ."""

    months: list[float]
    value: list[float] | None = None
    mean: list[float] | None = None
    sigma: list[float]


class AgeingTerm(BaseModel):
    """One term of one block: its checks, and where it goes."""

    history: Curve
    forecast: Curve


class AgeingBlock(BaseModel):
    """One block since one calibration. ``since``: whether time counts from that, or from the first check."""

    checks: int
    since: str
    calibrated: str | None
    last_months: float
    last_date: str | None
    attention: list[str]
    leaves_limit: LeavesLimit
    steps: list[AgeingStep]
    terms: dict[str, AgeingTerm] | None = None


class Population(BaseModel):
    """How one term drifts in the whole fleet (docs/ageing.md); SI, ``sigma`` by the same names."""

    unit: str
    blocks: int
    decline: float
    bend: float
    onset: float
    law_months: float
    stray: float
    mean: float
    spread: float
    offset: float
    walk: float
    scatter: float
    relaxation_months: float
    sigma: dict[str, float]


class AgeingLimits(BaseModel):
    """What a term may grow to, as configured and by term in SI."""

    accel_term_mg: float
    gyro_term_dph: float
    by_term: dict[str, float]


class Ageing(BaseModel):
    """The fleet of the store. With ``block`` only that one, with its curves."""

    limits: AgeingLimits
    false_alarms_per_block_year: float
    probability: float
    horizon_months: float
    population: dict[str, Population]
    blocks: dict[str, AgeingBlock]


class Latest:
    """The last analysis, kept until the store has other results or the limits are others."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._histories: StoreHistories | None = None
        self._made: tuple[list[BlockHistory], Limits, dict[str, Any]] | None = None

    def facts(self, store: Store, runs: Path, limits: Limits) -> dict[str, Any]:
        """Return the analysis of what the store holds; whoever asks meanwhile waits for the same."""
        with self._lock:
            if self._histories is None or self._histories.store is not store:
                self._histories = StoreHistories(store, runs)
            blocks = self._histories.read()
            if self._made is None or self._made[0] is not blocks or self._made[1] != limits:
                self._made = blocks, limits, ageing_facts(blocks, limits)
            return self._made[2]


_latest = Latest()


@router.get("/ageing", response_model_exclude_unset=True, responses=responses(404, 422))
def read_ageing(
    controller: ControllerHere,
    block: Annotated[str | None, Query(max_length=200, description="Name of a block: its curves as well.")] = None,
) -> Ageing:
    """Tell how blocks age: drift of the fleet, each block's forecast with its 90 % interval, and steps."""
    settings = controller.settings
    facts = _latest.facts(controller.store, settings.store.runs, Limits.of(settings.conditions))
    if block is not None:
        if block not in facts["blocks"]:
            detail = f"There is no history of a block {block!r}. GET /api/v1/ageing lists them."
            raise ProblemError(404, "unknown-block", detail)
        return Ageing.model_validate({**facts, "blocks": {block: facts["blocks"][block]}})
    bare = {name: {key: value for key, value in one.items() if key != "terms"} for name, one in facts["blocks"].items()}
    return Ageing.model_validate({**facts, "blocks": bare})
