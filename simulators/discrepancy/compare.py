"""What the model predicts for a recording's own circumstances, and what is left of the measurement.

The prediction uses the recording's site, reference, motions and temperatures. A vibration is random: its course is
taken from the accelerometers themselves, so that what else it drives can be predicted; along its own axis it is
compared in its mean alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.ndimage import uniform_filter1d

from drivers.recording import Recording, RecordingError, read_recording
from inertial.documents import CHANNELS, BlockModel, EffectEntry
from inertial.error_model import Coefficients, readings_from_true
from simulators.discrepancy.coarse_alignment import azimuth_by_gyros, levelled
from simulators.discrepancy.repair import Gaps, Repaired, repair
from simulators.discrepancy.second_differences import MEAN_SIZE, ordinary_mean, second_differences
from simulators.discrepancy.shaking import spans_as_shaken
from simulators.discrepancy.whitening import FREE_SHARE, freely_rounded_hz
from simulators.effects import get_effect
from simulators.effects.base import Circumstances, Occasion, Readings, SampleEffect, Stage, values_of
from simulators.motion import Setup, Trajectory, Turn, Vibration, vibration_mean_square
from simulators.scenarios import Scenario, ScenarioMeta, believed_setup

Array = NDArray[np.float64]

MOST_READ = 1_000_000
"""Samples of a recording that are kept at all; of a longer one neighbours are summed as they are read."""
MOST_SAMPLES = 40_000
"""Samples of a recording that are analysed one by one; of a longer one, means of neighbours are."""
AWAY_V = 0.05
"""By which a steady supply must be off the nominal one for a coefficient to show; what moves by less is steady."""
_MEDIAN_OF_SQUARES = 0.4549  # of a standard normal variable
_ROUNDS = 3
_WHITE_HZ = 0.3, 3.0  # between flicker and rounding, where a channel's noise is white
_MEANS_S, _FEWEST_MEANS = 0.5, 50  # of neighbouring means
_FAR_OFF = 2.0  # by which noise must be larger than stated to be taken for other
_STRETCHES = 128  # over which the difference to the prediction is taken to be constant
_THERMOMETER_S = 5.0  # over which a thermometer's own noise is averaged out


Lateness = tuple[tuple[float, float], ...]
"""By how much [s] the start and the end of each turn came late."""


@dataclass(frozen=True)
class Scene:
    """One recording as it is compared: n samples, six channels.

    ``setup`` is what is believed; ``seen`` the circumstances by that belief; ``predicted``, ``measured`` (n, 6) [y];
    ``shaken`` (n, 3) the vibration [m/s²]; ``group`` how many samples are averaged to one before analysis;
    ``corrected`` (n, 6) [y] what errors of the reference make of the prediction, as far as they have been found;
    ``lateness_s`` of its turns, where that is known.
    """

    recording: Recording
    data: Repaired
    setup: Setup
    seen: Circumstances
    predicted: Array
    measured: Array
    shaken: Array
    model: BlockModel
    group: int
    corrected: Array | None = None
    lateness_s: Lateness = ()

    def acting(self, column: int) -> Array:
        """Return what acts on a channel's readout (n,) [y]: a dead band is met when the table really comes to it."""
        return (self.predicted if self.corrected is None else self.corrected)[:, column]

    @property
    def time_s(self) -> Array:
        """Device time at the end of every sample (n,)."""
        return self.data.edges_s[1:]

    @property
    def interval_s(self) -> float:
        """Mean interval of a sample as analysed."""
        return self.seen.interval_s * self.group

    def analysed(self, rates: Array, column: int) -> Array:
        """Return rates (n,) of a channel as they are analysed: without what was not measured, averaged in groups."""
        filled = self._gaps[column].fill(rates)
        if self.group == 1:
            return filled
        whole = len(filled) // self.group * self.group
        return np.asarray(filled[:whole].reshape(-1, self.group).mean(axis=1))

    def motion(self, column: int, stretches: int = _STRETCHES) -> Array:
        """Return the mean motion of a channel (n,) [y], as analysed.

        Its course is by the prediction; its level, which a bias shifts and a table's error in each turn, by the
        measurement: that of each turn, of what lies between two, and of as many stretches of the record at least.
        """
        predicted = self.analysed(self.predicted[:, column], column)
        off = self.analysed(self.measured[:, column], column) - predicted
        time_s = self.time_s[self.group - 1 :: self.group][: len(off)]
        ends_s = [end_s for _, turn in self.turns() for end_s in (turn.start_s, turn.end_s)]
        cuts = {0, len(off), *np.searchsorted(time_s, ends_s).tolist(), *(np.searchsorted(time_s, ends_s) + 1).tolist()}
        cuts |= set(range(0, len(off), max(1, len(off) // stretches)))
        edges = np.array(sorted(cut for cut in cuts if cut <= len(off)))
        level = np.add.reduceat(off, edges[:-1]) / np.diff(edges)
        return np.asarray(predicted + np.repeat(level, np.diff(edges)))

    @cached_property
    def vibrations(self) -> list[tuple[NDArray[np.bool_], Array]]:
        """Where each vibration goes on (n,), and its axis (3,), body, of length one."""
        return _vibrations(self.setup, self.seen)

    def unshaken(self, rates: Array, column: int) -> Array:
        """Return rates (n,) of a channel less what is taken for a vibration along its axis: all but the mean.

        The mean is that of samples which came: what stands for the others is not their part of the vibration.
        """
        if column >= 3:
            return rates
        left, came = rates, self.accelerometers_came
        for rows, axis in self.vibrations:
            part = left[rows]
            if axis[column] and came[rows].any():
                left = left.copy()
                left[rows] = part - axis[column] ** 2 * (part - part[came[rows]].mean())
        return left

    @cached_property
    def accelerometers_came(self) -> NDArray[np.bool_]:
        """Which samples (n,) came with all three accelerometers' readings."""
        return ~np.asarray(np.any(self.data.missing[:, :3], axis=1))

    @cached_property
    def _gaps(self) -> tuple[Gaps, ...]:
        return tuple(Gaps.of(missing) for missing in self.data.missing.T)

    @cached_property
    def noise_found(self) -> Array:
        """Return the 1σ of the white noise of a single sample (6,) [y] as found.

        It is looked for below the frequencies of rounding: in a band of the spectrum, which a line does not change, and
        between neighbouring means, which a course that jumps now and then does not. What silences a part of the samples
        changes what is found.
        """
        residual = (self.measured - self.predicted).T
        left = np.column_stack([gaps.fill(v) for gaps, v in zip(self._gaps, residual, strict=True)])
        power = np.square(dct(left, axis=0, norm="ortho"))
        hertz = np.arange(len(left)) / (2.0 * len(left) * self.seen.interval_s)
        band = (hertz > _WHITE_HZ[0]) & (hertz < _WHITE_HZ[1])
        found = np.sqrt(np.median(power[band], axis=0) / _MEDIAN_OF_SQUARES)
        return np.minimum(found, _between_means(left, max(1, round(_MEANS_S / self.seen.interval_s))))

    @cached_property
    def noise_sigma(self) -> Array:
        """Return the 1σ of the white noise of a single sample (6,) [y]: as stated, or as found where that is larger."""
        if self.model.noise.free:
            return self.noise_found
        stated = np.array([getattr(self.model.noise, name).white for name in CHANNELS]) / np.sqrt(self.seen.interval_s)
        return np.where(self.noise_found < _FAR_OFF * stated, stated, self.noise_found)

    def freely_rounded_hz(self, column: int) -> float:
        """Return the frequency above which a channel's rounding errors may show, see :func:`freely_rounded_hz`.

        Of noise of which the model knows the size about, the least is taken.
        """
        noise = getattr(self.model.noise, CHANNELS[column])
        if self.model.noise.free:
            noise = noise.model_copy(update={"white": FREE_SHARE * noise.white})
        return freely_rounded_hz(noise, self.interval_s)

    @property
    def warm(self) -> bool:
        """Whether there is a thermometer."""
        return bool(np.isfinite(self.data.temperature_c).all())

    @property
    def supplied(self) -> bool:
        """Whether the supply was measured."""
        return bool(np.isfinite(self.data.supply_v).all())

    def turns(self) -> list[tuple[int, Turn]]:
        """Return the turns within the data, with their place among the motions."""
        start, end = self.data.edges_s[0], self.data.edges_s[-1]
        return [
            (index, motion)
            for index, motion in enumerate(self.setup.motions)
            if isinstance(motion, Turn) and motion.end_s > start and motion.start_s < end and motion.rate_radps != 0.0
        ]

    def near_turn_ends(self, time_s: Array, within_s: float) -> NDArray[np.bool_]:
        """Return which times [s] are near the beginning or the end of a turn."""
        near = np.zeros(len(time_s), dtype=np.bool_)
        for _, turn in self.turns():
            for end_s in (turn.start_s, turn.end_s):
                near |= np.abs(time_s - end_s) < within_s
        return near

    def turning(self, time_s: Array) -> NDArray[np.bool_]:
        """Return at which times [s] the block turns, as stated."""
        turning = np.zeros(len(time_s), dtype=np.bool_)
        for _, turn in self.turns():
            turning |= (time_s >= turn.start_s) & (time_s < turn.end_s)
        return turning

    def shaking(self) -> NDArray[np.bool_]:
        """Return where a vibration goes on (n,)."""
        return self.seen.vibration_mps2_squared > 0.0

    def predict(self, setup: Setup, edges_s: Array | None = None, device_s: Array | None = None) -> Array:
        """Return the readings (n, 6) for another set-up, between other true times, over other intervals."""
        seen = self._seen(setup, self.data.edges_s if edges_s is None else edges_s, device_s)
        return _readings(self.model, seen)

    def _seen(self, setup: Setup, edges_s: Array, device_s: Array | None) -> Circumstances:
        accel, gyro = true_rates(setup, edges_s, np.diff(self.data.edges_s) if device_s is None else device_s)
        accel += self.shaken
        return replace(self.seen, accel_mps2=accel, gyro_radps=gyro)


def read_to_compare(path: Path | str) -> Recording:
    """Read a recording in memory that does not grow with its length."""
    return read_recording(path, MOST_READ)


def true_rates(setup: Setup, edges_s: Array, interval_s: Array) -> tuple[Array, Array]:
    """Return mean specific force and rate (n, 3) between the edges, vibrations left out, per device interval."""
    dv, dtheta = Trajectory(setup).smooth_increments(edges_s)
    return dv / interval_s[:, None], dtheta / interval_s[:, None]


def compare(recording: Recording, model: BlockModel, most_samples: int = MOST_SAMPLES) -> Scene:
    """Predict a recording by a model; of one with more samples than ``most_samples``, means are analysed.

    Raises
    ------
    RecordingError
        The site lacks its latitude.
    ScenarioError
        The model or the motions cannot be simulated.
    """
    recording.require("site.latitude_deg")
    data = repair(recording.samples)
    if len(data.edges_s) < 200:
        raise RecordingError(
            recording.path, "", f"holds {len(recording.samples)} samples", "Give two hundred or more to compare"
        )
    meta = recording.meta
    scenario = Scenario(
        site=meta.site, reference=meta.reference, block=meta.block, motion=meta.motion, scenario=ScenarioMeta()
    )
    setup = believed_setup(scenario)
    if not meta.reference.level_given:
        setup = levelled(setup, data)
    for entry in model.effects:
        effect = get_effect(entry.effect)
        if effect.stage is Stage.SETUP:
            setup = effect.arrange(setup, Occasion(entry.channel, values_of(effect, entry), 1.0))
    interval = np.diff(data.edges_s)
    step = float(interval.mean())
    accel, gyro = true_rates(setup, data.edges_s, interval)
    smooth = max(1, round(_THERMOMETER_S / step))
    temperature = np.nan_to_num(data.temperature_c, nan=20.0)
    seen = Circumstances(
        data.edges_s[1:],
        step,
        accel,
        gyro,
        uniform_filter1d(temperature, smooth, mode="nearest")[:, None],
        np.nan_to_num(data.supply_v),
        vibration_mean_square(setup, data.edges_s[1:] - 0.5 * step),
    )
    group = -(-len(interval) // most_samples)
    scene = Scene(
        recording, data, setup, seen, _readings(model, seen), data.rate.copy(), np.zeros_like(accel), model, group
    )
    if meta.reference.azimuth_deg is None:
        scene = _gyrocompassed(scene)
    return following_vibrations(scene)


def _gyrocompassed(scene: Scene) -> Scene:
    """Return the scene at the azimuth that its gyros say."""

    def at(azimuth_rad: float) -> Setup:
        return replace(scene.setup, azimuth_rad=azimuth_rad)

    came = ~np.any(scene.data.missing[:, 3:], axis=1)
    found = azimuth_by_gyros(
        scene.measured[:, 3:],
        came,
        lambda azimuth_rad: scene.predict(at(azimuth_rad))[:, 3:],
        scene.noise_found[3:],
    )
    accel, gyro = true_rates(at(found), scene.data.edges_s, np.diff(scene.data.edges_s))
    seen = replace(scene.seen, accel_mps2=accel, gyro_radps=gyro)
    return replace(scene, setup=at(found), seen=seen, predicted=_readings(scene.model, seen))


def following_vibrations(scene: Scene) -> Scene:
    """Return the scene with the course of its vibrations as the accelerometers measured it."""
    if not scene.shaking().any():
        return scene
    accel = scene.seen.accel_mps2 - scene.shaken
    seen, predicted, shaken = replace(scene.seen, accel_mps2=accel), scene.predicted, np.zeros_like(accel)
    if scene.shaken.any():
        predicted = _readings(scene.model, seen)
    off, came = (scene.measured - predicted)[:, :3], scene.accelerometers_came
    setup = spans_as_shaken(scene.setup, seen.time_s, off, ~came)
    shaking = vibration_mean_square(setup, seen.time_s - 0.5 * seen.interval_s)
    scene, seen = replace(scene, setup=setup), replace(seen, vibration_mps2_squared=shaking)
    for _ in range(_ROUNDS):  # what a reading says of its input depends on the model's scale, so again
        shaken += _shaken(scene.setup, seen, scene.measured - predicted, came)
        seen = replace(seen, accel_mps2=accel + shaken)
        predicted = _readings(scene.model, seen)
    return replace(scene, seen=seen, predicted=predicted, shaken=shaken)


def _between_means(values: Array, block: int) -> Array:
    """Return the 1σ of single values (k,) by the means of blocks of them (n, k); infinite where these are too few."""
    if len(values) // block < _FEWEST_MEANS:
        return np.full(values.shape[1], np.inf)
    size = ordinary_mean(np.abs(second_differences(values, block)))
    return np.asarray(size / MEAN_SIZE * math.sqrt(block / 6.0))


def _shaken(setup: Setup, seen: Circumstances, residual: Array, came: NDArray[np.bool_]) -> Array:
    """Return the vibration (n, 3) [m/s²] as the accelerometers saw it along its axis, its mean left out."""
    shaken = np.zeros((len(residual), 3))
    for rows, axis in _vibrations(setup, seen):
        along = residual[rows][:, :3] @ axis
        if came[rows].any():
            shaken[rows] = np.outer(along - along[came[rows]].mean(), axis)
    return shaken


def _vibrations(setup: Setup, seen: Circumstances) -> list[tuple[NDArray[np.bool_], Array]]:
    """Return where each vibration goes on (n,), and its axis (3,)."""
    found = []
    for motion in setup.motions:
        if isinstance(motion, Vibration):
            rows = (seen.time_s > motion.start_s) & (seen.time_s <= motion.end_s + seen.interval_s)
            if rows.sum() >= 4:
                found.append((rows, np.asarray(motion.axis) / np.linalg.norm(motion.axis)))
    return found


def _readings(model: BlockModel, seen: Circumstances) -> Array:
    """Return the model's noiseless readings (n, 6): calibration and its own effects but noise."""
    coefficients = Coefficients.from_document(model.calibration)
    accel, gyro = readings_from_true(seen.accel_mps2, seen.gyro_radps, coefficients)
    readings = Readings(
        accel * seen.interval_s, gyro * seen.interval_s, seen.time_s.copy(), np.zeros(len(accel), dtype=np.bool_)
    )
    for entry in sorted(model.effects, key=lambda entry: get_effect(entry.effect).stage):
        _apply(entry, seen, readings)
    return np.hstack([readings.dv, readings.dtheta]) / seen.interval_s


def parameter_change(scene: Scene, entry: EffectEntry, name: str) -> Array:
    """Return what 1σ more of one parameter of an effect of the model makes of the prediction, less it (n, 6)."""
    effect, parameter = get_effect(entry.effect), entry.parameters[name]
    more = parameter.model_copy(update={"value": parameter.value + (parameter.sigma or 0.0)})
    changed = entry.model_copy(update={"parameters": {**entry.parameters, name: more}})
    if effect.stage is Stage.SETUP:  # set-ups add up
        before, after = values_of(effect, entry), values_of(effect, changed)
        unsure = {key for key, one in entry.parameters.items() if one.sigma}
        values = {key: after[key] - before[key] if key in unsure else value for key, value in before.items()}
        return scene.predict(effect.arrange(scene.setup, Occasion(entry.channel, values, 1.0))) - scene.predicted
    effects = [changed if one is entry else one for one in scene.model.effects]
    return _readings(scene.model.model_copy(update={"effects": effects}), scene.seen) - scene.predicted


def _apply(entry: EffectEntry, seen: Circumstances, readings: Readings) -> None:
    effect = get_effect(entry.effect)
    random_or_lost = effect.stage in (Stage.SETUP, Stage.NOISE) or entry.effect in RANDOM
    if not random_or_lost:
        effect.begin(Occasion(entry.channel, values_of(effect, entry), seen.interval_s))(seen, readings)


RANDOM = frozenset({"quantisation", "lost_samples", "stuck_samples"})
"""Effects of readout and frame that are no prediction but noise or loss."""


@dataclass(frozen=True)
class SampleNoise:
    """Normal noise of a single sample, 1σ [y], a ``share`` of samples ``times`` as noisy."""

    sigma: float
    share: float = 0.0
    times: float = 1.0


def mean_changed(
    scene: Scene, effect: SampleEffect, channel: str, values: Mapping[str, float], noise: SampleNoise | None = None
) -> Array:
    """Return what an effect of readout makes of a channel's readings in the mean over their noise, less them (n,).

    The noise is as known from the whole recording unless another is given.
    """
    column = CHANNELS.index(channel)
    noise = noise or SampleNoise(float(scene.noise_sigma[column]))
    change = effect.mean_change(scene.acting(column), noise.sigma, values)
    if noise.share:
        tails = effect.mean_change(scene.acting(column), noise.times * noise.sigma, values)
        change = change + noise.share * (tails - change)
    return change
