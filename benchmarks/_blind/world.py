"""Circumstances of one recording as they truly were: time, motion, temperature, supply, inputs of the sensors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from benchmarks._blind.motion import STANDARD_GRAVITY_MPS2, Setup, increments

CHANNELS = ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z")


def index(channel: str) -> int:
    """Column of a channel in an (n, 6) array of readings."""
    return CHANNELS.index(channel)


@dataclass(frozen=True)
class World:
    """``setup`` as the block really stood (without hidden set-up effects); temperature and supply by sample."""

    setup: Setup
    count: int
    dt: float
    temperature: np.ndarray
    supply: np.ndarray

    @cached_property
    def edges(self) -> np.ndarray:
        """Ends of all intervals [s], the start of the first included."""
        return np.arange(self.count + 1) * self.dt

    @cached_property
    def time(self) -> np.ndarray:
        """Middles of the intervals [s]."""
        return self.edges[:-1] + self.dt / 2

    @cached_property
    def inputs(self) -> np.ndarray:
        """True mean specific force and rate (n, 6)."""
        return self.inputs_of(self.setup)

    @cached_property
    def attitude(self) -> np.ndarray:
        """C_tb at the middles (n, 3, 3)."""
        return increments(self.setup, self.edges)[2]

    def inputs_of(self, setup: Setup, edges: np.ndarray | None = None) -> np.ndarray:
        """Inputs (n, 6) in another set-up or over other intervals."""
        edges = self.edges if edges is None else edges
        dv, dtheta, _ = increments(setup, edges)
        return np.hstack([dv, dtheta]) / np.diff(edges)[:, None]

    @cached_property
    def vibration(self) -> np.ndarray:
        """Mean square of the vibration [(m/s²)²] by sample."""
        out = np.zeros(self.count)
        for shake in self.setup.shakes:
            share = np.clip(self.edges, shake.start_s, shake.end_s)
            out += np.diff(share) / self.dt * (shake.grms * STANDARD_GRAVITY_MPS2) ** 2
        return out

    @property
    def length(self) -> float:
        """Duration [s]."""
        return self.count * self.dt

    def moved(self, **changes: object) -> Setup:
        """The set-up with some of its fields changed."""
        return replace(self.setup, **changes)
