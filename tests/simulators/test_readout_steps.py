"""Readings in steps coarser than the noise, and vibration that hides it: noise as stated is nothing to find."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_form import RATE_HZ, WHITE, model, recording
from scipy.fft import dct

from drivers.recording import Recording, RecordingMeta
from inertial.documents import BlockModel, ChannelNoise, Noise
from simulators.discrepancy.report import discrepancy
from simulators.discrepancy.whitening import cosine_basis

STEP_RAD = 5.0 * WHITE["gyro"] / np.sqrt(RATE_HZ)
RECORDS, COUNT, INTERVAL_S = 24, 16384, 0.01


def in_steps(increments: np.ndarray, step: float) -> np.ndarray:
    """Return increments read from an integral that is rounded to whole steps."""
    total = np.cumsum(increments, axis=0)
    return np.diff(np.rint(total / step), axis=0, prepend=0.0) * step


@pytest.mark.parametrize("noise_steps", [0.15, 0.3, 1.0])
@pytest.mark.parametrize("rate_steps", [0.07, 0.31, 0.5])
def test_power_of_rounding_errors_is_that_of_simulated_ones(noise_steps: float, rate_steps: float) -> None:
    """Per bin the mean of RECORDS periodograms: σ of its ratio to the truth is √(2 / coefficients)."""
    noise = ChannelNoise(white=noise_steps * np.sqrt(INTERVAL_S), quantisation=INTERVAL_S)
    basis = cosine_basis(COUNT, INTERVAL_S)
    rng = np.random.default_rng(int(100 * noise_steps + 1000 * rate_steps))
    found, said = np.zeros(len(basis.counts)), np.zeros(len(basis.counts))
    for _ in range(RECORDS):
        rates = rate_steps + noise_steps * rng.standard_normal(COUNT)
        read = in_steps(rates * INTERVAL_S, INTERVAL_S) / INTERVAL_S
        power = dct(read - read.mean(), norm="ortho") ** 2
        found += np.add.reduceat(power, basis.bounds[:-1]) / basis.counts / RECORDS
        said += basis.stated(noise, 0.0, (read, np.full(COUNT, rate_steps))) / RECORDS
    high = basis.frequency_hz > 1.0
    off = (found / said - 1.0)[high] * np.sqrt(0.5 * RECORDS * basis.counts[high])
    assert np.mean(off**2) < 4.0  # 1 by χ²; twice the σ for what the bins average over
    if noise_steps < 0.2:  # as if every error were by itself: the bound would find it
        white = basis.stated(noise, 0.0)
        assert np.mean(((found / white - 1.0)[high] * np.sqrt(0.5 * RECORDS * basis.counts[high])) ** 2) > 100.0


@pytest.mark.parametrize("free", [False, True])
def test_a_gyro_that_reads_in_coarse_steps_hides_nothing(free: bool) -> None:
    case = recording(None, 31)
    samples = case.samples.copy()
    samples["dtheta"] = in_steps(samples["dtheta"], STEP_RAD)
    channels = {f"accel_{axis}": ChannelNoise(white=WHITE["accel"]) for axis in "xyz"}
    channels |= {f"gyro_{axis}": ChannelNoise(white=WHITE["gyro"], quantisation=STEP_RAD) for axis in "xyz"}
    believed = BlockModel(noise=Noise(**channels, free=free))
    report = discrepancy([replace(case, samples=samples)], believed)
    assert (report.verdict, report.findings) == ("none", []), report.document["text"]


def test_vibration_along_one_axis_and_then_another_is_no_noise_of_either() -> None:
    case = recording(None, 32, moving=False)
    shaken = [
        {
            "kind": "vibration",
            "start_s": start,
            "end_s": start + 60.0,
            "grms": 1e-4,
            "band_hz": [1.0, 9.0],
            "axis": axis,
        }
        for start, axis in ((40.0, [0.0, 1.0, 0.0]), (140.0, [1.0, 0.0, 0.0]))
    ]
    meta = RecordingMeta.model_validate({**case.meta.model_dump(exclude_none=True), "motion": shaken})
    report = discrepancy([Recording(case.samples, meta, case.path, case.meta_path)], model())
    assert report.verdict == "none", report.document["text"]


def test_a_clipped_channel_is_named_with_its_limit_and_no_other_course_is_seen_in_it() -> None:
    """Half of its samples are gone so, in long gaps; what bridges them may pass for a random walk of 3σ."""
    case = recording(None, 33)
    samples = case.samples.copy()
    samples["dv"][:, 1] = np.clip(samples["dv"][:, 1], -5.0 / RATE_HZ, 5.0 / RATE_HZ)
    report = discrepancy([replace(case, samples=samples)], model())
    found = {(one["effect"], one["channel"]): one["parameters"] for one in report.findings}
    assert set(found) - {("rate_random_walk", "accel_y")} == {("saturation", "accel_y")}
    limit = found["saturation", "accel_y"]["limit"]
    assert abs(limit["value"] - 5.0) < 3.0 * limit["sigma"]
