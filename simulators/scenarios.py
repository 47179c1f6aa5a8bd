"""What is to be simulated: a recording's own TOML, with sections of its own for what a recording cannot know.

``[site] [reference] [block] [[motion]]`` say what is believed, as in a recording. Added are::

    [scenario]   duration_s, seed, start_c, end_c, time_constant_s   (of the temperature)
    [[effect]]   effect, channel, parameters = {name = {value = 2.4, unit = "deg/h"}}
                 what has happened to the block and its set-up since the laboratory
    [[fault]]    kind, at_s (since streaming began), and by kind: duration_s, probability, channel, rate_dps, axis,
                 change_c, time_constant_s

Only numbers stand here, none of them drawn, so that the file says all that is true; :func:`demo_scenario` draws.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tomli_w
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from drivers.recording_meta import (
    BlockMeta,
    MotionMeta,
    RecordingMeta,
    ReferenceMeta,
    RestMeta,
    SiteMeta,
    TurnMeta,
    Vector3,
    VibrationMeta,
    read_toml,
    validate_meta,
)
from inertial.attitude import body_to_tangent
from inertial.documents import BlockModel, ChannelCoefficients, ChannelNoise, EffectEntry, Noise, ParameterValue
from inertial.earth import STANDARD_GRAVITY_MPS2, Site
from inertial.error_model import Coefficients, Terms
from simulators.block import SimulatedBlock, Thermal
from simulators.effects import get_effect
from simulators.effects.base import values_of
from simulators.errors import ScenarioError
from simulators.motion import Array, Motion, Setup, Turn, Vector, Vibration
from simulators.noise import generator

DEG = math.pi / 180.0
DEG_PER_H = DEG / 3600.0
MG = 1e-3 * STANDARD_GRAVITY_MPS2


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class ScenarioMeta(_Section):
    """``[scenario]``: how long, which noise, how warm."""

    duration_s: float | None = Field(None, gt=0)
    """Of a recording; none: to the end of the last motion. A block on a line streams on."""
    seed: int = Field(0, ge=0)
    start_c: float = Field(25.0, ge=-100, le=150)
    end_c: float = Field(25.0, ge=-100, le=150)
    time_constant_s: float = Field(60.0, gt=0)


class _FaultMeta(_Section):
    at_s: float | None = Field(None, ge=0)
    """Simulated seconds since streaming began; none: at once."""


class NoisyLine(_FaultMeta):
    """Bytes go wrong: each frame with this probability, from ``at_s`` on, for ``duration_s`` or to the end.

    ``bit_flips``: one bit of the frame is inverted; ``cuts``: the frame ends early; ``garbage``: a burst of random
    bytes before it; ``false_headers``: the head of a frame before it, that promises a body which does not come.
    """

    kind: Literal["bit_flips", "cuts", "garbage", "false_headers"]
    probability: float = Field(ge=0, le=1)
    duration_s: float | None = Field(None, gt=0)


class Unplug(_FaultMeta):
    """The line is pulled: its device disappears, what is sent meanwhile is lost, and it comes back as a new one."""

    kind: Literal["unplug"]
    duration_s: float = Field(gt=0)


class StuckSensor(_FaultMeta):
    """One sensor repeats its last value; no status bit tells, a self-test does."""

    kind: Literal["stuck_sensor"]
    channel: Literal["accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z"]
    duration_s: float = Field(gt=0)


class Restart(_FaultMeta):
    """The block loses its supply for a moment; it wakes idle, clock and sequence at zero, its written terms kept."""

    kind: Literal["restart"]


class Move(_FaultMeta):
    """Somebody turns the block."""

    kind: Literal["move"]
    duration_s: float = Field(gt=0)
    rate_dps: float
    axis: Vector3 = [0.0, 0.0, 1.0]


class Heat(_FaultMeta):
    """The surroundings warm (or cool) the block, exponentially, until it is switched off."""

    kind: Literal["heat"]
    change_c: float = Field(ge=-60, le=60)
    time_constant_s: float = Field(60.0, gt=0)


Fault = NoisyLine | Unplug | StuckSensor | Restart | Move | Heat
FaultMeta = Annotated[Fault, Field(discriminator="kind")]
FAULT: TypeAdapter[Fault] = TypeAdapter(FaultMeta)
"""Reads one fault from plain data, e.g. ``FAULT.validate_python({"kind": "unplug", "duration_s": 3.0})``."""


class Scenario(RecordingMeta):
    """All that is to be simulated but the block's own model."""

    scenario: ScenarioMeta = ScenarioMeta()
    effect: list[EffectEntry] = Field(default=[])
    fault: list[FaultMeta] = Field(default=[])

    @property
    def duration_s(self) -> float:
        """How long a recording lasts [s]; 300 where nothing says."""
        if self.scenario.duration_s is not None:
            return self.scenario.duration_s
        return max((motion.end_s for motion in self.motion), default=300.0)

    def recording_meta(self) -> RecordingMeta:
        """Return what a recording of this may know."""
        return RecordingMeta(site=self.site, reference=self.reference, block=self.block, motion=self.motion)

    def with_seed(self, seed: int) -> Scenario:
        """Return the same block in the same circumstances with other noise."""
        return self.model_copy(update={"scenario": self.scenario.model_copy(update={"seed": seed})})

    def with_motion(self, motion: list[MotionMeta], duration_s: float) -> Scenario:
        """Return the same block doing something else, for as long."""
        scenario = self.scenario.model_copy(update={"duration_s": duration_s})
        return self.model_copy(update={"scenario": scenario, "motion": motion})

    def warmed_up(self) -> Scenario:
        """Return the same block switched on long ago: at its end temperature and past its turn-on transients."""
        scenario = self.scenario.model_copy(update={"start_c": self.scenario.end_c})
        effect = [entry for entry in self.effect if entry.effect != "turn_on_transient"]
        return self.model_copy(update={"scenario": scenario, "effect": effect})


def read_scenario(path: Path) -> Scenario:
    """Read a scenario, or a recording's TOML as one.

    Raises
    ------
    RecordingError
        Not readable, not TOML, a key that is unknown or out of range; effects are checked when a block is made.
    """
    scenario: Scenario = validate_meta(Scenario, read_toml(path), path)
    return scenario


def write_scenario(scenario: Scenario, path: Path) -> Path:
    """Write a scenario as TOML; reading it back gives the same."""
    document = scenario.model_dump(mode="json", exclude_none=True)
    path.write_text(tomli_w.dumps({section: content for section, content in document.items() if content}))
    return path


def believed_setup(scenario: Scenario) -> Setup:
    """Return how the block is believed to stand and move. What the reference does not give is taken as zero.

    Raises
    ------
    ScenarioError
        No latitude: Earth rate is then unknown.
    """
    site, reference = scenario.site, scenario.reference
    if site.latitude_deg is None:
        raise ScenarioError("[site] latitude_deg is missing; a simulation needs it for the Earth's rate. Add it")
    attitude = (reference.roll_deg or 0.0, reference.pitch_deg or 0.0, reference.heading_deg)
    return Setup(
        Site.at(site.latitude_deg * DEG, site.height_m or 0.0, site.gravity_mps2),
        (reference.azimuth_deg or 0.0) * DEG,
        body_to_tangent(*(angle * DEG for angle in attitude)),
        tuple(motion for meta in scenario.motion if (motion := _motion(meta)) is not None),
    )


def _motion(meta: RestMeta | TurnMeta | VibrationMeta) -> Motion | None:
    match meta:
        case TurnMeta():
            return Turn(meta.start_s, meta.end_s, meta.rate_dps * DEG, vector(meta.axis), meta.frame)
        case VibrationMeta():
            rms_mps2 = meta.grms * STANDARD_GRAVITY_MPS2
            return Vibration(meta.start_s, meta.end_s, vector(meta.axis), rms_mps2, (meta.band_hz[0], meta.band_hz[1]))
        case RestMeta():
            return None


def vector(values: Sequence[float]) -> Vector:
    """Return three numbers as a tuple."""
    x, y, z = values
    return (x, y, z)


def make_block(
    scenario: Scenario, model: BlockModel, *, power_cycle: int = 0, epoch_s: float = 0.0, setup: Setup | None = None
) -> SimulatedBlock:
    """Return the scenario's block at a power-up; after the first, ``setup`` says what has moved since.

    Its motions, its effects and those of its timed faults that befall the block itself are in.

    Raises
    ------
    ScenarioError
        The scenario, one of its effects or the model's calibration cannot be simulated.
    """
    about = scenario.scenario
    if setup is None:
        setup = believed_setup(scenario)
        for fault in scenario.fault:
            if isinstance(fault, Move) and fault.at_s is not None:
                end_s = fault.at_s + fault.duration_s
                setup = setup.with_motion(Turn(fault.at_s, end_s, fault.rate_dps * DEG, vector(fault.axis)))
    stuck = [
        effect("stuck_samples", fault.channel, start=(fault.at_s - epoch_s, "s"), duration=(fault.duration_s, "s"))
        for fault in scenario.fault
        if isinstance(fault, StuckSensor) and fault.at_s is not None and fault.at_s >= epoch_s
    ]
    heated = tuple(
        (fault.at_s - epoch_s, fault.change_c, fault.time_constant_s)
        for fault in scenario.fault
        if isinstance(fault, Heat) and fault.at_s is not None and fault.at_s >= epoch_s
    )
    try:
        return SimulatedBlock(
            model,
            setup,
            rate_hz=scenario.block.sample_rate_hz,
            seed=about.seed,
            effects=[*scenario.effect, *stuck],
            thermal=Thermal(about.start_c, about.end_c, about.time_constant_s, heated),
            power_cycle=power_cycle,
            epoch_s=epoch_s,
        )
    except ScenarioError:
        raise
    except ValueError as error:
        raise ScenarioError(f"this block or its motion cannot be simulated: {error}") from None


def planted_terms(scenario: Scenario, model: BlockModel) -> Terms:
    """Return the terms of (8), (9) that undo the bias shifts of the scenario and of the model: minus their sum."""
    terms = Terms.zero()
    for entry in (*model.effects, *scenario.effect):
        if entry.effect == "bias_shift":
            array = terms.f_mps2 if entry.channel.startswith("accel") else terms.g_radps
            array["xyz".index(entry.channel[-1])] -= values_of(get_effect("bias_shift"), entry)["shift"]
    return terms


def effect(name: str, channel: str, **parameters: tuple[float, str]) -> EffectEntry:
    """Return an entry from parameters given as (value, unit)."""
    values = {key: ParameterValue(value=float(value), unit=unit) for key, (value, unit) in parameters.items()}
    return EffectEntry(effect=name, channel=channel, parameters=values)


def reference_errors(reference: ReferenceMeta, rng: np.random.Generator) -> list[EffectEntry]:
    """Draw by how much the truth differs from the reference, from its own σ; what has no σ is exact."""
    normal = rng.standard_normal(3)
    entries = []
    if reference.azimuth_sigma_deg:
        entries.append(effect("azimuth_error", "all", error=(normal[0] * reference.azimuth_sigma_deg, "deg")))
    if reference.level_sigma_deg:
        tilt_1, tilt_2 = normal[1:] * reference.level_sigma_deg
        rides = float(reference.level_frame == "body")
        entries.append(effect("level_error", "all", tilt_1=(tilt_1, "deg"), tilt_2=(tilt_2, "deg"), rides=(rides, "1")))
    return entries


def demo_scenario(seed: int = 1) -> Scenario:
    """Return the demo's block on its launcher, 300 s from power-up.

    The seed draws the signs of the shifts (±2.4 deg/h on each gyro, ±0.3 mg on each accelerometer), the errors of the
    reference, the turn-on transients and the noise. For a recording of the same block with other noise use
    :meth:`Scenario.with_seed`.
    """
    rng = generator(seed, 1)
    reference = ReferenceMeta(
        azimuth_deg=40.0, azimuth_sigma_deg=0.1, roll_deg=0.0, pitch_deg=0.0, level_sigma_deg=0.003
    )
    signs = rng.choice([-1.0, 1.0], 6)
    transients = rng.uniform(-1.0, 1.0, 6)
    effects = reference_errors(reference, rng)
    for i, axis in enumerate("xyz"):
        effects += [
            effect("bias_shift", f"gyro_{axis}", shift=(signs[i] * 2.4, "deg/h")),
            effect("bias_shift", f"accel_{axis}", shift=(signs[3 + i] * 0.3, "mg")),
            effect(
                "turn_on_transient", f"gyro_{axis}", amplitude=(transients[i] * 5.0, "deg/h"), time_constant=(20.0, "s")
            ),
            effect(
                "turn_on_transient", f"accel_{axis}", amplitude=(transients[3 + i], "mg"), time_constant=(20.0, "s")
            ),
        ]
    return Scenario(
        site=SiteMeta(latitude_deg=35.7, height_m=1200.0),
        reference=reference,
        block=BlockMeta(sample_rate_hz=100.0, calibration="calibration.json", gyro_kind="dtg"),
        scenario=ScenarioMeta(duration_s=300.0, seed=seed, start_c=20.0, end_c=35.0, time_constant_s=25.0),
        effect=effects,
    )


def demo_model(seed: int = 1) -> BlockModel:
    """Return the demo's block as the laboratory left it: a DTG block, its coefficients drawn from the seed.

    Scale factors within 300 ppm, their asymmetry within 50 ppm, misalignments 0.3 mrad, biases 1 mg and 3 deg/h,
    g-sensitivity 3 deg/h/g along two axes of each gyro. Noise: angle random walk 0.01 deg/√h, gyro bias instability
    0.02 deg/h, velocity random walk 20 µg/√Hz.
    """
    rng = generator(seed, 2)
    g_sensitivity = rng.uniform(-1.0, 1.0, (3, 3)) * 3.0 * DEG_PER_H / STANDARD_GRAVITY_MPS2
    np.fill_diagonal(g_sensitivity, 0.0)
    coefficients = Coefficients(
        *_scales(rng),
        rng.uniform(-1.0, 1.0, 3) * MG,
        *_scales(rng),
        rng.uniform(-3.0, 3.0, 3) * DEG_PER_H,
        g_sensitivity,
    )
    accel = ChannelNoise(white=20e-3 * MG, flicker=0.0)
    gyro = ChannelNoise(white=0.01 * DEG / 60.0, flicker=0.02 * DEG_PER_H)
    channels = {f"{kind}_{axis}": noise for kind, noise in (("accel", accel), ("gyro", gyro)) for axis in "xyz"}
    calibration: ChannelCoefficients = coefficients.to_document()
    return BlockModel(
        block=f"demo-{seed}", gyro_kind="dtg", calibration=calibration, noise=Noise.model_validate(channels)
    )


def _scales(rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw the matrices for readings above and below zero."""
    mean = np.eye(3) + rng.uniform(-3e-4, 3e-4, (3, 3))
    half = rng.uniform(-2.5e-5, 2.5e-5, (3, 3))
    return mean + half, mean - half
