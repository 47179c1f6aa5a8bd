"""Circumstances drawn at random: grade of the block, motion, temperature, supply, errors of the reference."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from benchmarks._blind.motion import Setup, Shake, Turn, normal_gravity
from benchmarks._blind.noise import Spectrum
from benchmarks._blind.world import World

RATE_HZ = 100.0
DEG = math.pi / 180
MICRO_G = 9.80665e-6
DEG_PER_HOUR = DEG / 3600
ARC_SECOND = DEG / 3600
# Accelerometer N [µg/√Hz], B [µg], K [µg/√s], step [µm/s]; gyro N [deg/√h], B [deg/h], K [deg/h/√h], step [arc second]
GRADES = {
    "laser": ((8, 4, 0.05, 30), (0.003, 0.004, 0.01, 0.1)),
    "dtg": ((10, 6, 0.1, 30), (0.004, 0.02, 0.05, 0.15)),
    "fibre": ((20, 10, 0.2, 50), (0.02, 0.1, 0.3, 0.3)),
    "mems": ((70, 40, 1.0, 150), (0.15, 2.0, 6.0, 2.0)),
}
MOTIONS = ("rest", "positions", "turns", "vibration", "tour")
CLIMATES = ("steady", "ramp", "up_down")


@dataclass(frozen=True)
class Plan:
    """What was done with the block, and how well the reference knows it."""

    kind: str
    motion: str
    climate: str
    supply: str
    sigma: dict[str, float]
    level_frame: str


def noise_of(rng: np.random.Generator, kind: str) -> list[Spectrum]:
    """Spectra of the six channels of a grade, each a little its own."""
    accel, gyro = GRADES[kind]
    units = (
        (MICRO_G, MICRO_G, MICRO_G, 1e-6),
        (DEG / 60, DEG_PER_HOUR, DEG_PER_HOUR / 60, ARC_SECOND),
    )
    out = []
    for terms, scale in zip((accel, gyro), units, strict=True):
        for _ in range(3):
            values = [t * s * np.exp(rng.normal(0, 0.25)) for t, s in zip(terms, scale, strict=True)]
            out.append(Spectrum(*(float(v) for v in values)))
    return out


def plan(rng: np.random.Generator, **wanted: str) -> Plan:
    """Draw a plan; some of it may be wished for."""
    sigma = {
        "azimuth": float(np.exp(rng.uniform(np.log(0.01), np.log(0.1)))) * DEG,
        "level": float(np.exp(rng.uniform(np.log(1e-3), np.log(1e-2)))) * DEG,
        "angle": float(np.exp(rng.uniform(np.log(2e-4), np.log(2e-3)))) * DEG,
    }
    drawn = {
        "kind": str(rng.choice(list(GRADES))),
        "motion": str(rng.choice(MOTIONS, p=[0.15, 0.3, 0.25, 0.15, 0.15])),
        "climate": str(rng.choice(CLIMATES)),
        "supply": str(rng.choice(["steady", "steps"])),
        "level_frame": str(rng.choice(["tangent", "body"])),
    }
    return Plan(sigma=sigma, **{**drawn, **wanted})


def stated_setup(rng: np.random.Generator, plan: Plan, length: float) -> tuple[Setup, float, bool]:
    """Set-up as the recording states it, its height, and whether gravity is given as surveyed."""
    latitude, height = rng.uniform(-60, 60) * DEG, float(rng.uniform(0, 1500))
    surveyed = bool(rng.integers(2))
    gravity = normal_gravity(latitude, height) + (rng.normal(0, 3e-4) if surveyed else 0.0)
    setup = Setup(
        latitude=float(latitude),
        gravity=float(gravity),
        azimuth=float(rng.uniform(0, 360) * DEG),
        roll=float(rng.normal(0, 2) * DEG),
        pitch=float(rng.normal(0, 2) * DEG),
        heading=float(rng.uniform(-180, 180) * DEG * rng.integers(2)),
        turns=tuple(_turns(rng, plan, length)),
        shakes=tuple(_shakes(rng, plan, length)),
    )
    return setup, height, surveyed


def _turns(rng: np.random.Generator, plan: Plan, length: float) -> list[Turn]:
    """Schedule of turns; edges lie within a sample, for a timing error acts alike both ways there."""
    moves: list[tuple[float, float]] = []  # angle, rate [deg, deg/s]
    if plan.motion == "positions":
        moves = [(float(rng.choice([90, 90, 180])), float(rng.uniform(12, 30))) for _ in range(rng.integers(6, 10))]
    elif plan.motion == "turns":
        moves = [(float(rng.uniform(90, 360)), float(rng.uniform(8, 60))) for _ in range(rng.integers(8, 13))]
    elif plan.motion == "tour":
        moves = [(90.0, 15.0)] * 4 + [(360.0, 40.0), (360.0, 20.0)] * 3
    elif plan.motion == "vibration":
        moves = [(90.0, 15.0)] * int(rng.integers(0, 3))
    moves = [moves[i] for i in rng.permutation(len(moves))]
    if not moves:
        return []
    busy = sum(angle / rate for angle, rate in moves)
    if busy > 0.7 * length:
        moves = [(angle, rate * busy / (0.7 * length)) for angle, rate in moves]
        busy = 0.7 * length
    shares = rng.dirichlet(np.full(len(moves) + 1, 6.0)) * (length - busy)
    out, clock = [], 0.0
    axes = _axes(rng, len(moves))
    for (angle, rate), share, axis in zip(moves, shares, axes, strict=False):
        start = round(round(clock + share, 2) + rng.uniform(0.003, 0.007), 4)
        speed = round(rate * float(rng.choice([-1, 1])), 1)
        end = round(round(start + angle / abs(speed), 2) + rng.uniform(0.003, 0.007), 4)
        frame = str(rng.choice(["body", "tangent"], p=[0.7, 0.3]))
        out.append(Turn(start, end, speed * DEG, axis, frame, angle_sigma_rad=plan.sigma["angle"]))
        clock = end
    return out


def _axes(rng: np.random.Generator, count: int) -> list[tuple[float, float, float]]:
    """Axes in turn, so that each is used about equally often."""
    order = np.concatenate([rng.permutation(3) for _ in range(count // 3 + 1)])[:count]
    return [tuple(float(v) for v in np.eye(3)[axis]) for axis in order]  # type: ignore[misc]


def _shakes(rng: np.random.Generator, plan: Plan, length: float) -> list[Shake]:
    """One or two spans of vibration, in the plan of that name; its turns come before."""
    if plan.motion != "vibration":
        return []
    out, tones = [], 300
    for start, end in [(0.35, 0.55), (0.7, 0.9)][: int(rng.integers(1, 3))]:
        low = float(np.round(rng.uniform(15, 40)))
        band = (low, low + float(np.round(rng.uniform(10, 300))))
        frequency, phase = rng.uniform(*band, tones), rng.uniform(0, 2 * np.pi, tones)
        axis = tuple(float(v) for v in np.eye(3)[rng.integers(3)])
        grms = round(float(np.exp(rng.uniform(np.log(0.3), np.log(3)))), 2)
        out.append(Shake(round(start * length, 2), round(end * length, 2), axis, grms, band, frequency, phase))
    return out


def before_vibration(setup: Setup) -> Setup:
    """The same with no turn under or after the first vibration."""
    if not setup.shakes:
        return setup
    first = setup.shakes[0].start_s
    return replace(setup, turns=tuple(turn for turn in setup.turns if turn.end_s < first))


def world_of(rng: np.random.Generator, plan: Plan, setup: Setup, length: float) -> World:
    """Temperature and supply drawn around a set-up."""
    count = round(length * RATE_HZ)
    t = (np.arange(count) + 0.5) / RATE_HZ
    first, rise = rng.uniform(10, 35), rng.uniform(8, 25) * rng.choice([-1, 1])
    if plan.climate == "steady":
        temperature = first + 0.3 * (1 - np.exp(-t / 60))
    elif plan.climate == "ramp":
        temperature = first + rise * t / length
    else:
        turn, tau = length * rng.uniform(0.4, 0.6), length * rng.uniform(0.1, 0.25)
        up = 1 - np.exp(-np.minimum(t, turn) / tau)
        temperature = first + rise * up * np.exp(-np.maximum(t - turn, 0) / tau)
    supply = np.full(count, 28.0) + rng.normal(0, 0.2)
    if plan.supply == "steps":
        for time in np.sort(rng.uniform(0, length, 5)):
            supply[t > time] = 28 + rng.uniform(-4, 4)
    return World(setup, count, 1 / RATE_HZ, temperature, supply)


def true_setup(rng: np.random.Generator, plan: Plan, stated: Setup, *, loose: bool) -> Setup:
    """Set-up as it really was: reference errors drawn from their stated σ; a ``loose`` table also errs in time."""
    turns = []
    for turn in stated.turns:
        shifts = rng.normal(0, 1e-3, 2) if loose else (0.0, 0.0)
        error = float(rng.normal(0, turn.angle_sigma_rad))
        turns.append(replace(turn, angle_error_rad=error, start_shift_s=float(shifts[0]), end_shift_s=float(shifts[1])))
    tilt = tuple(float(angle) for angle in rng.normal(0, plan.sigma["level"], 2))
    return replace(
        stated,
        azimuth=stated.azimuth + float(rng.normal(0, plan.sigma["azimuth"])),
        **{"block_tilt" if plan.level_frame == "body" else "room_tilt": tilt},
        turns=tuple(turns),
        offset_s=float(rng.normal(0, 1e-3)) if loose else 0.0,
    )
