"""A small world written apart from the library: recordings of a block on a table, every effect by its closed form."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from drivers.recording import Recording, RecordingMeta
from drivers.samples import empty_samples
from inertial.documents import BlockModel, ChannelNoise, Noise

RATE_HZ = 20.0
DURATION_S = 240.0
LATITUDE_DEG, AZIMUTH_DEG = 35.7, 40.0
EARTH_RADPS = 7.292115e-5
GRAVITY_MPS2 = 9.7976
WHITE = {"accel": 2e-4, "gyro": 3e-6}  # per root hertz
TURNS = (
    (20.0, 30.0, 9.0, 0),
    (50.0, 60.0, -9.0, 1),
    (80.0, 100.0, 18.0, 2),
    (120.0, 140.0, -9.0, 2),
    (160.0, 170.0, 9.0, 0),
    (190.0, 200.0, 9.0, 1),
)
"""Start, end [s], rate [deg/s], body axis."""

Truth = dict[str, np.ndarray]
Change = Callable[[Truth, np.ndarray], None]
"""Changes readings (n, 6) in place, given the truth: t, accel (n, 3), gyro (n, 3), temperature."""


def rotation(axis: int, angle: float) -> np.ndarray:
    """Return the rotation matrix about a coordinate axis."""
    c, s = math.cos(angle), math.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def truth(moving: bool, warming: bool) -> Truth:
    """Return the mean rates over each interval: across the axis of a turn what is at its middle, times sin(x)/x."""
    n = round(RATE_HZ * DURATION_S)
    t = (np.arange(n) + 0.5) / RATE_HZ
    lat, az = math.radians(LATITUDE_DEG), math.radians(AZIMUTH_DEG)
    # azimuth clockwise from north to axis 1; axis 2 to its left; axis 3 up
    level = math.cos(lat) * EARTH_RADPS
    earth = np.array([level * math.cos(az), level * math.sin(az), math.sin(lat) * EARTH_RADPS])
    up = np.array([0.0, 0.0, GRAVITY_MPS2])
    accel, gyro = np.empty((n, 3)), np.empty((n, 3))
    attitude = np.eye(3)  # body to tangent
    turns = TURNS if moving else ()
    done = 0
    for k in range(n):
        while done < len(turns) and t[k] > turns[done][1]:
            start, end, rate, axis = turns[done]
            attitude = attitude @ rotation(axis, math.radians(rate) * (end - start))
            done += 1
        now, spin, share = attitude, np.zeros(3), np.ones(3)
        if done < len(turns) and t[k] > turns[done][0]:
            start, end, rate, axis = turns[done]
            now = attitude @ rotation(axis, math.radians(rate) * (t[k] - start))
            spin[axis] = math.radians(rate)
            share[np.arange(3) != axis] = np.sinc(rate / RATE_HZ / 360.0)
        accel[k], gyro[k] = share * (now.T @ up), share * (now.T @ earth) + spin
    temperature = 20.0 + (15.0 * (1.0 - np.exp(-t / 100.0)) if warming else 0.0 * t)
    return {"t": t, "accel": accel, "gyro": gyro, "temperature": temperature}


def recording(change: Change | None, seed: int, *, moving: bool = True, warming: bool = False) -> Recording:
    """Return a noisy recording with a hidden change."""
    true = truth(moving, warming)
    readings = np.hstack([true["accel"], true["gyro"]])
    if change is not None:
        change(true, readings)
    rng = np.random.default_rng(seed)
    sigma = np.repeat([WHITE["accel"], WHITE["gyro"]], 3) * math.sqrt(RATE_HZ)
    readings = readings + rng.standard_normal(readings.shape) * sigma
    n = len(readings)
    samples = empty_samples(n)
    samples["sequence"] = np.arange(n)
    samples["time"] = np.arange(1, n + 1) / RATE_HZ
    samples["dv"], samples["dtheta"] = readings[:, :3] / RATE_HZ, readings[:, 3:] / RATE_HZ
    samples["temperature"][:, 0] = true["temperature"] + 0.01 * rng.standard_normal(n)
    samples["supply"] = 28.0
    axes = np.eye(3).tolist()
    motion = [
        {"kind": "turn", "start_s": a, "end_s": b, "rate_dps": r, "axis": axes[i], "frame": "body"}
        for a, b, r, i in (TURNS if moving else ())
    ]
    meta = RecordingMeta.model_validate(
        {
            "site": {"latitude_deg": LATITUDE_DEG, "height_m": 0.0, "gravity_mps2": GRAVITY_MPS2},
            "reference": {"azimuth_deg": AZIMUTH_DEG, "roll_deg": 0.0, "pitch_deg": 0.0},
            "block": {"sample_rate_hz": RATE_HZ},
            "motion": motion,
        }
    )
    return Recording(samples, meta, Path(f"blind-{seed}.parquet"), Path(f"blind-{seed}.toml"))


def model(*, free: bool = False, factor: float = 1.0) -> BlockModel:
    """Return an ideal block that states the noise, or leaves its size free."""
    if free:
        return BlockModel(noise=Noise(free=True))
    channels = {f"{kind}_{axis}": ChannelNoise(white=WHITE[kind] * factor) for kind in WHITE for axis in "xyz"}
    return BlockModel(noise=Noise.model_validate(channels))
