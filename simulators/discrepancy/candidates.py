"""Everything that could explain a residual, as columns: what one unit of it would add to each channel of each scene.

Columns come from the effects' own definitions, at a grid of shapes (time constants, times, limits); set-up effects by
predicting again. Beside the named effects stand the errors of the reference (timing, angle and axis of each turn, lever
arm), which explain without naming the block, and a generic basis that names nothing (:mod:`.referee`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from drivers.recording_meta import TurnMeta
from inertial.documents import CHANNELS
from simulators.discrepancy.compare import AWAY_V, SampleNoise, Scene, mean_changed, parameter_change
from simulators.discrepancy.hidden_course import hidden_courses
from simulators.discrepancy.lost_vibration import lost_vibration
from simulators.discrepancy.referee import generic_columns
from simulators.discrepancy.sway_ends import end_rates
from simulators.discrepancy.turn_errors import ANGLE, TurnErrors, all_late, changed_by, is_whole, turn_errors
from simulators.discrepancy.unsteady import level_spread
from simulators.discrepancy.wiring import Mistake, mend
from simulators.effects import effects, get_effect
from simulators.effects.base import Effect, LinearEffect, Occasion, SampleEffect, Stage
from simulators.effects.size_effect import SizeEffect
from simulators.effects.thermal_lag import ThermalLag
from simulators.motion import Turn

Array = NDArray[np.float64]
Slot = tuple[int, int]
"""A scene and a channel, both counted from 0."""

GYROS = range(3, 6)
"""Channels of gyros."""

STEP_TRIALS = 12
TRANSIENT_S = (5.0, 12.0, 25.0, 50.0, 100.0, 250.0, 700.0, 2000.0)
LAG_S = (6.0, 20.0, 60.0, 180.0, 600.0)
DELAY_SAMPLES = (0.03, 0.5, 2.0, 6.0, 20.0)
"""Sizes at which a delay, and what a false clock amounts to at the end, are taken as a chord."""
FELT_SIGMA, FELT_RATIO, FELT_SIZES = 3.0, 2.0, 15
"""Sizes of readout effects to try: by how many σ of the noise they change the readings; how many more each time."""
EXTREME, THINNED = 200, 40
"""Of the inputs the smallest and largest are looked at for these, and one of so many of the others."""
AWAY_C = 0.3
"""By which a steady temperature must be off the usual reference for a coefficient to show."""
LAGS_C = 0.1
"""By which temperature must change for a lag to show, whose course is like that of nothing else."""
USUAL = {"reference": (20.0, 25.0), "nominal": (28.0,)}
"""Of what a coefficient is counted from: temperatures [°C] of laboratories, and the voltage [V] of supplies."""
FITTED_PLACES = 100.0
"""What any other costs, of which there are as many as the data can tell apart: it stands for a bias as well."""
STEP_PLACES = 200.0
"""Times at which a step could be, where it shows in one alone."""
REWIRED = frozenset({"sign_flip", "axis_swap"})
"""Mistakes of wiring that have no size."""
SMALL = {"azimuth_error": 1e-3, "latitude_error": 1e-3, "gravity_error": 1e-3}
TILT_RAD = 1e-4
TIMING_SIGMA_S = 1e-3
"""How well a schedule is kept where nothing is said of it: as a whole, and each start and end of a turn."""


class Kind(StrEnum):
    """What a hypothesis explains by: a named effect, an error of the reference, or nothing but a curve."""

    NAMED = "named"
    REFERENCE = "reference"
    EMPIRICAL = "empirical"


@dataclass(frozen=True)
class Column:
    """What one unit adds: the cosine coefficients of each slot it touches."""

    parts: Mapping[Slot, Array]


@dataclass(frozen=True)
class _TurnColumns:
    """What errors of one turn would add: start late, end late [per s], each once more beyond a sample's edge, angle."""

    error: TurnErrors
    starts: list[Column]
    ends: list[Column]
    angle: Column | None


@dataclass(frozen=True)
class Schedule:
    """Columns (ids) of how late all turns of a recording were, and each start and end.

    ``at_s``: when these were to be, if their columns are chords to a known lateness, of all turns that there are.
    """

    offset: int | None
    starts: tuple[tuple[int, ...], ...]
    ends: tuple[tuple[int, ...], ...]
    at_s: tuple[float, ...]


@dataclass(frozen=True)
class Hypothesis:
    """One explanation: columns (ids) whose amplitudes are to be found, at a fixed shape.

    ``places`` counts the shapes that were or could have been looked at, for the penalty of looking.
    """

    kind: Kind
    effect: str
    channel: str
    columns: tuple[int, ...]
    shape: Mapping[str, float] = field(default_factory=dict)
    places: float = 1.0
    unit_amplitude: bool = False
    chord: tuple[float, ...] = ()
    """Sizes at which columns that are not quite linear were taken; none for linear ones."""

    @property
    def name(self) -> tuple[str, str]:
        """Effect and channel."""
        return self.effect, self.channel

    @property
    def freedom(self) -> int:
        """How many numbers are found from the data: amplitudes, or the shape of what has none; none of a mistake."""
        return len(self.shape) if self.unit_amplitude else len(self.columns)

    @property
    def is_plain(self) -> bool:
        """Whether it is one column of any size, as it stands: neither its shape nor its size says how it looks."""
        return len(self.columns) == 1 and not (self.unit_amplitude or self.shape or self.chord)


def to_cosine(values: Array) -> Array:
    """Return the orthonormal cosine coefficients (n,)."""
    return np.asarray(dct(values, norm="ortho"))


class Library:
    """All columns and hypotheses for some scenes."""

    def __init__(
        self, scenes: Sequence[Scene], only: Collection[tuple[str, str]] | None = None, *, plain: bool = False
    ) -> None:
        """Gather everything, or ``only`` some effects and curves on some channels and no errors of the reference.

        ``plain``: one shape of each effect, and no curves.
        """
        self.scenes = scenes
        self._only, self._plain = only, plain
        self.residual: dict[Slot, Array] = {}
        self.spread: dict[Slot, Array] = {}
        """How much noisier each analysed sample is than those at rest."""
        self._known: dict[tuple[int, int, int], Array] = {}
        self._gappy: dict[Slot, bool] = {}
        for s, scene in enumerate(scenes):
            for c in range(6):
                self._gappy[s, c] = bool(scene.data.missing[:, c].any())
                residual, spread = level_spread(scene, c)
                self.residual[s, c], self.spread[s, c] = to_cosine(residual / spread), spread
        self.closed = False
        """Whether all is gathered: what comes after are trials, which are not kept."""
        self.columns: list[Column] = []
        self.hypotheses: list[Hypothesis] = []
        self.corrected: list[Hypothesis] = []
        """Those of :meth:`correct`."""
        self.nuisance: list[tuple[int, float]] = []
        """Columns that are always in the fit, with their prior σ."""
        self.met: dict[str, SampleNoise] = {}
        """Noise that a dead band would meet, of channels of which single samples show it."""
        self.schedules: dict[int, Schedule] = {}
        """Those of them that say how late turns were, by recording."""
        self.ends: dict[Slot, list[int]] = {}
        """Columns of what a gyro feels of a mount's angle at both ends of a record: see :meth:`sway`."""
        for index in range(len(scenes)):
            turns = self._turn_columns(index)
            self._add_nuisance(index, turns)
            if only is None:
                self._add_reference(index, turns)
        for effect in effects().values():
            self._add_effect(effect)
        self._add_model()
        if not plain:
            for channel in range(len(CHANNELS)):
                self._add_generic(channel)

    def left(self, slot: Slot, ids: Sequence[int], amplitude: Array) -> Array:
        """Return the cosine coefficients (n,) of the residual that columns of some amplitudes leave in a slot."""
        return self.residual[slot] - self.added(slot, ids, amplitude)

    def added(self, slot: Slot, ids: Sequence[int], amplitude: Array) -> Array:
        """Return the cosine coefficients (n,) of what columns of some amplitudes add up to in a slot."""
        total = np.zeros(len(self.residual[slot]))
        for i, size in zip(ids, amplitude, strict=True):
            part = self.columns[i].parts.get(slot)
            if part is not None:
                total += size * part
        return total

    def ratio(self, one: Hypothesis, two: Hypothesis) -> float | None:
        """Return by what the second's column is multiplied to be the first's; none unless parallel and plain."""
        if not (one.is_plain and two.is_plain):
            return None
        first, second = self.columns[one.columns[0]].parts, self.columns[two.columns[0]].parts
        if first.keys() != second.keys():
            return None
        own = sum(float(second[slot] @ second[slot]) for slot in second)
        both = sum(float(first[slot] @ second[slot]) for slot in first)
        ratio = both / own
        off = sum(float(np.sum((first[slot] - ratio * second[slot]) ** 2)) for slot in first)
        return ratio if ratio != 0.0 and off < _PARALLEL**2 * ratio**2 * own else None

    def add_column(self, raw: Iterable[tuple[Slot, Array]]) -> int | None:
        """Keep a column given as rates (n,) by slot; none where it has nothing in it."""
        column = self._column(raw)
        return None if column is None else self._keep(column)

    def _keep(self, column: Column) -> int:
        self.columns.append(column)
        return len(self.columns) - 1

    def _column(self, raw: Iterable[tuple[Slot, Array]]) -> Column | None:
        parts = {}
        for (scene, channel), values in raw:
            largest = float(np.max(np.abs(values), initial=0.0))
            if largest > 1e-280 and np.all(np.isfinite(values)):
                parts[scene, channel] = self._coefficients(scene, channel, values)
        return Column(parts) if parts else None

    def _coefficients(self, scene: int, channel: int, values: Array) -> Array:
        """Return a column's coefficients, of no more than is compared."""
        return self._weighted(scene, channel, self.scenes[scene].unshaken(values, channel))

    def _weighted(self, scene: int, channel: int, values: Array) -> Array:
        """Return the coefficients of rates (n,); channels whose samples are all equally good share them."""
        plain = bool(np.all(self.spread[scene, channel] == 1.0)) and not self._gappy[scene, channel]
        key = (scene, -1 if plain else channel, hash(values.tobytes()))
        if key not in self._known:
            weighted = self.scenes[scene].analysed(values, channel) / self.spread[scene, channel]
            coefficients = to_cosine(weighted)
            if self.closed:
                return coefficients
            self._known[key] = coefficients
        return self._known[key]

    def add(
        self,
        kind: Kind,
        effect: str,
        channel: str,
        raw: Sequence[Sequence[tuple[Slot, Array]]],
        shape: Mapping[str, float] | None = None,
        places: float = 1.0,
        unit_amplitude: bool = False,
        chord: tuple[float, ...] = (),
    ) -> Hypothesis | None:
        """Keep a hypothesis given as its columns; none where one has nothing in it."""
        ids = [self.add_column(column) for column in raw]
        kept = tuple(i for i in ids if i is not None)
        if not kept or (len(kept) < len(ids) and effect not in _SPARSE):
            return None
        return self._listed(Hypothesis(kind, effect, channel, kept, dict(shape or {}), places, unit_amplitude, chord))

    def _listed(self, hypothesis: Hypothesis) -> Hypothesis:
        if not self.closed:
            self.hypotheses.append(hypothesis)
        return hypothesis

    def correct(self, slot: Slot, change: Array) -> None:
        """Take what acts on a channel's readout to be off the prediction by ``change`` (n,) [y].

        Its dead bands and limits are then other hypotheses, later than the library's own.
        """
        s, column = slot
        scene, channel = self.scenes[s], CHANNELS[column]
        corrected = scene.predicted.copy() if scene.corrected is None else scene.corrected.copy()
        corrected[:, column] = scene.predicted[:, column] + change
        self.scenes = [*self.scenes[:s], replace(scene, corrected=corrected), *self.scenes[s + 1 :]]
        for effect in effects().values():
            if isinstance(effect, SampleEffect) and channel in self._wanted(effect):
                self.hypotheses = [h for h in self.hypotheses if h.name != (effect.name, channel)]
                self.corrected = [h for h in self.corrected if h.name != (effect.name, channel)]
                shapes = self.shapes(effect, channel)
                trials = [self.trial(effect.name, channel, shape, float(len(shapes))) for shape in shapes]
                self.corrected += [trial for trial in trials if trial is not None]

    def sway(self, slot: Slot, correlation_s: float) -> None:
        """Fill the columns of a mount's angle at both ends, which forgets itself within so long, by a unit of it."""
        scene = self.scenes[slot[0]]
        analysed = scene.time_s.size // scene.group * scene.group
        rates = np.zeros((2, scene.time_s.size))
        rates[:, :analysed] = end_rates(analysed, scene.seen.interval_s, correlation_s)
        for i, of_end in zip(self.ends[slot], rates, strict=True):
            self.columns[i] = Column({slot: self._weighted(*slot, of_end)})

    def forget(self, hypothesis: Hypothesis) -> None:
        """Let go of the columns of a trial that came to nothing."""
        for i in hypothesis.columns:
            self.columns[i] = Column({})

    def trial(self, effect: str, channel: str, shape: Mapping[str, float], places: float) -> Hypothesis | None:
        """Add one more shape of an effect on sensors, which is one of so many places.

        Of what has no amplitude the shape is the number found from the data, and is charged for as such alone.
        """
        found = get_effect(effect)
        raw = self._sensor_columns(found, channel, shape)
        readout = isinstance(found, SampleEffect)
        return self.add(Kind.NAMED, effect, channel, raw, shape, 1.0 if readout else places, readout)

    def setup_trial(
        self, effect: str, channel: str, sizes: tuple[float, ...], shape: Mapping[str, float] | None = None
    ) -> Hypothesis | None:
        """Add a set-up effect's columns, taken as chords to ``sizes``, so that large errors need no small angles."""
        delayed = self._delayed(effect, channel)
        if delayed is not None:
            return self._listed(Hypothesis(Kind.NAMED, effect, channel, (self._keep(delayed),)))
        places = {"latency": len(DELAY_SAMPLES), "clock_scale": len(DELAY_SAMPLES), "level_error": 2}.get(effect, 1)
        raw: list[list[tuple[Slot, Array]]] = [[] for _ in sizes]
        for s, scene in enumerate(self.scenes):
            for column, change in zip(raw, _chords(scene, effect, channel, sizes, shape or {}), strict=True):
                column += [((s, c), change[:, c]) for c in range(6)]
        return self.add(Kind.NAMED, effect, channel, raw, shape, float(places), chord=sizes)

    def _delayed(self, effect: str, channel: str) -> Column | None:
        """Return what a delay or a clock's error adds where turns' lateness is known, to each start and end its own.

        So that with what each is late by besides it adds up to what both do. None for others, or where it is not
        known. A clock that runs fast takes a sample's interval for longer, and a force over it for less; a turn of the
        same angle that lasts longer is slower by itself.
        """
        if effect not in ("latency", "clock_scale") or len(self.schedules) < len(self.scenes):
            return None
        if not all(schedule.at_s for schedule in self.schedules.values()):
            return None
        touched = [c for c, name in enumerate(CHANNELS) if channel == "all" or name.startswith(channel)]
        parts: dict[Slot, Array] = {}
        for index, schedule in self.schedules.items():
            if effect == "clock_scale":
                force = self._column(_of(index, -self.scenes[index].predicted)[:3])
                parts |= {slot: part for slot, part in (force.parts if force else {}).items() if slot[1] in touched}
            for ids, at_s in zip((*schedule.starts, *schedule.ends), schedule.at_s, strict=True):
                late = self.columns[ids[0]].parts if ids else {}
                for slot, part in late.items():
                    if slot[1] in touched:
                        parts[slot] = parts.get(slot, 0.0) + part * (at_s if effect == "clock_scale" else 1.0)
        return Column(parts) if parts else None

    def _wanted(self, effect: Effect) -> list[str]:
        names = effect.channel_names()
        return [name for name in names if self._only is None or (effect.name, name) in self._only]

    def _add_effect(self, effect: Effect) -> None:
        if isinstance(effect, (LinearEffect, SizeEffect, ThermalLag, SampleEffect)):
            for channel in self._wanted(effect):
                shapes = self.shapes(effect, channel)
                if self._plain:
                    shapes = shapes[len(shapes) // 2 :][:1]
                usual = STEP_PLACES if effect.name == "bias_step" else float(sum(map(is_usual, shapes)))
                for shape in shapes:
                    self.trial(effect.name, channel, shape, usual if is_usual(shape) else FITTED_PLACES)
        elif not self._wanted(effect):
            return
        elif effect.name in REWIRED:
            self._add_mistakes(effect)
        elif effect.name in SMALL:
            self.setup_trial(effect.name, "all", (SMALL[effect.name],))
        elif effect.name in ("latency", "clock_scale"):
            for channel in self._wanted(effect):
                known = self._delayed(effect.name, channel) is not None
                for size in _delays(self.scenes[0], effect.name)[: 1 if known else None]:
                    self.setup_trial(effect.name, channel, (size,))
        elif effect.name == "level_error":
            for rides in (0.0, 1.0):
                self.setup_trial("level_error", "all", (TILT_RAD, TILT_RAD), {"rides": rides})

    def _add_mistakes(self, effect: Effect) -> None:
        """What a mistake of wiring would add; those too large to be missed were mended before."""
        for channel in self._wanted(effect):
            on, _, by = channel.partition("<-")
            one, two = CHANNELS.index(on), CHANNELS.index(by or on)
            if one > two:
                continue  # the same exchange as the other way about
            raw: list[tuple[Slot, Array]] = []
            for s, scene in enumerate(self.scenes):
                wired = mend(scene.predicted, [Mistake(effect.name, channel)])
                raw += [((s, c), wired[:, c] - scene.predicted[:, c]) for c in {one, two}]
            self.add(Kind.NAMED, effect.name, channel, [raw], unit_amplitude=True)

    def shapes(self, effect: Effect, channel: str) -> list[dict[str, float]]:
        """Return the grid of shapes of an effect."""
        scene = self.scenes[0]
        match effect.name:
            case "bias_step":
                start, end = float(scene.data.edges_s[0]), float(scene.data.edges_s[-1])
                inner = np.linspace(start, end, STEP_TRIALS + 2)[1:-1]
                return [{"time": float(t)} for t in inner]
            case "turn_on_transient":
                return [{"time_constant": t} for t in TRANSIENT_S if t < self.longest_s]
            case "thermal_lag":
                return [{"time_constant": t} for t in LAG_S] if self._warms(LAGS_C) else []
            case "bias_temperature" | "scale_temperature":
                mean = float(np.mean([np.mean(s.seen.temperature_c[:, 0]) for s in self.scenes]))
                first = float(scene.seen.temperature_c[0, 0])
                if not self._warms(AWAY_C):  # nor does it cool: what depends on temperature stays what it is
                    known = all(s.warm for s in self.scenes)
                    return [{"reference": t} for t in USUAL["reference"][:1] if known and abs(mean - t) > AWAY_C]
                references = dict.fromkeys((mean, *USUAL["reference"], first))
                return [{"reference": t} for t in references]
            case "supply_sensitivity":
                volts = [float(np.mean(s.seen.supply_v)) for s in self.scenes]
                spread = max(float(np.ptp(s.seen.supply_v)) for s in self.scenes)
                if not all(s.supplied for s in self.scenes):
                    return []
                mean = float(np.mean(volts))
                if spread < AWAY_V:  # what depends on the supply stays what it is
                    return [{"nominal": v} for v in USUAL["nominal"] if abs(mean - v) > AWAY_V]
                return [{"nominal": v} for v in dict.fromkeys((mean, *USUAL["nominal"]))]
            case "dead_band" | "saturation":
                assert isinstance(effect, SampleEffect)
                return self._felt(effect, channel, effect.parameters[0].name)
            case "sinusoid":
                return []  # found from the spectrum
            case _:
                return [{}]

    @property
    def longest_s(self) -> float:
        """Longest time constant that these recordings can tell from a constant."""
        return 2.0 * max(float(scene.data.edges_s[-1] - scene.data.edges_s[0]) for scene in self.scenes)

    def _warms(self, by_c: float) -> bool:
        ranges = [float(np.ptp(s.seen.temperature_c[:, 0])) for s in self.scenes if s.warm]
        return len(ranges) == len(self.scenes) and max(ranges) > by_c

    def _felt(self, effect: SampleEffect, channel: str, name: str) -> list[dict[str, float]]:
        """Return sizes of a readout effect whose change of the readings amounts to 3, 6, 12 … σ of their noise.

        What such a change explains falls off fast on both sides of its true size, and is less than nothing at twice the
        change.
        """
        column = CHANNELS.index(channel)
        inputs, weight = _thinned(np.concatenate([np.abs(s.acting(column)) for s in self.scenes]))
        sigma = max(float(s.noise_sigma[column]) for s in self.scenes)
        if not 0.0 < sigma < math.inf:
            return []
        levels = 2.0 * sigma * np.unique(np.round(np.quantile(inputs, np.linspace(0.0, 1.0, 31)) / (2.0 * sigma)))
        near = (levels[:, None] + sigma * np.linspace(-4.0, 4.0, 9)).ravel()
        below = levels[-1] - np.geomspace(sigma, max(levels[-1], 2.0 * sigma), 40)[:-1]  # limits short of the largest
        evenly = np.geomspace(0.1 * sigma, levels[-1] + 4.0 * sigma, 40)
        tried = np.unique(np.concatenate([evenly, near[near > 0.0], below[below > 0.0]]))
        sigmas = np.sqrt([weight @ effect.mean_change(inputs, sigma, {name: size}) ** 2 for size in tried]) / sigma
        wanted = FELT_SIGMA * FELT_RATIO ** np.arange(FELT_SIZES)
        places = {
            int(np.argmin(np.abs(np.log(np.maximum(sigmas, 1e-9) / d)))) for d in wanted if d < 1.5 * sigmas.max()
        }
        return [{name: float(tried[place])} for place in sorted(places)]

    def _sensor_columns(
        self, effect: Effect, channel: str, shape: Mapping[str, float]
    ) -> list[list[tuple[Slot, Array]]]:
        on = CHANNELS.index(channel.partition("<-")[0])
        count = effect.amplitudes if isinstance(effect, (LinearEffect, SizeEffect)) else 1
        raw: list[list[tuple[Slot, Array]]] = [[] for _ in range(count)]
        for s, scene in enumerate(self.scenes):
            if isinstance(effect, SampleEffect):
                noise = self.met.get(channel) if effect.name == "dead_band" else None
                columns = mean_changed(scene, effect, channel, shape, noise)[:, None]
            elif isinstance(effect, (LinearEffect, SizeEffect, ThermalLag)):
                columns = effect.regressors(scene.seen, channel, shape)
            for k in range(count):
                raw[k].append(((s, on), columns[:, k]))
        return raw

    def _turn_columns(self, index: int) -> list[_TurnColumns]:
        """Return what errors of the first turns would add."""
        found = []
        for error in turn_errors(self.scenes[index]):
            starts, ends = (
                [column for change in late if (column := self._column(_of(index, change))) is not None]
                for late in (error.starts, error.ends)
            )
            found.append(_TurnColumns(error, starts, ends, self._column(_of(index, error.angle))))
        return found

    def _add_reference(self, index: int, turns: Sequence[_TurnColumns]) -> None:
        """Errors that the reference does not admit to, of any size."""
        if not turns:
            return
        scene = self.scenes[index]
        axis: list[list[tuple[Slot, Array]]] = []
        for one in turns:
            unit = np.asarray(one.error.turn.axis) / np.linalg.norm(one.error.turn.axis)
            across = np.cross(unit, np.eye(3)[int(np.argmin(np.abs(unit)))])
            across /= np.linalg.norm(across)
            for side in (across, np.cross(unit, across)):
                x, y, z = (float(v) for v in unit + ANGLE * side)
                tipped = replace(one.error.turn, axis=(x, y, z))
                axis.append(_of(index, changed_by(scene, one.error.place, tipped) / ANGLE))
        lever = [
            [((index, c), SizeEffect().regressors(scene.seen, CHANNELS[c], {})[:, k]) for c in range(3)]
            for k in range(3)
        ]
        where = f"recording {index + 1}" if len(self.scenes) > 1 else "all"
        groups: dict[str, list[int | None]] = {
            "timing": [self._keep(column) for one in turns for column in (*one.starts, *one.ends)],
            "angle": [self._keep(one.angle) for one in turns if one.angle is not None],
            "axis": [self.add_column(raw) for raw in axis],
            "lever": [self.add_column(raw) for raw in lever],
        }
        for name, parts in _REFERENCE.items():
            ids = tuple(i for part in parts for i in groups[part] if i is not None)
            if ids:
                self.hypotheses.append(Hypothesis(Kind.REFERENCE, name, where, ids))

    def _add_model(self) -> None:
        """What the model itself is unsure of, its effects' parameters, by their own σ; the same in all recordings."""
        for entry in self.scenes[0].model.effects:
            for name in (name for name, parameter in entry.parameters.items() if parameter.sigma):
                changes = [parameter_change(scene, entry, name) for scene in self.scenes]
                raw = [((s, c), change[:, c]) for s, change in enumerate(changes) for c in range(6)]
                if (column := self.add_column(raw)) is not None:
                    self.nuisance.append((column, 1.0))

    def _add_nuisance(self, index: int, turns: Sequence[_TurnColumns]) -> None:
        """What the reference itself is unsure of, by its own σ; what it does not give is free."""
        scene, reference = self.scenes[index], self.scenes[index].recording.meta.reference
        degree = math.radians(1.0)
        azimuth = reference.azimuth_sigma_deg if reference.azimuth_deg is not None else 180.0
        if azimuth:
            self._always(index, setup_difference(scene, "azimuth_error", "all", 1e-3) / 1e-3, azimuth * degree)
        level = reference.level_sigma_deg if reference.level_given else 5.0
        if level:
            rides = float(reference.level_frame == "body")
            for axis in range(2):
                tilt = tuple(TILT_RAD * (k == axis) for k in range(2))
                self._always(index, _tilted(scene, tilt, rides) / TILT_RAD, level * degree)
        if turns:
            offset = self._always(index, all_late(scene, [one.error for one in turns]), TIMING_SIGMA_S)
            starts, ends = (
                tuple(tuple(self._keep(column) for column in late) for late in lates)
                for lates in ([one.starts for one in turns], [one.ends for one in turns])
            )
            self.nuisance += [(i, TIMING_SIGMA_S) for late in (*starts, *ends) for i in late]
            at_s = (*(one.error.turn.start_s for one in turns), *(one.error.turn.end_s for one in turns))
            known = bool(scene.lateness_s) and is_whole(scene, [one.error for one in turns])
            self.schedules[index] = Schedule(offset, starts, ends, at_s if known else ())
        for one in turns:
            motion = scene.recording.meta.motion[_place_in_meta(scene, one.error.turn)]
            sigma = motion.angle_sigma_deg if isinstance(motion, TurnMeta) else None
            if sigma and one.angle is not None:
                self.nuisance.append((self._keep(one.angle), sigma * degree))
        for change, spread in lost_vibration(scene):
            self._always(index, change, spread)
        for channel, course, spread in hidden_courses(scene):
            column = Column({(index, channel): self._weighted(index, channel, course)})
            self.nuisance.append((self._keep(column), spread))
        self.ends |= {(index, channel): [self._keep(Column({})) for _ in range(2)] for channel in GYROS}

    def _always(self, index: int, change: Array, sigma: float) -> int | None:
        column = self.add_column(_of(index, change))
        if column is not None:
            self.nuisance.append((column, sigma))
        return column

    def _add_generic(self, channel: int) -> None:
        by_name: dict[str, list[list[tuple[Slot, Array]]]] = {}
        for s, scene in enumerate(self.scenes):
            for name, values in generic_columns(scene, channel):
                raw = by_name.setdefault(name, [[] for _ in values.T])
                for column, of_scene in zip(raw, values.T, strict=True):
                    column.append(((s, channel), of_scene))
        for name, raw in by_name.items():
            if self._only is None or (name, CHANNELS[channel]) in self._only:
                self.add(Kind.EMPIRICAL, name, CHANNELS[channel], raw)


def is_usual(shape: Mapping[str, float]) -> bool:
    """Whether a coefficient is counted from where coefficients are counted from."""
    return all(value in USUAL[name] for name, value in shape.items() if name in USUAL)


_SPARSE = {"size_effect", "level_error"}
"""Effects of which a column may have nothing to say."""
_REFERENCE = {
    "turn_timing": ("timing",),
    "turn_angle": ("angle",),
    "turn_timing_and_angle": ("timing", "angle"),
    "turn_axis": ("axis",),
    "turn_motion": ("timing", "angle", "axis"),
    "lever_arm": ("lever",),
}
_PARALLEL = 1e-9  # share of a column by which another may be off a multiple of it, for rounding


def _thinned(inputs: Array) -> tuple[Array, Array]:
    """Return inputs in order of size, those in the middle thinned out, and for how many each stands."""
    ordered = np.sort(inputs)
    low, middle, high = np.split(ordered, [EXTREME, max(len(ordered) - EXTREME, EXTREME)])
    kept = middle[::THINNED]
    weight = np.concatenate([np.ones(len(low)), np.full(len(kept), float(THINNED)), np.ones(len(high))])
    return np.concatenate([low, kept, high]), weight


def _delays(scene: Scene, effect: str) -> list[float]:
    """Return sizes of a delay or a clock's error to try."""
    unit = scene.seen.interval_s
    if effect == "clock_scale":
        unit /= float(scene.data.edges_s[-1] - scene.data.edges_s[0])
    return [factor * unit for factor in DELAY_SAMPLES]


def _of(index: int, change: Array) -> list[tuple[Slot, Array]]:
    """Return a change of all readings (n, 6) by slot."""
    return [((index, c), change[:, c]) for c in range(6)]


def _place_in_meta(scene: Scene, turn: Turn) -> int:
    return next(i for i, m in enumerate(scene.recording.meta.motion) if m.start_s == turn.start_s)


def _tilted(scene: Scene, tilt: tuple[float, ...], rides: float) -> Array:
    """Return what a level error of two tilts [rad] makes of the prediction, less it (n, 6)."""
    values = {"tilt_1": tilt[0], "tilt_2": tilt[1], "rides": rides}
    setup = get_effect("level_error").arrange(scene.setup, Occasion("all", values, 1.0))
    return scene.predict(setup) - scene.predicted


def _chords(
    scene: Scene, effect: str, channel: str, sizes: tuple[float, ...], shape: Mapping[str, float]
) -> list[Array]:
    """Return columns (n, 6) of a set-up effect, which at amplitudes ``sizes`` add up to what it makes there."""
    if effect != "level_error":
        return [setup_difference(scene, effect, channel, sizes[0]) / sizes[0]]
    first, both = (_tilted(scene, (sizes[0], second), shape["rides"]) for second in (0.0, sizes[1]))
    return [first / sizes[0], (both - first) / sizes[1]]


def setup_difference(scene: Scene, effect: str, channel: str, size: float) -> Array:
    """Return what an error of ``size`` in set-up or timing makes of the prediction, less it (n, 6)."""
    found = get_effect(effect)
    edges = scene.data.edges_s
    if effect == "latency":
        change = scene.predict(scene.setup, edges - size) - scene.predicted
        if channel == "accel":
            change[:, 3:] = 0.0
        elif channel == "gyro":
            change[:, :3] = 0.0
        return change
    if effect == "clock_scale":
        return scene.predict(scene.setup, edges / (1.0 + size)) - scene.predicted
    assert found.stage is Stage.SETUP
    setup = found.arrange(scene.setup, Occasion(channel, {found.parameters[0].name: size}, 1.0))
    return scene.predict(setup) - scene.predicted
