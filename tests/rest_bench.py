"""A laser-gyro block at rest with a shift that its model does not know, by closed form: no code of the simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from drivers.recording import RecordingMeta, write_recording
from drivers.samples import empty_samples
from inertial.documents import BlockModel, ChannelNoise, Noise

RATE_HZ, DURATION_S = 10.0, 90.0
GRAVITY_MPS2, EARTH_RADPS = 9.7976, 7.292115e-5
WHITE = {"accel": 2e-4, "gyro": 3e-6}
"""m/s²/√Hz and rad/s/√Hz."""


def write_rest(folder: Path, name: str, seed: int, *, accel_z_mps2: float = 0.0, gyro_x_radps: float = 0.0) -> None:
    """Write a minute and a half at rest with these shifts of the readings."""
    count = round(DURATION_S * RATE_HZ)
    noise = np.random.default_rng(seed).standard_normal((count, 6)) * np.sqrt(RATE_HZ)
    latitude, azimuth = np.radians(35.7), np.radians(40.0)
    level = np.cos(latitude) * np.array([np.cos(azimuth), np.sin(azimuth)])
    earth = EARTH_RADPS * np.array([*level, np.sin(latitude)])
    samples = empty_samples(count)
    samples["sequence"], samples["time"] = np.arange(count), np.arange(1, count + 1) / RATE_HZ
    samples["dv"] = (np.array([0.0, 0.0, GRAVITY_MPS2 + accel_z_mps2]) + WHITE["accel"] * noise[:, :3]) / RATE_HZ
    samples["dtheta"] = (earth + np.array([gyro_x_radps, 0.0, 0.0]) + WHITE["gyro"] * noise[:, 3:]) / RATE_HZ
    meta = {
        "site": {"latitude_deg": 35.7, "height_m": 1200.0, "gravity_mps2": GRAVITY_MPS2},
        "reference": {
            "azimuth_deg": 40.0,
            "azimuth_sigma_deg": 0.05,
            "roll_deg": 0.0,
            "pitch_deg": 0.0,
            "heading_deg": 0.0,
            "level_sigma_deg": 0.002,
        },
        "block": {"sample_rate_hz": RATE_HZ, "gyro_kind": "laser"},
    }
    write_recording(folder / name, samples, RecordingMeta.model_validate(meta))


def believed_model() -> BlockModel:
    """The block as its simulator believes it: this noise, and no shift."""
    channels = {f"{triad}_{axis}": ChannelNoise(white=WHITE[triad]) for triad in WHITE for axis in "xyz"}
    return BlockModel(block="B1", gyro_kind="laser", noise=Noise(**channels))
