"""What a campaign is: ``SPEC.toml`` read, checked and refused by key name (docs/campaigns.md lists every key)."""

from __future__ import annotations

import difflib
import hashlib
import json
import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError

from drivers.recording_meta import RecordingError, read_toml
from service.campaign.factors import FACTORS, Factor, Level
from service.errors import RefusedInput

PAGE = "docs/campaigns.md lists the keys"


Whole = Annotated[int, Strict()]
Real = Annotated[float, Strict()]
"""Numbers as TOML has them: ``true`` is none."""


class _Section(BaseModel):
    """No unknown keys, no NaN, immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Range(_Section):
    """``{low, high}``: a span that a Latin hypercube covers; ``scale = "log"`` evenly in its logarithm."""

    low: Real
    high: Real
    scale: Literal["linear", "log"] = "linear"


class CampaignSection(_Section):
    """``[campaign]``: which kind of study, how many trials, from which seed, how many to a task."""

    study: Literal["grid", "latin_hypercube", "reanalysis"]
    trials: Whole | None = Field(None, ge=1)
    repeats: Whole = Field(1, ge=1)
    seed: Whole = Field(1, ge=0)
    chunk: Whole = Field(10, ge=1, le=100_000)
    navigate: bool = False


class FleetBlock(_Section):
    """``[[block]]``: one block of a fleet to be re-analysed: its model and its recordings (patterns allowed)."""

    name: str = Field(min_length=1)
    model: Path
    recordings: list[str] = Field(min_length=1)
    together: bool = False


class Subject(_Section):
    """What one trial of a re-analysis looks at."""

    block: str
    model: Path
    recordings: list[Path]


class Campaign(_Section):
    """A whole study; ``subjects`` are what the patterns of ``[[block]]`` have found."""

    campaign: CampaignSection
    vary: dict[str, Real | str | list[Real | str] | Range] = {}
    block: list[FleetBlock] = []
    subjects: list[Subject] = []

    @property
    def points(self) -> int:
        """Return how many different trials the study has before it repeats itself; 0: never."""
        if self.campaign.study == "reanalysis":
            return len(self.subjects)
        if self.campaign.study == "grid":
            return math.prod(len(levels) for levels in self.levels.values())
        return 0

    @property
    def trials(self) -> int:
        """Return how many trials it asks for."""
        return self.campaign.trials or self.points * self.campaign.repeats

    @property
    def levels(self) -> dict[str, list[Level]]:
        """Return the factors that are listed or fixed, each as its list of levels."""
        listed = {name: value for name, value in self.vary.items() if not isinstance(value, Range)}
        return {name: value if isinstance(value, list) else [value] for name, value in listed.items()}

    @property
    def ranges(self) -> dict[str, Range]:
        """Return the factors that span a range."""
        return {name: value for name, value in self.vary.items() if isinstance(value, Range)}

    def with_trials(self, trials: int) -> Campaign:
        """Return the same study with as many trials."""
        return self.model_copy(update={"campaign": self.campaign.model_copy(update={"trials": trials})})

    def text(self) -> str:
        """Return it as canonical JSON: what workers get, and what names the campaign."""
        return json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))

    def digest(self) -> str:
        """Return its content address (hex); how trials are shared out in chunks is part of it."""
        return hashlib.sha256(self.text().encode()).hexdigest()


def read_campaign(path: Path, trials: int | None = None) -> Campaign:
    """Read a specification; ``trials`` in place of its own number.

    Raises
    ------
    RefusedInput
        Names file, key, reason and remedy.
    RecordingError
        The file cannot be read, or is not TOML.
    """
    raw = read_toml(path)
    try:
        spec = Campaign.model_validate(raw)
    except ValidationError as error:
        raise _refused(error, path) from None
    spec = spec if trials is None else spec.with_trials(trials)
    _check_factors(spec, path)
    spec = spec.model_copy(update={"subjects": _subjects(spec, path)})
    _check_counts(spec, path)
    return spec


def _refused(error: ValidationError, path: Path) -> RefusedInput:
    """Say which key is wrong; an unknown one explains a missing one beside it, so it goes first.

    Of what a value could have been, the kind that was looked into deepest is the one that was meant.
    """
    first = min(error.errors(), key=lambda problem: (problem["type"] != "extra_forbidden", -len(problem["loc"])))
    keys = [str(part) for part in first["loc"] if not str(part).startswith(("list[", "float", "str", "Range"))]
    place = f"{path}: {' '.join([f'[{keys[0]}]', *keys[1:]])}"
    if first["type"] == "missing":
        return RefusedInput(place, "is missing.", f"Add it; {PAGE}.")
    if first["type"] == "extra_forbidden":
        near = difflib.get_close_matches(keys[-1], _known(keys), n=1)
        return RefusedInput(place, "no such key.", f"Did you mean {near[0]}?" if near else f"Take it out; {PAGE}.")
    return RefusedInput(place, f"{first['msg']} (got {first.get('input')!r}).", f"Correct it; {PAGE}.")


def _known(keys: list[str]) -> list[str]:
    sections: dict[str, type[BaseModel]] = {"campaign": CampaignSection, "block": FleetBlock, "vary": Range}
    if len(keys) == 1:
        return [name for name in Campaign.model_fields if name != "subjects"]
    return list(sections[keys[0]].model_fields)


def _check_factors(spec: Campaign, path: Path) -> None:
    study = spec.campaign.study
    if spec.subjects:
        raise RefusedInput(f"{path}: [subjects]", "no such key.", "Name the recordings under [[block]].")
    if (study == "reanalysis") != bool(spec.block):
        remedy = "A reanalysis has [[block]] and no [vary]; a Monte Carlo study has [vary] and no [[block]]."
        raise RefusedInput(f"{path}: [campaign] study", f"{study!r} does not fit the other sections.", remedy)
    if study == "reanalysis" and spec.vary:
        raise RefusedInput(f"{path}: [vary]", "means nothing to a reanalysis.", "Take it out.")
    if study == "grid" and spec.ranges:
        name = next(iter(spec.ranges))
        raise RefusedInput(f"{path}: [vary] {name}", "is a range.", 'List levels, or set study = "latin_hypercube".')
    if study == "latin_hypercube" and spec.campaign.trials is None:
        raise RefusedInput(f"{path}: [campaign] trials", "is missing.", "A Latin hypercube needs it, or --trials.")
    for name, value in spec.vary.items():
        _check_factor(name, value, path)


def _check_counts(spec: Campaign, path: Path) -> None:
    """Refuse keys that would change nothing, and a number that would count one analysis twice."""
    study, place = spec.campaign, f"{path}: [campaign]"
    if study.repeats > 1 and study.study != "grid":
        remedy = "Take it out; only a grid is gone through again."
        raise RefusedInput(f"{place} repeats", f"means nothing to a {study.study}.", remedy)
    if study.study != "reanalysis":
        return
    if study.navigate:
        raise RefusedInput(f"{place} navigate", "means nothing to a reanalysis.", "Take it out.")
    if spec.trials > spec.points:
        reason = f"{spec.trials} are more than the {spec.points} analyses that the recordings make."
        raise RefusedInput(f"{place} trials", reason, f"Ask for {spec.points} at most; without it all are made.")


def _check_factor(name: str, value: Any, path: Path) -> None:
    place = f"{path}: [vary] {name}"
    if name not in FACTORS:
        near = difflib.get_close_matches(name, FACTORS, n=1, cutoff=0.4)
        remedy = f"Did you mean {near[0]}?" if near else f"Known: {', '.join(FACTORS)}."
        raise RefusedInput(place, "no such factor.", remedy)
    factor: Factor = FACTORS[name]
    levels = [value.low, value.high] if isinstance(value, Range) else value if isinstance(value, list) else [value]
    if not levels:
        raise RefusedInput(place, "lists nothing.", "Give one level or more.")
    for level in levels:
        if (reason := factor.refusal(level)) is not None:
            raise RefusedInput(place, f"{reason}.", f"Correct it; {PAGE}.")
    if isinstance(value, Range):
        if factor.choices:
            raise RefusedInput(place, "has no range.", f"List some of {', '.join(map(str, factor.choices))}.")
        if value.low >= value.high or (value.scale == "log" and value.low <= 0.0):
            raise RefusedInput(
                place, f"{value.low:g} to {value.high:g} is no such range.", "Give low < high, > 0 for log."
            )


def _subjects(spec: Campaign, path: Path) -> list[Subject]:
    """Return the trials of a re-analysis, in the order of blocks and names."""
    found: list[Subject] = []
    for number, block in enumerate(spec.block, start=1):
        place = f"{path}: [[block]] no. {number}"
        model = path.parent / block.model
        if not model.is_file():
            raise RefusedInput(f"{place} model", f"there is no file {model}.", "Correct the path.")
        files = sorted({file for pattern in block.recordings for file in path.parent.glob(pattern)})
        data = [file.resolve() for file in files if file.suffix in (".parquet", ".csv")]
        if not data:
            raise RefusedInput(
                f"{place} recordings", "no .parquet or .csv matches.", "Correct the patterns; they start at the spec."
            )
        groups = [data] if block.together else [[file] for file in data]
        found += [Subject(block=block.name, model=model.resolve(), recordings=group) for group in groups]
    return found


__all__ = ["Campaign", "Range", "RecordingError", "Subject", "read_campaign"]
