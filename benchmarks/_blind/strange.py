"""Effects that no library has: what the workflow must call unknown rather than name."""

from __future__ import annotations

import numpy as np
from scipy.signal import fftconvolve

from benchmarks._blind.world import World, index

DETERMINISTIC = [
    "tanh",
    "backlash",
    "product",
    "memory",
    "ring_down",
    "two_pole",
    "chirp",
    "relaxation",
]
RANDOM = ["telegraph", "bursts"]
STRANGE = [*DETERMINISTIC, *RANDOM]
NEEDS_TURNS = {"tanh", "backlash", "product", "memory", "ring_down"}


def shape(name: str, channel: str, world: World, rng: np.random.Generator) -> np.ndarray:
    """Unit shape (n,) of what is added to one channel."""
    t, span, x = world.time, world.length, world.inputs[:, index(channel)]
    largest = np.abs(x).max()
    match name:
        case "tanh":  # gain is right for small inputs and collapses for large ones
            knee = largest * rng.uniform(0.02, 0.15)
            return knee * np.tanh(x / knee)
        case "backlash":
            return _play(x, largest * rng.uniform(0.2, 0.6)) - x
        case "product":
            first, second = rng.choice([i for i in range(6) if i != index(channel)], 2, replace=False)
            return world.inputs[:, first] * np.abs(world.inputs[:, second])
        case "memory":  # power-law creep after every change of the input
            kernel = (1 + np.arange(world.count) * world.dt / rng.uniform(1, 5)) ** -rng.uniform(0.4, 0.8)
            return fftconvolve(np.diff(x, prepend=x[:1]), kernel)[: world.count]
        case "ring_down":
            period, decay = rng.uniform(1.5, 6), rng.uniform(3, 10)
            lag = np.arange(round(8 * decay / world.dt)) * world.dt
            knocks = np.abs(np.diff(world.inputs[:, 3:].sum(axis=1), prepend=0.0))
            knocks[0] = 0.0
            return fftconvolve(knocks, np.exp(-lag / decay) * np.sin(2 * np.pi * lag / period))[: world.count]
        case "two_pole":  # overshoots and comes back, with a slow swing
            fast, slow = span * rng.uniform(0.04, 0.08), span * rng.uniform(0.12, 0.2)
            swing = np.cos(2 * np.pi * t / (span * rng.uniform(0.2, 0.35)))
            return np.exp(-t / slow) * swing - np.exp(-t / fast)
        case "chirp":
            low, high = 4 / span, rng.uniform(0.3, 3)
            return np.sin(2 * np.pi * (low * t + (high - low) * t**2 / (2 * span)))
        case "relaxation":
            period, rise = span / rng.uniform(6, 25), rng.uniform(0.3, 2)
            phase = (t / period + rng.random()) % 1
            return (1 - np.exp(-phase / rise)) / (1 - np.exp(-1 / rise)) - 0.5
        case "telegraph":
            flips = rng.random(world.count) < world.dt / (span / rng.uniform(12, 40))
            return np.where(np.cumsum(flips) % 2, 1.0, -1.0)
        case "bursts":
            out = np.zeros(world.count)
            for start in rng.uniform(0, span * 0.95, 8):
                lag = np.clip(t - start, 0, None)
                out += rng.standard_normal() * np.exp(-lag / 2.0) * np.sin(2 * np.pi * lag * rng.uniform(0.5, 3))
            return out
    raise ValueError(name)


def _play(x: np.ndarray, width: float) -> np.ndarray:
    """Output of a gear with play: it follows its input only beyond half the width."""
    out, place = np.empty_like(x), 0.0
    for i, value in enumerate(x):
        place = min(max(place, value - width / 2), value + width / 2)
        out[i] = place
    return out
