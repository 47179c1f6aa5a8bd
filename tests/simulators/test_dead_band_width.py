"""A dead band's half-width is read off its samples, right within its own σ, whether or not the noise is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_form import RATE_HZ, WHITE, model, recording
from scipy.stats import chi2

from inertial.documents import ChannelNoise, Noise
from simulators.discrepancy.compare import Scene, compare
from simulators.discrepancy.silence import half_width

SIGMA = WHITE["gyro"] * np.sqrt(RATE_HZ)
RUNS = 16


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A record on a table, six attitudes."""
    return compare(recording(None, 1), model())


def silenced(scene: Scene, seed: int, width: float, step: float, noise: Noise) -> Scene:
    """Return a gyro that feels nothing below ``width`` and then rounds its integral to steps [rad/s a sample]."""
    rng = np.random.default_rng(seed)
    rate = scene.predicted[:, 5] + SIGMA * rng.standard_normal(len(scene.predicted))
    rate = np.where(np.abs(rate) < width, 0.0, rate)
    if step:
        total = rng.random() + np.cumsum(rate) / step
        rate = np.diff(np.rint(total), prepend=np.rint(total[0] - rate[0] / step)) * step
    measured = scene.measured.copy()
    measured[:, 5] = rate
    return replace(scene, measured=measured, model=scene.model.model_copy(update={"noise": noise}))


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize(("width", "step"), [(1.5, 0.0), (4.0, 0.0), (4.0, 1.5), (6.0, 3.0)])
def test_the_width_lies_where_its_sigma_says(scene: Scene, width: float, step: float, free: bool) -> None:
    """χ² of RUNS widths over their σ, 99.9 %. A free model states twice the noise; Earth's rate is up to 5 σ."""
    channels = {f"{kind}_{axis}": ChannelNoise(white=WHITE[kind] * (1.0 + free)) for kind in WHITE for axis in "xyz"}
    channels["gyro_z"] = channels["gyro_z"].model_copy(update={"quantisation": step * SIGMA / RATE_HZ})
    noise = Noise(**channels, free=free)
    off = []
    for seed in range(RUNS):
        one = silenced(scene, seed, width * SIGMA, step * SIGMA, noise)
        found = half_width([one], "gyro_z", 1.2 * width * SIGMA)
        assert found is not None
        off.append((found[0] - width * SIGMA) / found[1])
    low, high = chi2.interval(0.999, RUNS)
    assert low < np.sum(np.square(off)) < high, off


def test_where_nothing_is_silent_nothing_is_read_off(scene: Scene) -> None:
    assert half_width([silenced(scene, 1, 0.0, 0.0, scene.model.noise)], "gyro_z", SIGMA) is None
