"""The three documents that outlive a run: block model, calibration, result.

Plain data with a schema version. Reading and writing files belongs to the rooms above; a newer or damaged document
is refused by name there through :func:`parse_document`.
"""

from __future__ import annotations

import hashlib
import json
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
AccelName = Literal["accel_x", "accel_y", "accel_z"]
GyroName = Literal["gyro_x", "gyro_y", "gyro_z"]
CHANNELS = ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z")


class DocumentError(ValueError):
    """A document is damaged, newer than this program, or of another kind; the text says which, where and what to do."""


class Document(BaseModel):
    """Common rules: no unknown keys, no NaN or infinity, immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True)

    def canonical_json(self) -> str:
        """Return the text whose SHA-256 names this document: keys sorted, two-space indent, newline at the end."""
        return json.dumps(self.model_dump(mode="json", by_alias=True), sort_keys=True, indent=2, allow_nan=False) + "\n"

    def sha256(self) -> str:
        """Return the content address (hex)."""
        return hashlib.sha256(self.canonical_json().encode()).hexdigest()


class AccelCoefficients(Document):
    """Eq. (1) for one accelerometer: true [m/s²] from readings [m/s²]."""

    scale_positive: float = 1.0
    scale_negative: float = 1.0
    bias_mps2: float = 0.0
    misalignment_positive: dict[AccelName, float] = {}
    misalignment_negative: dict[AccelName, float] = {}


class GyroCoefficients(Document):
    """Eq. (2) for one gyro: true [rad/s] from readings [rad/s; m/s² for the g-sensitivity]."""

    scale_positive: float = 1.0
    scale_negative: float = 1.0
    bias_radps: float = 0.0
    misalignment_positive: dict[GyroName, float] = {}
    misalignment_negative: dict[GyroName, float] = {}
    g_sensitivity_radps_per_mps2: dict[AccelName, float] = {}


class ChannelCoefficients(Document):
    """Eqs (1), (2) by channel. The default is the ideal block: reading = truth."""

    accel_x: AccelCoefficients = AccelCoefficients()
    accel_y: AccelCoefficients = AccelCoefficients()
    accel_z: AccelCoefficients = AccelCoefficients()
    gyro_x: GyroCoefficients = GyroCoefficients()
    gyro_y: GyroCoefficients = GyroCoefficients()
    gyro_z: GyroCoefficients = GyroCoefficients()


class Calibration(Document):
    """``calibration.json``: the laboratory's coefficients with their covariance and origin."""

    schema_: Literal["inertrim/calibration/1"] = Field("inertrim/calibration/1", alias="schema")
    block: str = ""
    date: str = ""
    method: str = ""
    table_run: str = ""
    temperature_range_c: tuple[float, float] | None = None
    coefficients: ChannelCoefficients = ChannelCoefficients()
    order: list[str] = []
    covariance: list[list[float]] = []


class ChannelNoise(Document):
    """Noise of one channel (IEEE 952 terms), SI with y = m/s² for accelerometers and rad/s for gyros.

    ``white`` [y/√Hz] is velocity or angle random walk, ``flicker`` [y] bias instability (the Allan floor divided by
    0.664), ``random_walk`` [y/√s] rate random walk, ``quantisation`` [y·s] the step of the increments.
    """

    white: float = Field(0.0, ge=0)
    flicker: float = Field(0.0, ge=0)
    random_walk: float = Field(0.0, ge=0)
    quantisation: float = Field(0.0, ge=0)


class Noise(Document):
    """Noise of all channels; ``free``: its size is not a belief but to be found from each recording."""

    accel_x: ChannelNoise = ChannelNoise()
    accel_y: ChannelNoise = ChannelNoise()
    accel_z: ChannelNoise = ChannelNoise()
    gyro_x: ChannelNoise = ChannelNoise()
    gyro_y: ChannelNoise = ChannelNoise()
    gyro_z: ChannelNoise = ChannelNoise()
    free: bool = False


class ParameterValue(Document):
    """One number of an effect with its 1σ and unit."""

    value: float
    sigma: float | None = None
    unit: str = ""


class EffectEntry(Document):
    """One named effect of a block model (names and channels: docs/recordings.md and ``simulators/effects/``)."""

    effect: str
    channel: str
    parameters: dict[str, ParameterValue] = {}
    sigma: float | None = None
    evidence: dict[str, Any] = {}


class BlockModel(Document):
    """``block.json``: what the simulator believes of one block. Content-addressed; a child names its parent's hash."""

    schema_: Literal["inertrim/block/1"] = Field("inertrim/block/1", alias="schema")
    parent: str | None = None
    block: str = ""
    gyro_kind: Literal["dtg", "laser", "fibre", "mems"] = "dtg"
    calibration: ChannelCoefficients = ChannelCoefficients()
    noise: Noise = Noise()
    effects: list[EffectEntry] = []


class StageTerms(Document):
    """Additive terms of (8), (9), total and not increment, body axes: what is added to the reading."""

    f_mps2: Vector3
    g_radps: Vector3


class Sigma(Document):
    """1σ of the final terms; null where nothing bounds the term."""

    f_mps2: list[float | None]
    g_radps: list[float | None]


class Combination(Document):
    """A combination of unknowns that the run could not see, as weights by name and in words."""

    combination: dict[str, float]
    text: str


class Uncertainty(Document):
    """What a navigation that starts with a result is unsure of: all that an error budget needs.

    ``order`` names the errors (estimated less true, SI): the six terms, ``level_1 level_2 azimuth`` and turns.
    ``sources``: their covariance by independent cause, sensor noise apart. ``unbounded``: combinations, weights by
    name, that nothing bounds. ``attitude_slope`` (3, n) makes the attitude error in tangent axes. ``gain``: error by
    channel and name, for each of ``spans_s``, per unit of the channel's noise integrated over the span; later noise
    hangs together with it. ``C_tb``, ``azimuth_rad``: where the block stands.
    """

    order: list[str]
    sources: dict[str, list[list[float]]]
    unbounded: list[dict[str, float]]
    attitude_slope: list[list[float]]
    spans_s: list[tuple[float, float]]
    gain: dict[str, dict[str, list[float]]]
    C_tb: list[Vector3]
    azimuth_rad: float


class Observability(Document):
    """How well the run sees its unknowns, in ``order`` of the result.

    ``singular_values`` of the whitened problem (unknowns in units of gravity, Earth rate and rad): the smallest belong
    to what is hardly seen. ``correlation`` of the errors. ``fit``: reduced χ² of each sensor about rest, near 1 where
    the noise is what was said.
    """

    singular_values: list[float]
    correlation: list[list[float]]
    fit: list[float]


class WindowRecord(Document):
    """Half-open span of device time [s] that one step used."""

    kind: Literal["align", "stage_1", "stage_2", "stage_3", "verify"]
    start_s: float
    end_s: float


class Result(Document):
    """``result.json``: what a run found, how sure it is, and whether the navigation data are fit."""

    schema_: Literal["inertrim/result/1"] = Field("inertrim/result/1", alias="schema")
    software: str
    method: Literal["paper", "optimal"]
    state: str
    verdict: Literal["shift compensated", "no significant shift", "not fit"]
    fit: bool
    reasons: list[str]
    windows: list[WindowRecord]
    terms: dict[Literal["stage_1", "stage_2", "stage_3", "final"], StageTerms]
    sigma: Sigma
    order: list[str]
    covariance: list[list[float | None]]
    unobservable: list[Combination]
    observability: Observability | None = None
    uncertainty: Uncertainty | None = None
    budget: dict[str, Any] | None = None
    noise: Noise
    reference: dict[str, Any]
    site: dict[str, float]
    alignment: dict[str, Any]
    verification: dict[str, Any] | None
    conditions: dict[str, Any]
    block: dict[str, Any]
    inputs: dict[str, str]


AnyDocument = TypeVar("AnyDocument", bound=Document)


def parse_document(kind: type[AnyDocument], text: str | bytes, name: str) -> AnyDocument:
    """Parse one document.

    Raises
    ------
    DocumentError
        With ``name``, the place in the document and the remedy.
    """
    try:
        raw = json.loads(text)
    except ValueError as error:
        raise DocumentError(f"{name}: not JSON: {error}. Restore the file; it may be cut or edited.") from None
    if not isinstance(raw, dict):
        raise DocumentError(f"{name}: a {kind.__name__} document is a JSON object, this is {type(raw).__name__}.")
    expected = kind.model_fields["schema_"].default if "schema_" in kind.model_fields else None
    found = raw.get("schema")
    if expected is not None and found != expected:
        family, _, version = str(found).rpartition("/")
        wanted, _, known = expected.rpartition("/")
        if family == wanted and version.isdigit() and int(version) > int(known):
            raise DocumentError(f"{name}: schema {found} is newer than this program's {expected}. Update inertrim.")
        raise DocumentError(f"{name}: schema is {found!r}, expected {expected!r}. Give a {kind.__name__} document.")
    try:
        return kind.model_validate(raw)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise DocumentError(f"{name}: {place}: {first['msg']} (got {first.get('input')!r}).") from None
