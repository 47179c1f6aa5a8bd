"""``NAME.toml``: what is known about a recording besides its samples. ``docs/recordings.md`` lists every key."""

from __future__ import annotations

import difflib
import itertools
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Band = Annotated[list[float], Field(min_length=2, max_length=2)]

TIME_COLUMN = "time_s"
INCREMENT_COLUMNS = ("dv_x_mps", "dv_y_mps", "dv_z_mps", "dtheta_x_rad", "dtheta_y_rad", "dtheta_z_rad")
WINDOW_KINDS = ("align", "stage_1", "stage_2", "stage_3", "verify")


class RecordingError(ValueError):
    """A recording cannot be used: which file, where in it, why, and what to do."""

    def __init__(self, path: Path | str, place: str, reason: str, remedy: str) -> None:
        self.path, self.place, self.reason, self.remedy = str(path), place, reason, remedy
        where = f"{path}: {place}" if place else f"{path}"
        super().__init__(f"{where}: {reason}. {remedy}.")


class _Section(BaseModel):
    """Common rules: numbers are numbers, none is NaN or infinite, no unknown key, immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class SiteMeta(_Section):
    """``[site]``: where it was recorded; ``gravity_mps2`` where it was surveyed."""

    latitude_deg: float | None = Field(None, ge=-90, le=90)
    height_m: float | None = Field(None, ge=-500, le=20_000)
    gravity_mps2: float | None = Field(None, ge=9.7, le=9.9)


class ReferenceMeta(_Section):
    """``[reference]``: how the block stood at t = 0, from outside; no roll and pitch: it levels itself.

    ``alignment``: how it then finds its attitude: by averaging at rest, or in an inertial frame while it sways.
    """

    azimuth_deg: float | None = Field(None, ge=-360, le=360)
    azimuth_sigma_deg: float | None = Field(None, ge=0, le=360)
    roll_deg: float | None = Field(None, ge=-180, le=180)
    pitch_deg: float | None = Field(None, ge=-90, le=90)
    heading_deg: float = Field(0.0, ge=-360, le=360)
    level_sigma_deg: float | None = Field(None, ge=0, le=90)
    level_frame: Literal["tangent", "body"] = "tangent"
    alignment: Literal["rest", "inertial"] = "rest"

    @model_validator(mode="after")
    def _level_is_whole(self) -> Self:
        if (self.roll_deg is None) != (self.pitch_deg is None):
            raise ValueError("roll_deg and pitch_deg stand together: give both, or neither and it levels itself")
        if self.level_sigma_deg is not None and self.roll_deg is None:
            raise ValueError("level_sigma_deg is the sigma of roll_deg and pitch_deg: give these too, or none")
        if self.azimuth_sigma_deg is not None and self.azimuth_deg is None:
            raise ValueError("azimuth_sigma_deg is the sigma of azimuth_deg: give this too, or neither")
        return self

    @property
    def level_given(self) -> bool:
        """Whether an outside level was given."""
        return self.roll_deg is not None


class BlockMeta(_Section):
    """``[block]``: what recorded it; ``model`` and ``calibration`` are paths relative to the TOML's folder."""

    sample_rate_hz: float = Field(gt=0, le=100_000)
    model: str | None = None
    calibration: str | None = None
    gyro_kind: Literal["dtg", "laser", "fibre", "mems"] | None = None


class _Span(_Section):
    """A span of device time [s], start included, end not."""

    start_s: float
    end_s: float

    @model_validator(mode="after")
    def _runs_forward(self) -> Self:
        if not self.end_s > self.start_s:
            raise ValueError(f"end_s ({self.end_s:g}) must come after start_s ({self.start_s:g})")
        return self


class RestMeta(_Span):
    """The block stands still."""

    kind: Literal["rest"]


class TurnMeta(_Span):
    """The block turns right-handed about ``axis`` at ``rate_dps`` [deg/s].

    ``frame`` "body": an inner axis, which turns with the block; "tangent": an outer axis, fixed in the room.
    """

    kind: Literal["turn"]
    rate_dps: float
    axis: Vector3
    frame: Literal["body", "tangent"]
    angle_sigma_deg: float | None = Field(None, ge=0)

    @model_validator(mode="after")
    def _axis_points_somewhere(self) -> Self:
        if not any(self.axis):
            raise ValueError("axis has no length")
        return self


class VibrationMeta(_Span):
    """The block is shaken along ``axis`` (body) by ``grms`` [g] of random vibration in ``band_hz``."""

    kind: Literal["vibration"]
    axis: Vector3
    grms: float = Field(ge=0)
    band_hz: Band

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if not any(self.axis):
            raise ValueError("axis has no length")
        if not 0 <= self.band_hz[0] < self.band_hz[1]:
            raise ValueError("band_hz is [low, high] with 0 <= low < high")
        return self


MotionMeta = Annotated[RestMeta | TurnMeta | VibrationMeta, Field(discriminator="kind")]


class WindowMeta(_Span):
    """What a live run used for one step, so that a replay repeats it."""

    kind: Literal["align", "stage_1", "stage_2", "stage_3", "verify"]


class ColumnMeta(_Section):
    """``[columns]``: a column of another maker's log becomes ours as ``(raw - offset) * scale``.

    With ``per_second`` the result is a rate and is multiplied by each sample's own interval.
    """

    to: str
    scale: float = 1.0
    offset: float = 0.0
    per_second: bool = False

    @model_validator(mode="after")
    def _target_exists(self) -> Self:
        if not is_known_column(self.to):
            hint = name_hint(self.to, [TIME_COLUMN, *INCREMENT_COLUMNS])
            raise ValueError(f'to = "{self.to}" is no column of a recording; {hint}')
        if self.per_second and self.to not in INCREMENT_COLUMNS:
            raise ValueError(f"per_second makes increments from rates; {self.to} is no increment")
        return self


class RecordingMeta(_Section):
    """The whole of ``NAME.toml``."""

    site: SiteMeta
    reference: ReferenceMeta = ReferenceMeta()
    block: BlockMeta
    motion: list[MotionMeta] = []
    window: list[WindowMeta] = []
    columns: dict[str, ColumnMeta] = {}

    @model_validator(mode="after")
    def _spans_follow(self) -> Self:
        check_motions(self.motion)
        kinds = [window.kind for window in self.window]
        if kinds != sorted(set(kinds), key=WINDOW_KINDS.index):
            raise ValueError(f"[[window]]: kinds stand once each, in the order {', '.join(WINDOW_KINDS)}")
        _check_order("window", self.window)
        targets = [column.to for column in self.columns.values()]
        if twice := {target for target in targets if targets.count(target) > 1}:
            raise ValueError(f"[columns]: two columns become {min(twice)}")
        return self


def check_motions(motions: list[MotionMeta]) -> None:
    """Raise ``ValueError`` where motions overlap or are not in time order."""
    _check_order("motion", motions)


def _check_order(section: str, spans: list[Any]) -> None:
    """Raise ``ValueError`` where a span begins before the one ahead of it has ended."""
    for number, (before, after) in enumerate(itertools.pairwise(spans), start=2):
        if after.start_s < before.end_s:
            raise ValueError(
                f"[[{section}]] no. {number} begins at {after.start_s:g} s, "
                f"before no. {number - 1} ends at {before.end_s:g} s"
            )


def is_known_column(name: str) -> bool:
    """Return whether a recording has a column of this name."""
    if name in (TIME_COLUMN, *INCREMENT_COLUMNS, "temperature_c", "supply_v", "sequence", "status"):
        return True
    return temperature_index(name) is not None


def temperature_index(name: str) -> int | None:
    """Return which temperature sensor a column holds (``temperature_c`` is 0, ``temperature_1_c`` 1), or None."""
    if name == "temperature_c":
        return 0
    number = name.removeprefix("temperature_").removesuffix("_c")
    known = number.isdecimal() and number == str(int(number)) and int(number) > 0 and name == f"temperature_{number}_c"
    return int(number) if known else None


def likely_meant(name: str, known: list[str]) -> str | None:
    """Return the known name that a wrong one probably stands for: the same quantity in another unit, or a slip."""
    stem = name.rpartition("_")[0]
    same_quantity = [other for other in known if stem and other.rpartition("_")[0] == stem]
    return next(iter(same_quantity or difflib.get_close_matches(name, known, n=1)), None)


def name_hint(name: str, known: list[str]) -> str:
    """Return which known name was probably meant, and the choice."""
    meant = likely_meant(name, known)
    return f"{f'{meant} is probably meant; ' if meant else ''}known are {', '.join(known)}"


def read_meta(path: Path) -> RecordingMeta:
    """Read ``NAME.toml``.

    Raises
    ------
    RecordingError
        No such file, not TOML, an unknown key (a wrong unit shows as one), or a value out of range.
    """
    return validate_meta(RecordingMeta, read_toml(path), path)


def meta_text(meta: RecordingMeta) -> str:
    """Return ``NAME.toml`` for data in our own columns; motions and windows can be added to by hand."""
    document = meta.model_dump(exclude_none=True, exclude={"columns"})
    parts = []
    for section, content in document.items():
        rows = content if isinstance(content, list) else [content]
        head = f"[[{section}]]" if isinstance(content, list) else f"[{section}]"
        parts += [f"{head}\n{tomli_w.dumps(row)}" for row in rows]
    return "\n".join(parts)


def read_toml(path: Path) -> dict[str, Any]:
    """Read any TOML file, with the errors of a recording."""
    try:
        return tomllib.loads(path.read_bytes().decode())
    except OSError as error:
        reason = f"cannot be read: {error.strerror}"
        raise RecordingError(path, "", reason, "Give an existing file that may be read") from None
    except UnicodeDecodeError as error:
        raise RecordingError(path, f"byte {error.start}", "is not UTF-8 text", "Save the file as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise RecordingError(path, "", f"is not TOML: {error}", "Mend that place; see docs/recordings.md") from None


AnySection = TypeVar("AnySection", bound=BaseModel)


def validate_meta(kind: type[AnySection], raw: dict[str, Any], path: Path) -> AnySection:
    """Return ``raw`` as the model ``kind``.

    Raises
    ------
    RecordingError
        Names the first key that is wrong, and what to do.
    """
    try:
        return kind.model_validate(raw)
    except ValidationError as error:
        raise _meta_error(error, path) from None


def _meta_error(error: ValidationError, path: Path) -> RecordingError:
    """Say where the first problem stands, what it is and what to do."""
    # An unknown key explains the missing one beside it, so it goes first.
    first = min(error.errors(), key=lambda problem: problem["type"] != "extra_forbidden")
    place = _place(first["loc"])
    reason = first["msg"].removeprefix("Value error, ")
    remedy = "See docs/recordings.md for the keys and their units"
    if first["type"] == "missing":
        reason, remedy = "is missing", "Add it; docs/recordings.md says what it means and its unit"
    elif first["type"] == "extra_forbidden":
        reason = "no such key"
        remedy = f"Units are part of names: {name_hint(str(first['loc'][-1]), _known_keys(first['loc']))}"
    elif not isinstance(first.get("input"), dict):
        reason = f"{reason} (got {first.get('input')!r})"
    return RecordingError(path, place, reason, remedy)


def _place(location: tuple[int | str, ...]) -> str:
    """Return a place as a reader of the TOML names it: ``[[motion]] no. 2 rate_dps``."""
    words = []
    for depth, part in enumerate(location):
        if isinstance(part, int):
            words.append(f"no. {part + 1}")
        elif depth == 0:
            repeated = len(location) > 1 and isinstance(location[1], int)
            words.append(f"[[{part}]]" if repeated else f"[{part}]" if part in RecordingMeta.model_fields else part)
        elif not (depth == 2 and location[0] == "motion"):  # there the model names the kind, which is no key
            words.append(part)
    return " ".join(words)


def _known_keys(location: tuple[int | str, ...]) -> list[str]:
    """Return the keys that could stand where an unknown one stands."""
    sections: dict[int | str, type[BaseModel]] = {
        "site": SiteMeta,
        "reference": ReferenceMeta,
        "block": BlockMeta,
        "rest": RestMeta,
        "turn": TurnMeta,
        "vibration": VibrationMeta,
        "window": WindowMeta,
        "columns": ColumnMeta,
    }
    for part in reversed(location[:-1]):
        if part in sections:
            return list(sections[part].model_fields)
    return list(RecordingMeta.model_fields)
