"""One hidden case from a seed and a number: circumstances, what is hidden, how large, and the readings of it."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.fft import dct

from benchmarks._blind import hidden, oracle, plans, strange
from benchmarks._blind.dictionary import columns, lines
from benchmarks._blind.hidden import Effect
from benchmarks._blind.motion import Setup, add_sway
from benchmarks._blind.noise import Spectrum, quantise, sway
from benchmarks._blind.plans import Plan
from benchmarks._blind.world import CHANNELS, World, index

FAMILIES = ("reference", "gauss_markov", "heavy_tails", "noise_level", "near_copy", "gaps")
"""Where the prototype failed; ``plain`` is none of them."""
SIZES = (5.0, 7.0, 10.0, 15.0, 25.0, 50.0, 80.0)
OUTSIDE_SIZES = (15.0, 30.0, 60.0, 120.0)
LENGTHS_S = (150.0, 200.0, 300.0)
CERTAIN = 1e4
"""d of what shows in the frame numbers themselves."""

_TRIES, _TRIES_EACH = 80, 10
_SWAYS = 30  # draws
_STRANGE_SHARE = 0.35
"""Share of a strange effect's length that the two best library columns together may not explain, at least."""
_MOVING = {"motion": ("positions", "turns", "tour")}
_TURNING = {"motion": ("turns", "tour")}
_WISHES: dict[str, dict[str, tuple[str, ...]]] = {  # circumstances in which an effect can be told at all
    "bias_temperature": {"climate": ("ramp", "up_down")},
    "thermal_lag": {"climate": ("ramp", "up_down")},
    "scale_temperature": {"climate": ("ramp", "up_down"), "motion": ("positions", "turns", "tour")},
    "supply_sensitivity": {"supply": ("steps",)},
    "vibration_rectification": {"motion": ("vibration",)},
    "scale_factor": _MOVING,
    "scale_asymmetry": _MOVING,
    "misalignment": _MOVING,
    "g_sensitivity": _MOVING,
    "g2_sensitivity": _MOVING,
    "latency": _MOVING,
    "clock_scale": _MOVING,
    "level_error": _MOVING,
    "scale_quadratic": _TURNING,
    "scale_cubic": _TURNING,
    "size_effect": _TURNING,
    "saturation": _TURNING,
}
_TWISTS = {  # how far off its library form a near-copy is
    "bias_step": (0.3, 1.5),
    "drift": (0.05, 0.2),
    "turn_on_transient": (0.05, 0.2),
    "bias_temperature": (0.001, 0.005),
    "scale_quadratic": (0.02, 0.1),
    "scale_cubic": (0.02, 0.1),
    "vibration_rectification": (0.1, 0.5),
    "sinusoid": (0.05, 0.3),
}
_NOISE_NAMES = (*hidden.NOISE, "quantisation")


class Redraw(Exception):
    """These circumstances cannot show what was to be hidden."""


@dataclass
class Case:
    """A recording's content, the model that lacks something, and the sealed truth."""

    stamps: np.ndarray
    sequence: np.ndarray
    readings: np.ndarray  # rates (n, 6)
    intervals: np.ndarray
    temperature: np.ndarray
    supply: np.ndarray
    stated: Setup
    height: float
    surveyed: bool
    plan: Plan
    model: dict[str, Any]
    truth: dict[str, Any] = field(default_factory=dict)


def category_of(number: int) -> str:
    """Strata: of every five cases three inside the library, one with nothing hidden, one outside."""
    return ("inside", "inside", "inside", "null", "outside")[number % 5]


def make(seed: int, number: int) -> Case:
    """Draw a case until its circumstances can show what it hides."""
    for attempt in range(_TRIES):
        rng = np.random.default_rng([seed, number, attempt])
        fixed = np.random.default_rng([seed, number, _TRIES + attempt // _TRIES_EACH])
        try:
            return _Draft(rng, fixed, seed, number, attempt // _TRIES_EACH).case()
        except Redraw:
            continue
    raise RuntimeError(f"case {number} of seed {seed} could not be drawn")


def _turn_of(seed: int, number: int, names: list[str], salt: int) -> str:
    """Walk through names in an order of the seed's own, so that each comes equally often."""
    lap, place = divmod(number, len(names))
    return names[np.random.default_rng([seed, salt, lap]).permutation(len(names))[place]]


class _Draft:
    """A case on its way. ``fixed`` decides what is to be hidden; ``skipped`` counts the names given up before."""

    def __init__(
        self, rng: np.random.Generator, fixed: np.random.Generator, seed: int, number: int, skipped: int
    ) -> None:
        self.rng, self.number, self.category = rng, number, category_of(number)
        self._decide(fixed, seed, 7 * skipped)
        self.length = float(rng.choice(LENGTHS_S))
        self.plan = self._plan()
        stated, self.height, self.surveyed = plans.stated_setup(rng, self.plan, self.length)
        self.stated = plans.before_vibration(stated)
        self.true = plans.true_setup(rng, self.plan, self.stated, loose=self.family == "reference")
        self.world = plans.world_of(rng, self.plan, self.true, self.length)
        self.believed = plans.noise_of(rng, self.plan.kind)
        self.spectra, self.allowed = self._true_noise()
        self.sway = (
            (float(rng.uniform(5e-6, 30e-6)), float(rng.uniform(0.1, 1.0))) if self.family == "reference" else None
        )
        self._calibration()
        self.metric = self._metric()

    def _decide(self, fixed: np.random.Generator, seed: int, skip: int) -> None:
        lap, place = divmod(self.number, 5)
        self.names: list[str] = []
        share = {"inside": 0.35, "null": 0.6, "outside": 0.2}[self.category]
        families = [f for f in FAMILIES if self.category == "inside" or f != "near_copy"]
        self.family = str(fixed.choice(families)) if fixed.random() < share else "plain"
        if self.category == "inside":
            self.names = [_turn_of(seed, 3 * lap + place + skip, hidden.EFFECTS, 1)]
            if self.family == "near_copy":
                self.names = [str(fixed.choice(list(_TWISTS)))]
            elif self.family == "plain" and self.names[0] in hidden.SENSOR and fixed.random() < 0.5:
                more = [name for name in hidden.SENSOR if name != self.names[0]]
                self.names += [str(name) for name in fixed.choice(more, fixed.integers(1, 3), replace=False)]
            if self.names[0] in (*hidden.NOISE, "quantisation", "lost_samples") and self.family != "plain":
                self.family = "plain"
            weights = np.array([1, 1, 2, 2, 2, 2, 2]) / 12
            self.sizes = [float(fixed.choice(SIZES, p=weights)) for _ in self.names]
            if len(self.names) > 1:
                self.sizes = [max(size, 10.0) for size in self.sizes]
            if self.family == "near_copy":
                self.sizes = [float(fixed.choice([10.0, 15.0, 25.0, 40.0]))]
        elif self.category == "outside":
            self.names = [_turn_of(seed, lap + skip, strange.STRANGE, 2)]
            self.sizes = [float(fixed.choice(OUTSIDE_SIZES))]

    def _plan(self) -> Plan:
        wanted: dict[str, str] = {}
        for name in self.names:
            strict = len(self.names) > 1 or self.rng.random() < 0.85
            for what, among in _WISHES.get(name, {}).items():
                if strict:
                    wanted[what] = str(self.rng.choice(among))
        if self.category == "outside":
            among = (
                ["turns", "tour"] if self.names[0] in strange.NEEDS_TURNS else ["rest", "positions", "turns", "tour"]
            )
            wanted["motion"] = str(self.rng.choice(among))
        if self.family == "reference" and "vibration" not in wanted.values():
            wanted.setdefault("motion", str(self.rng.choice(["positions", "turns", "tour"])))
        drawn = plans.plan(self.rng, **wanted)
        if self.family == "reference":
            drawn.sigma["angle"] *= 20
        return drawn

    def _true_noise(self) -> tuple[list[Spectrum], list[list[str]]]:
        """Spectra as they are, and the names of noise that may rightly be given."""
        spectra, rng = list(self.believed), self.rng
        groups = [[0, 1, 2], [3, 4, 5], list(range(6)), *[[i] for i in range(6)]]
        touched: list[int] = []
        if self.family == "gauss_markov":
            touched = sorted(int(i) for i in rng.choice(6, rng.integers(1, 4), replace=False))
            for i in touched:
                constant = float(np.exp(rng.uniform(0, np.log(200))))
                sigma = spectra[i].white / math.sqrt(2 * constant) * float(np.exp(rng.uniform(np.log(0.7), np.log(4))))
                spectra[i] = replace(spectra[i], markov_sigma=sigma, markov_s=constant)
        elif self.family == "noise_level":
            touched = groups[rng.integers(len(groups))]
            factor = float(rng.choice([3.0, 3.0, 1 / 3]))
            for i in touched:
                spectra[i] = replace(spectra[i], white=spectra[i].white * factor)
        elif self.family == "reference":
            touched = list(range(6))
        return spectra, [[name, CHANNELS[i]] for i in touched for name in _NOISE_NAMES]

    def _calibration(self) -> None:
        """Model's calibration, known biases with their σ, and whether it declares its noise free."""
        rng = self.rng
        noisy = any(name in _NOISE_NAMES for name in self.names)
        self.free = bool(rng.integers(2)) and not noisy
        used = rng.random() < 0.5
        self.scale = 1 + (rng.normal(0, 1e-3, 6) if used else np.zeros(6))
        self.bias = np.repeat([3e-3, 1e-6], 3) * (rng.normal(size=6) if used else np.zeros(6))
        self.known: list[tuple[int, float, float, float]] = []  # channel, value, sigma, truth
        if rng.random() < 0.2:
            channel = int(rng.integers(6))
            value = float(rng.normal(0, 3e-3 if channel < 3 else 3e-6))
            sigma = abs(value) * 0.02
            self.known.append((channel, value, sigma, float(rng.normal(value, sigma))))

    def _metric(self) -> oracle.Metric:
        extra = None if self.sway is None else self._sway_density
        return oracle.Metric(self.world, self.spectra, extra).beside(self._nuisance())

    def _nuisance(self, late: tuple[float, float] = oracle.ONE_SIGMA) -> list[np.ndarray]:
        priors = [(channel, sigma) for channel, _, sigma, _ in self.known]
        return oracle.nuisance(self.world, self.plan.sigma, self.plan.level_frame == "body", priors, late)

    def case(self) -> Case:
        noise = self._noise()
        effects, d = self._effects(noise)
        odd, odd_facts = self._odd()
        sent = self._to_be_sent(noise)
        readings, stamps = self._readings(effects, odd, noise)
        keep = self._kept(effects)
        clock = next((e.parameters["error"] for e in effects if e.name == "clock_scale"), 0.0)
        case = Case(
            stamps=stamps[keep],
            sequence=np.flatnonzero(keep),
            readings=readings[keep],
            intervals=np.full(int(keep.sum()), self.world.dt),
            temperature=np.round(self.world.temperature[keep] * 256) / 256,
            supply=np.round(self.world.supply[keep], 3),
            stated=self.stated,
            height=self.height,
            surveyed=self.surveyed,
            plan=self.plan,
            model=self._model(),
        )
        allowed = list(self.allowed)
        if not keep.all():
            allowed.append(["lost_samples", "all"])
        case.truth = {
            "number": self.number,
            "category": self.category,
            "family": self.family,
            "effects": [_entry(e, size, self._got(e, sent, readings)) for e, size in zip(effects, d, strict=True)],
            "allowed": allowed,
            "motion": self.plan.motion,
            "climate": self.plan.climate,
            "kind": self.plan.kind,
            "free": self.free,
            "length_s": self.length,
            "clock": clock,
            **odd_facts,
        }
        return case

    def _noise(self) -> np.ndarray:
        rng, world = self.rng, self.world
        tails = str(rng.choice(["student", "outliers"])) if self.family == "heavy_tails" else ""
        return np.column_stack([s.sample(rng, world.count, world.dt, tails=tails) for s in self.spectra])

    # --- what is hidden ------------------------------------------------------------------------------------------

    def _effects(self, noise: np.ndarray) -> tuple[list[Effect], list[float]]:
        if self.category != "inside":
            return [], []
        effects, d, shifts = [], [], []
        for name, wanted in zip(self.names, self.sizes, strict=True):
            effect = hidden.draw(self.rng, name, self.world)
            if name == "saturation":
                effect = hidden.with_limit(effect, self._noiseless(self.world.inputs))
            if self.family == "near_copy":
                sign = 1 if name in ("bias_step", "vibration_rectification") else self.rng.choice([-1, 1])
                effect = replace(effect, twist=float(sign * self.rng.uniform(*_TWISTS[name])))
            effect, size = self._sized(effect, wanted, noise)
            effects.append(effect)
            d.append(size)
            if len(self.names) > 1:
                shifts.append(self.metric.project(self.metric.whiten(hidden.sensor_shift(effect, self.world))))
        for i, one in enumerate(shifts):
            for other in shifts[:i]:
                if abs(one @ other) > 0.6 * np.linalg.norm(one) * np.linalg.norm(other):
                    raise Redraw
        if len({(e.name, e.channel) for e in effects}) < len(effects):
            raise Redraw
        return effects, d

    def _sized(self, effect: Effect, wanted: float, noise: np.ndarray) -> tuple[Effect, float]:
        """Scale an effect to a wanted d."""
        name = effect.name
        if name == "lost_samples":
            return effect, CERTAIN
        measure = self._measure(effect, noise)
        if not effect.sized:  # wiring, and saturation, which is large as soon as it touches a plateau
            size = measure(effect)
            if size < 10:
                raise Redraw
            return effect, size
        if name in hidden.SENSOR:
            return self._believable(effect, wanted, measure(effect))
        if name == "quantisation":
            usual = self.believed[index(effect.channel)].quantisation
            effect = effect.times(1.5 * usual / effect.size)
            found, size = _search(effect, wanted, measure, 20 * effect.size)
            if found.size < 1.02 * usual:
                raise Redraw
            return found, size
        return _search(effect, wanted, measure, self._limit(effect))

    def _believable(self, effect: Effect, wanted: float, size: float) -> tuple[Effect, float]:
        if size * self._limit(effect) / effect.size < wanted or size == 0.0:
            raise Redraw
        return effect.times(wanted / size), wanted

    def _limit(self, effect: Effect) -> float:
        pair = hidden.LARGEST.get(effect.name)
        if effect.name == "stuck_samples":
            return 20.0
        if effect.name == "dead_band":
            return 0.3 if effect.channel in hidden.ACCELS else 0.01
        if pair is None:
            return math.inf
        return pair[0] if effect.channel.startswith(("accel", "all")) else pair[1]

    def _measure(self, effect: Effect, noise: np.ndarray) -> Callable[[Effect], float]:
        """Return the function of an effect that gives its d."""
        if effect.name in _NOISE_NAMES:
            channel = index(effect.channel)
            return lambda e: self.metric.noise_size(channel, _noisier(self.spectra[channel], e))
        shift = self._shift(effect, self._to_be_sent(noise))
        return lambda e: self._beside(e).size(shift(e))

    def _shift(self, effect: Effect, sent: np.ndarray) -> Callable[[Effect], np.ndarray]:
        """Return the function of an effect that gives what it adds to the readings (n, 6) in the mean.

        ``sent`` (n, 6): what would be sent with nothing hidden.
        """
        world, name = self.world, effect.name
        if name in hidden.SENSOR:
            return lambda e: hidden.sensor_shift(e, world)
        if name == "latency":
            still = self._unshaken()
            return lambda e: hidden.delayed(e, still) - still.inputs
        if name == "clock_scale":
            return lambda e: self._clock_shift(e.parameters["error"])
        if name in hidden.SETUP:
            return lambda e: world.inputs_of(world.moved(**hidden.setup_of(e, world))) - world.inputs
        if name in ("axis_swap", "sign_flip", "unit_error"):
            return lambda e: hidden.reframe(e, world, world.inputs) - world.inputs
        noiseless, channel = self._noiseless(world.inputs), index(effect.channel)
        if name == "stuck_samples":
            return lambda e: hidden.stuck_shift(e, world, sent, noiseless)
        sigma = self.spectra[channel].white / math.sqrt(world.dt)
        if self.sway is not None:  # which nobody knows sample by sample either
            sigma = math.hypot(sigma, float(np.std(self._sway(self.rng.spawn(1)[0])[:, channel])))
        return lambda e: hidden.mean_read_out(e, world, noiseless, sigma)

    def _beside(self, effect: Effect) -> oracle.Metric:
        """What it is measured by: a delay or a clock's error beside turns that may have been late by as much."""
        if effect.name == "latency":
            return self.metric.beside(self._nuisance((effect.parameters["delay"], 0.0)))
        if effect.name == "clock_scale":
            # The wrong clock's samples begin where they do; those of a table that was late would begin so much before.
            return self.metric.beside(self._nuisance((0.0, -effect.parameters["error"])))
        return self.metric

    def _got(self, effect: Effect, sent: np.ndarray, readings: np.ndarray) -> float:
        """d of an effect as an oracle gets it of these readings (n, 6): the root of their own likelihood ratio.

        ``sent`` (n, 6): what would have been sent with nothing hidden. The square is d² in the mean over noise.
        """
        if effect.name == "lost_samples":
            return CERTAIN
        if effect.name in _NOISE_NAMES:
            channel = index(effect.channel)
            left = (readings - self._noiseless(self.world.inputs))[:, channel]
            return self.metric.noise_got(channel, _noisier(self.spectra[channel], effect), left)
        off = [(truth - value, sigma) for _, value, sigma, truth in self.known]
        errors = oracle.errors_of(self.true, self.stated, self.plan.sigma, self.plan.level_frame == "body", off)
        noise = sent - self._noiseless(self._unshaken().inputs)
        return self._beside(effect).got(self._shift(effect, sent)(effect), noise, errors)

    def _clock_shift(self, error: float) -> np.ndarray:
        fast = self._unshaken()
        return fast.inputs / (1 + error) - fast.inputs_of(fast.setup, fast.edges * (1 + error))

    def _unshaken(self) -> World:
        """The world without its vibrations: of a course that nobody knows nobody knows how late it is."""
        return replace(self.world, setup=replace(self.world.setup, shakes=()))

    def _odd(self) -> tuple[np.ndarray | None, dict[str, Any]]:
        """A strange effect on one channel, of the wanted d, most of it beyond any library name."""
        if self.category != "outside":
            return None, {}
        channel = str(self.rng.choice(CHANNELS))
        form = strange.shape(self.names[0], channel, self.world, self.rng)
        shift = np.zeros((self.world.count, 6))
        shift[:, index(channel)] = form
        size = self.metric.size(shift)
        if not size > 0:
            raise Redraw
        shift *= self.sizes[0] / size
        if np.abs(shift).max() > (0.3 if channel in hidden.ACCELS else 0.01):
            raise Redraw
        left = self._unexplained(index(channel), shift[:, index(channel)])
        if left < _STRANGE_SHARE:
            raise Redraw
        facts = {
            "strange": self.names[0],
            "strange_channel": channel,
            "d": self.sizes[0],
            "d_unexplained": left * self.sizes[0],
        }
        return shift, facts

    def _unexplained(self, channel: int, form: np.ndarray) -> float:
        """Share of a shape's length that the best two library columns leave."""
        _, table = columns(self.world, channel)
        wide = np.zeros((self.world.count, 6))

        def whiten(column: np.ndarray) -> np.ndarray:
            wide[:, channel] = column
            return self.metric.channel(self.metric.whiten(wide), channel)

        J = np.array([self.metric.channel(row, channel) for row in self.metric.nuisance])
        target = whiten(form)
        table = np.hstack([table, lines(form, target, self.world)])
        left = oracle.project(target, J)
        whole = np.linalg.norm(left)
        basis = oracle.project(np.array([whiten(column) for column in table.T]), J)
        basis /= np.maximum(np.linalg.norm(basis, axis=1, keepdims=True), 1e-30)
        return float(math.sqrt(max(1 - _best_pair(basis, left / whole), 0.0)))

    # --- readings ------------------------------------------------------------------------------------------------

    def _readings(
        self, effects: list[Effect], odd: np.ndarray | None, noise: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rates (n, 6) as the block sends them, and their time stamps."""
        world, rng = self.world, self.rng
        setup = world.setup
        for effect in effects:
            if effect.name in hidden.SETUP and effect.name not in ("latency", "clock_scale"):
                setup = replace(setup, **hidden.setup_of(effect, world))
        inputs = world.inputs if setup is world.setup else world.inputs_of(setup)
        for effect in effects:
            if effect.name == "latency":
                inputs = hidden.delayed(effect, world)
        if self.sway is not None:
            inputs = self._swayed(inputs)
        out = self._noiseless(inputs)
        for effect in effects:
            if effect.name in hidden.SENSOR:
                out += hidden.sensor_shift(effect, world)
            if effect.name in hidden.NOISE:
                channel = index(effect.channel)
                more = _noisier(Spectrum(), effect)
                out[:, channel] += more.sample(rng, world.count, world.dt)
        out += noise if odd is None else noise + odd
        for effect in effects:
            if effect.name in ("dead_band", "saturation"):
                out = hidden.read_out(effect, world, out)
        coarse = {index(e.channel): e.parameters["step"] for e in effects if e.name == "quantisation"}
        for channel in range(6):
            step = coarse.get(channel, self.believed[channel].quantisation)
            out[:, channel] = quantise(out[:, channel], world.dt, step, rng.random())
        for effect in effects:
            if effect.name in hidden.FRAME:
                out = hidden.reframe(effect, world, out)
        stamps = world.edges[1:]
        for effect in effects:
            if effect.name == "clock_scale":
                stamps = stamps * (1 + effect.parameters["error"])
        return out, stamps

    def _to_be_sent(self, noise: np.ndarray) -> np.ndarray:
        """Return the rates (n, 6) that the block would send with nothing hidden in them, drawing no numbers for it."""
        later = copy.copy(self)
        later.rng = copy.deepcopy(self.rng)
        return later._readings([], None, noise)[0]

    def _noiseless(self, inputs: np.ndarray) -> np.ndarray:
        """Readings (n, 6) of inputs by the calibration and the biases that are known, nothing hidden in them."""
        out = (inputs - self.bias) / self.scale
        for channel, _, _, truth in self.known:
            out[:, channel] += truth
        return out

    def _sway_density(self, frequency: np.ndarray) -> np.ndarray:
        """Two-sided spectra (6, n) of what sway adds, in the mean over draws: turns carry it to where it has no power.

        A mount at rest comes back, but a block that has been turned meanwhile feels it come back about another axis.
        """
        world, rng = self.world, self.rng.spawn(1)[0]
        power = np.zeros((6, world.count))
        for _ in range(_SWAYS):
            power += dct(self._sway(rng), axis=0, norm="ortho").T ** 2 / _SWAYS
        bounds = np.unique(np.concatenate([np.arange(40), np.geomspace(40, world.count, 60).astype(int)]))
        level = np.add.reduceat(power, bounds[:-1], axis=1) / np.diff(bounds) * world.dt
        middle = 0.5 * (bounds[:-1] + bounds[1:] - 1) / (2 * world.count * world.dt)
        return np.array([np.interp(frequency, middle, one) for one in level])

    def _sway(self, rng: np.random.Generator) -> np.ndarray:
        """What one draw of the mount's small angles adds to the inputs (n, 6)."""
        world, (sigma, constant) = self.world, self.sway
        psi = np.column_stack([sway(rng, world.count + 1, world.dt, sigma, constant) for _ in range(3)])
        dv, dtheta = np.zeros((world.count, 3)), np.zeros((world.count, 3))
        add_sway(dv, dtheta, world.attitude, psi, world.setup.gravity, world.dt)
        return np.hstack([dv, dtheta]) / world.dt

    def _swayed(self, inputs: np.ndarray) -> np.ndarray:
        """Inputs with the mount's small angles, of which the stated level is the mean."""
        return inputs + self._sway(self.rng)

    def _kept(self, effects: list[Effect]) -> np.ndarray:
        """Which frames arrive."""
        keep = np.ones(self.world.count, bool)
        for effect in effects:
            if effect.name == "lost_samples":
                keep &= self.rng.random(self.world.count) >= effect.parameters["fraction"]
        if self.family == "gaps":
            keep &= self.rng.random(self.world.count) >= 0.002
            for start in self.rng.integers(100, self.world.count - 400, self.rng.integers(1, 6)):
                keep[start : start + int(np.exp(self.rng.uniform(np.log(3), np.log(200))))] = False
        keep[[0, -1]] = True
        return keep

    def _model(self) -> dict[str, Any]:
        """The document block.json, which lacks what is hidden."""
        calibration, noise = {}, {}
        off = np.exp(self.rng.uniform(np.log(0.5), np.log(2))) if self.free else 1.0
        for i, name in enumerate(CHANNELS):
            unit = "bias_mps2" if i < 3 else "bias_radps"
            scale = float(self.scale[i])
            calibration[name] = {"scale_positive": scale, "scale_negative": scale, unit: float(self.bias[i])}
            s = self.believed[i]
            noise[name] = {
                "white": s.white * off,
                "flicker": s.flicker * off,
                "random_walk": s.random_walk * off,
                "quantisation": s.quantisation,
            }
        effects = []
        for channel, value, sigma, _ in self.known:
            unit = "m/s^2" if channel < 3 else "rad/s"
            shift = {"value": value, "sigma": sigma, "unit": unit}
            effects.append({"effect": "bias_shift", "channel": CHANNELS[channel], "parameters": {"shift": shift}})
        return {
            "schema": "inertrim/block/1",
            "block": f"case {self.number}",
            "gyro_kind": self.plan.kind,
            "calibration": calibration,
            "noise": {**noise, "free": self.free},
            "effects": effects,
        }


def _best_pair(basis: np.ndarray, target: np.ndarray) -> float:
    """Share of a target's (n,) square that the best two of m directions (m, n) explain together, all of length one."""
    alike, along = basis @ basis.T, basis @ target
    apart = 1 - alike**2
    both = along[:, None] ** 2 + along**2 - 2 * alike * np.outer(along, along)
    return float(np.max(np.where(apart > 1e-6, both / np.maximum(apart, 1e-6), along[:, None] ** 2)))


def _noisier(spectrum: Spectrum, effect: Effect) -> Spectrum:
    """Noise with an effect's added in power; a coarser step replaces the step."""
    if effect.name == "quantisation":
        return replace(spectrum, quantisation=effect.parameters["step"])
    key = {"random_walk": "white", "bias_instability": "flicker", "rate_random_walk": "random_walk"}[effect.name]
    return replace(spectrum, **{key: math.hypot(getattr(spectrum, key), effect.parameters["coefficient"])})


def _search(effect: Effect, wanted: float, measure: Callable[[Effect], float], limit: float) -> tuple[Effect, float]:
    """Find the multiple of an effect whose d is as wanted, within 3 %, by secants in the logarithm."""
    factor, previous = 1.0, None
    for _ in range(25):
        size = measure(effect.times(factor))
        if size > 0 and abs(size / wanted - 1) < 0.03:
            if effect.size * factor > limit:
                raise Redraw
            return effect.times(factor), size
        slope = 1.0
        if size > 0 and previous is not None and previous[1] > 0 and size != previous[1]:
            slope = float(np.clip(np.log(size / previous[1]) / np.log(factor / previous[0]), 0.4, 4.0))
        previous = (factor, size)
        step = (wanted / size) ** (1 / slope) if size > 0 else 8.0
        factor *= float(np.clip(step, 1 / 8, 8))
        if effect.size * factor > 20 * limit:
            break
    raise Redraw


def _entry(effect: Effect, size: float, got: float) -> dict[str, Any]:
    """What the truth says of one effect, parameters as `docs/effects.md` names them."""
    return {
        "effect": effect.name,
        "channel": effect.channel,
        "parameters": dict(effect.parameters),
        "twist": effect.twist,
        "d": size,
        "d_got": got,
    }
