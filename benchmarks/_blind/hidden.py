"""Every effect of the library's list, written anew by closed form from what `docs/effects.md` says of it.

An effect is drawn with a direction and a unit size; the caller finds the multiple that is as large, in σ, as wanted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter
from scipy.special import ndtri

from benchmarks._blind.noise import quantise
from benchmarks._blind.world import CHANNELS, World, index

Parameters = dict[str, float]
ACCELS, GYROS = CHANNELS[:3], CHANNELS[3:]
SENSOR = ["bias_shift", "bias_step", "drift", "turn_on_transient", "bias_temperature", "scale_temperature"]
SENSOR += ["thermal_lag", "scale_factor", "scale_asymmetry", "scale_quadratic", "scale_cubic", "misalignment"]
SENSOR += [
    "g_sensitivity",
    "g2_sensitivity",
    "vibration_rectification",
    "size_effect",
    "sinusoid",
    "supply_sensitivity",
]
SETUP = ["azimuth_error", "level_error", "latitude_error", "gravity_error", "latency", "clock_scale"]
READOUT = ["dead_band", "saturation", "quantisation"]
FRAME = ["axis_swap", "sign_flip", "unit_error", "stuck_samples", "lost_samples"]
NOISE = ["random_walk", "bias_instability", "rate_random_walk"]
EFFECTS = [*SENSOR, *SETUP, *READOUT, *FRAME, *NOISE]

_QUANTILES = 101
"""Of the noise, each as likely."""

LARGEST = {  # the most that is believable, at about three times the typical range: accelerometer, gyro
    "bias_shift": (0.1, 2e-4),
    "bias_step": (0.1, 2e-4),
    "drift": (3e-4, 3e-7),
    "turn_on_transient": (0.15, 3e-4),
    "bias_temperature": (0.03, 1.5e-5),
    "scale_temperature": (3e-3, 3e-3),
    "thermal_lag": (0.03, 1.5e-5),
    "scale_factor": (0.03, 0.03),
    "scale_asymmetry": (0.015, 0.015),
    "scale_quadratic": (3e-4, 0.3),
    "scale_cubic": (3e-5, 30.0),
    "misalignment": (0.03, 0.03),
    "g_sensitivity": (0.0, 3e-4),
    "g2_sensitivity": (0.0, 3e-6),
    "vibration_rectification": (3e-3, 3e-5),
    "size_effect": (0.3, 0.0),
    "sinusoid": (0.15, 3e-3),
    "supply_sensitivity": (0.03, 3e-5),
    "azimuth_error": (0.3, 0.3),
    "level_error": (0.03, 0.03),
    "latitude_error": (0.3, 0.3),
    "gravity_error": (0.03, 0.03),
    "latency": (0.2, 0.2),
    "clock_scale": (0.05, 0.05),
}


@dataclass(frozen=True)
class Effect:
    """A hidden effect: its size is in the parameters named in ``sized``; ``twist`` bends its law a little."""

    name: str
    channel: str
    parameters: Parameters
    sized: tuple[str, ...]
    twist: float = 0.0

    def times(self, factor: float) -> Effect:
        """The same, larger."""
        changed = {key: value * factor if key in self.sized else value for key, value in self.parameters.items()}
        return Effect(self.name, self.channel, changed, self.sized, self.twist)

    @property
    def size(self) -> float:
        """Largest of the sized parameters."""
        return max((abs(self.parameters[key]) for key in self.sized), default=0.0)


def draw(rng: np.random.Generator, name: str, world: World) -> Effect:
    """Draw channel, direction and inner parameters of an effect at a small unit size."""
    sensor = str(rng.choice(CHANNELS))
    unit = 1e-4 if sensor in ACCELS else 1e-7
    sign = float(rng.choice([-1, 1]))
    span = world.length
    one: Callable[..., Effect] = lambda key, size, **others: Effect(name, sensor, {key: sign * size, **others}, (key,))  # noqa: E731
    match name:
        case "bias_shift":
            return one("shift", unit)
        case "bias_step":
            return one("step", unit, time=float(rng.uniform(0.15, 0.85) * span))
        case "drift":
            return one("rate", unit / span)
        case "turn_on_transient":
            return one("amplitude", unit, time_constant=float(np.exp(rng.uniform(np.log(6), np.log(span / 3)))))
        case "bias_temperature":
            return one("coefficient", unit / 10, reference=20.0)
        case "thermal_lag":
            return one("coefficient", unit / 10, time_constant=float(np.exp(rng.uniform(np.log(8), np.log(span / 3)))))
        case "scale_temperature":
            return one("coefficient", 1e-6, reference=20.0)
        case "scale_factor" | "scale_asymmetry":
            return one("error", 1e-5)
        case "scale_quadratic":
            return one("coefficient", 1e-6 if sensor in ACCELS else 1e-4)
        case "scale_cubic":
            return one("coefficient", 1e-8 if sensor in ACCELS else 1e-3)
        case "vibration_rectification":
            return one("coefficient", unit / 100)
        case "supply_sensitivity":
            return one("coefficient", unit / 3, nominal=28.0)
        case "sinusoid":
            phase = rng.uniform(0, 2 * np.pi)
            frequency = float(np.exp(rng.uniform(np.log(5 / span), np.log(0.45 / world.dt))))
            parameters = {"cosine": unit * np.cos(phase), "sine": unit * np.sin(phase), "frequency": frequency}
            return Effect(name, sensor, parameters, ("cosine", "sine"))
        case "misalignment":
            triad = ACCELS if sensor in ACCELS else GYROS
            other = rng.choice([channel for channel in triad if channel != sensor])
            return Effect(name, f"{sensor}<-{other}", {"angle": sign * 1e-5}, ("angle",))
        case "g_sensitivity" | "g2_sensitivity":
            pair = f"{rng.choice(GYROS)}<-{rng.choice(ACCELS)}"
            return Effect(name, pair, {"coefficient": sign * 1e-9}, ("coefficient",))
        case "size_effect":
            arm = rng.standard_normal(3)
            arm *= 0.01 / np.linalg.norm(arm)
            arms = {f"arm_{axis}": float(value) for axis, value in zip("xyz", arm, strict=True)}
            return Effect(name, str(rng.choice(ACCELS)), arms, tuple(arms))
        case "azimuth_error" | "latitude_error" | "gravity_error":
            return Effect(name, "all", {"error": sign * 1e-4}, ("error",))
        case "clock_scale":
            return Effect(name, "all", {"error": sign * 1e-6}, ("error",))
        case "level_error":
            angle = rng.uniform(0, 2 * np.pi)
            tilts = {"tilt_1": 1e-5 * np.cos(angle), "tilt_2": 1e-5 * np.sin(angle), "rides": float(rng.integers(2))}
            return Effect(name, "all", tilts, ("tilt_1", "tilt_2"))
        case "latency":
            return Effect(name, str(rng.choice(["accel", "gyro", "all"])), {"delay": 1e-4}, ("delay",))
        case "dead_band":
            return one("half_width", sign * unit)
        case "saturation":
            return Effect(name, sensor, {"depth": float(np.exp(rng.uniform(np.log(1e-4), np.log(0.1))))}, ())
        case "quantisation":
            return one("step", sign * unit * world.dt)
        case "random_walk" | "bias_instability" | "rate_random_walk":
            return one("coefficient", sign * unit / 100)
        case "axis_swap":
            triad = ACCELS if sensor in ACCELS else GYROS
            other = rng.choice([channel for channel in triad if channel != sensor])
            return Effect(name, f"{sensor}<-{other}", {}, ())
        case "sign_flip":
            return Effect(name, sensor, {}, ())
        case "unit_error":
            where = str(rng.choice([*CHANNELS, "accel", "gyro"]))
            factor = 9.80665 if where.startswith("accel") else 180 / np.pi
            return Effect(name, where, {"factor": float(factor ** rng.choice([-1, 1]))}, ())
        case "stuck_samples":
            return Effect(name, sensor, {"start": float(rng.uniform(0.1, 0.8) * span), "duration": 0.1}, ("duration",))
        case "lost_samples":
            return Effect(name, "all", {"fraction": float(np.exp(rng.uniform(np.log(1e-3), np.log(0.03))))}, ())
    raise ValueError(name)


def sensor_shift(effect: Effect, world: World) -> np.ndarray:
    """What a sensor effect adds to the readings (n, 6)."""
    out = np.zeros((world.count, 6))
    target, _, source = effect.channel.partition("<-")
    out[:, index(target)] = _addition(effect, world, world.inputs[:, index(target)], source)
    return out


def _addition(effect: Effect, world: World, x: np.ndarray, source: str) -> np.ndarray:
    p, t, dt, twist = effect.parameters, world.time, world.dt, effect.twist
    match effect.name:
        case "bias_shift":
            return np.full(world.count, p["shift"])
        case "bias_step":
            if twist:  # it takes a moment
                return p["step"] / (1 + np.exp(-np.clip((t - p["time"]) / twist, -60, 60)))
            return p["step"] * np.clip((world.edges[1:] - p["time"]) / dt, 0, 1)
        case "drift":
            return p["rate"] * t * (t / world.length) ** twist
        case "turn_on_transient":
            if twist:  # stretched exponential
                return p["amplitude"] * np.exp(-((t / p["time_constant"]) ** (1 - twist)))
            decay = np.exp(-world.edges / p["time_constant"])
            return p["amplitude"] * p["time_constant"] / dt * -np.diff(decay)
        case "bias_temperature":
            return (
                p["coefficient"]
                * (world.temperature - p["reference"])
                * (1 + twist * (world.temperature - p["reference"]))
            )
        case "scale_temperature":
            return p["coefficient"] * (world.temperature - p["reference"]) * x
        case "thermal_lag":
            keep = np.exp(-dt / p["time_constant"])
            rise = world.temperature - world.temperature[0]
            return p["coefficient"] * (lfilter([1 - keep], [1, -keep], rise) - rise)
        case "scale_factor":
            return p["error"] * x
        case "scale_asymmetry":
            return p["error"] * np.abs(x)
        case "scale_quadratic" | "scale_cubic":
            order = 2 if effect.name == "scale_quadratic" else 3
            largest = np.abs(x).max()
            power = np.sign(x) ** order * largest**order * (np.abs(x) / largest) ** (order * (1 + twist))
            return p["coefficient"] * power
        case "misalignment" | "g_sensitivity":
            return next(v for k, v in p.items() if k in ("angle", "coefficient")) * world.inputs[:, index(source)]
        case "g2_sensitivity":
            return p["coefficient"] * world.inputs[:, index(source)] ** 2
        case "vibration_rectification":
            peak = world.vibration.max() or 1.0
            return p["coefficient"] * peak * (world.vibration / peak) ** (1 - twist)
        case "supply_sensitivity":
            return p["coefficient"] * (world.supply - p["nominal"])
        case "sinusoid":
            w = 2 * np.pi * p["frequency"]
            swell = 1 + twist * np.sin(2 * np.pi * t / world.length)
            wave = p["cosine"] * np.sin(w * world.edges) - p["sine"] * np.cos(w * world.edges)
            return np.diff(wave) / (w * dt) * swell
        case "size_effect":
            rate = world.inputs[:, 3:]
            arm = np.array([p["arm_x"], p["arm_y"], p["arm_z"]])
            spin_up = np.diff(rate, axis=0, prepend=rate[:1]) / dt
            place = np.cross(rate, np.cross(rate, arm)) + np.cross(spin_up, arm)
            return place[:, index(effect.channel)]
    raise ValueError(effect.name)


def setup_of(effect: Effect, world: World) -> dict[str, object]:
    """Changed fields of the set-up."""
    p, setup = effect.parameters, world.setup
    match effect.name:
        case "azimuth_error":
            return {"azimuth": setup.azimuth + p["error"]}
        case "latitude_error":
            return {"latitude": setup.latitude + p["error"]}
        case "gravity_error":
            return {"gravity": setup.gravity + p["error"]}
        case "level_error":
            which = "block_tilt" if p["rides"] else "room_tilt"
            before = getattr(setup, which)
            return {which: (before[0] + p["tilt_1"], before[1] + p["tilt_2"])}
    raise ValueError(effect.name)


def delayed(effect: Effect, world: World) -> np.ndarray:
    """Inputs (n, 6) as they were a moment ago on the delayed channels."""
    columns = {"accel": range(3), "gyro": range(3, 6), "all": range(6)}[effect.channel]
    out = world.inputs.copy()
    out[:, columns] = world.inputs_of(world.setup, world.edges - effect.parameters["delay"])[:, columns]
    return out


def read_out(effect: Effect, world: World, reading: np.ndarray) -> np.ndarray:
    """Readings after a readout effect."""
    out, column = reading.copy(), index(effect.channel)
    x = out[:, column]
    if effect.name == "dead_band":
        out[:, column] = np.where(np.abs(x) < effect.parameters["half_width"], 0.0, x)
    elif effect.name == "saturation":
        out[:, column] = np.clip(x, -effect.parameters["limit"], effect.parameters["limit"])
    else:
        out[:, column] = quantise(x, world.dt, effect.parameters["step"], 0.3)
    return out


def mean_read_out(effect: Effect, world: World, reading: np.ndarray, sigma: float) -> np.ndarray:
    """What a readout effect adds to noiseless readings (n, 6) in the mean over white noise of 1σ in every sample.

    All that somebody who knows the effect can foretell of it: what it does to one sample hangs on that sample's noise.
    """
    column = index(effect.channel)
    draws = sigma * ndtri((np.arange(_QUANTILES) + 0.5) / _QUANTILES)
    total = np.zeros((world.count, 6))
    for error in draws:
        noisy = reading + error
        total[:, column] += (read_out(effect, world, noisy) - noisy)[:, column]
    return total / _QUANTILES


def with_limit(effect: Effect, reading: np.ndarray) -> Effect:
    """A saturation with its limit, ``depth`` below the largest of the noiseless readings (n, 6)."""
    largest = float(np.abs(reading[:, index(effect.channel)]).max())
    return replace(effect, parameters={"limit": largest * (1 - min(effect.parameters["depth"], 0.9))})


def reframe(effect: Effect, world: World, reading: np.ndarray) -> np.ndarray:
    """Readings after a wiring effect or stuck samples (n, 6)."""
    out = reading.copy()
    p = effect.parameters
    match effect.name:
        case "axis_swap":
            first, _, second = effect.channel.partition("<-")
            out[:, [index(first), index(second)]] = out[:, [index(second), index(first)]]
        case "sign_flip":
            out[:, index(effect.channel)] *= -1
        case "unit_error":
            columns = {"accel": [0, 1, 2], "gyro": [3, 4, 5]}.get(effect.channel) or [index(effect.channel)]
            out[:, columns] *= p["factor"]
        case "stuck_samples":
            stuck = stuck_rows(effect, world)
            if len(stuck):
                out[stuck, index(effect.channel)] = out[stuck[0] - 1, index(effect.channel)]
    return out


def stuck_rows(effect: Effect, world: World) -> np.ndarray:
    """Which samples repeat the one before the first of them."""
    start, stamps = effect.parameters["start"], world.edges[1:]
    return np.flatnonzero((stamps >= start) & (stamps < start + effect.parameters["duration"]))


def stuck_shift(effect: Effect, world: World, reading: np.ndarray, noiseless: np.ndarray) -> np.ndarray:
    """What stuck samples add to noiseless readings (n, 6): what each would have read by its noise nobody can know."""
    rows, column = stuck_rows(effect, world), index(effect.channel)
    out = np.zeros((world.count, 6))
    out[rows, column] = (reframe(effect, world, reading) - noiseless)[rows, column]
    return out
