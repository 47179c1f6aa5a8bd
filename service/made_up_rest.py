"""A made-up block at rest, on which compiled code is made ready before anybody waits for it."""

from __future__ import annotations

import numpy as np

from drivers.samples import SampleArray, empty_samples

RATE_HZ = 20.0


def made_up_rest(length_s: float) -> SampleArray:
    """Return so many seconds [block s] of it, the same each time; nobody may write to them."""
    samples = empty_samples(int(length_s * RATE_HZ))
    samples["sequence"] = np.arange(1, len(samples) + 1)
    samples["time"] = samples["sequence"] / RATE_HZ
    random = np.random.default_rng(0)
    samples["dv"] = np.array([0.0, 0.0, 9.8]) / RATE_HZ + random.normal(0.0, 1e-5, (len(samples), 3))
    samples["dtheta"] = random.normal(0.0, 1e-7, (len(samples), 3))
    samples.flags.writeable = False
    return samples
