"""Regressors of one channel as a textbook would list them: for the peers, and to prove strange effects strange."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from benchmarks._blind.motion import Setup
from benchmarks._blind.world import CHANNELS, World

Label = tuple[str, str]


def columns(world: World, channel: int) -> tuple[list[Label], np.ndarray]:
    """Names (effect, channel) and columns (n, m) of everything linear, or linear at a grid of inner parameters."""
    name, x, t = CHANNELS[channel], world.inputs[:, channel], world.time
    parts: list[tuple[Label, np.ndarray]] = [((effect, name), column) for effect, column in _own(world, x)]
    parts += [(("bias_step", name), (t > time).astype(float)) for time in np.linspace(0, world.length, 26)[1:-1]]
    for tau in np.geomspace(5, world.length / 2, 9):
        parts.append((("turn_on_transient", name), np.exp(-t / tau)))
        keep, rise = np.exp(-world.dt / tau), world.temperature - world.temperature[0]
        parts.append((("thermal_lag", name), lfilter([1 - keep], [1, -keep], rise) - rise))
    same = range(3) if channel < 3 else range(3, 6)
    parts += [(("misalignment", f"{name}<-{CHANNELS[i]}"), world.inputs[:, i]) for i in same if i != channel]
    if channel >= 3:
        for i in range(3):
            parts.append((("g_sensitivity", f"{name}<-{CHANNELS[i]}"), world.inputs[:, i]))
            parts.append((("g2_sensitivity", f"{name}<-{CHANNELS[i]}"), world.inputs[:, i] ** 2))
    else:
        rate = world.inputs[:, 3:]
        spin_up = np.diff(rate, axis=0, prepend=rate[:1]) / world.dt
        for arm in np.eye(3):
            place = np.cross(rate, np.cross(rate, arm)) + np.cross(spin_up, arm)
            parts.append((("size_effect", name), place[:, channel]))
    kept = [(label, column) for label, column in parts if np.ptp(column) > 0 or label[0] == "bias_shift"]
    return [label for label, _ in kept], np.column_stack([column for _, column in kept])


def _own(world: World, x: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """What needs only the channel's own input and the circumstances."""
    warm = world.temperature - 20.0
    return [
        ("bias_shift", np.ones(world.count)),
        ("drift", world.time),
        ("bias_temperature", warm),
        ("scale_temperature", warm * x),
        ("scale_factor", x),
        ("scale_asymmetry", np.abs(x)),
        ("scale_quadratic", x**2),
        ("scale_cubic", x**3),
        ("latency", -np.gradient(x) / world.dt),
        ("supply_sensitivity", world.supply - 28.0),
        ("vibration_rectification", world.vibration),
    ]


def lines(residual: np.ndarray, whitened: np.ndarray, world: World, count: int = 3) -> np.ndarray:
    """Cosines and sines (n, 2·count) at the highest peaks of a whitened DCT."""
    order = np.argsort(-(whitened**2))[:count]
    phase = np.pi * np.outer(np.arange(len(residual)) + 0.5, order) / len(residual)
    assert len(residual) == world.count
    return np.hstack([np.cos(phase), np.sin(phase)])


def setups(setup: Setup) -> list[tuple[Label, dict[str, object]]]:
    """Small changes of the set-up that are effects of their own."""
    return [
        (("azimuth_error", "all"), {"azimuth": setup.azimuth + 1e-4}),
        (("latitude_error", "all"), {"latitude": setup.latitude + 1e-4}),
        (("gravity_error", "all"), {"gravity": setup.gravity + 1e-4}),
        (("level_error", "all"), {"room_tilt": (1e-5, 0.0)}),
        (("level_error", "all"), {"room_tilt": (0.0, 1e-5)}),
        (("level_error", "all"), {"block_tilt": (1e-5, 0.0)}),
        (("level_error", "all"), {"block_tilt": (0.0, 1e-5)}),
    ]
