"""Size effect: an accelerometer sits off the block's centre and feels the turning."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from inertial.documents import CHANNELS
from simulators.effects.base import (
    Array,
    ChannelKind,
    Circumstances,
    Effect,
    Occasion,
    Parameter,
    Range,
    Readings,
    Stage,
    Step,
)


class SizeEffect(Effect):
    """Reading + component of ω × (ω × r) + ω̇ × r, r the sensor's place from the point the block turns about, body axes.

    ω̇ is the difference of the mean rates of this interval and the one before; before the first one there was none.
    """

    name = "size_effect"
    text = "The accelerometer sits off the centre and feels centrifugal and angular acceleration."
    term = "size effect; lever arm (IEEE 528)"
    stage = Stage.SENSOR
    channels = ChannelKind.SENSOR
    acts_on = ("accel",)
    amplitudes = 3
    parameters = (
        Parameter("arm_x", "m", "place along x", {"any": Range(1e-3, 0.1)}),
        Parameter("arm_y", "m", "place along y", {"any": Range(1e-3, 0.1)}),
        Parameter("arm_z", "m", "place along z", {"any": Range(1e-3, 0.1)}),
    )
    shown_by = "fast turns about all three axes"
    source = "dimensions of blocks: 5 to 50 mm"

    def begin(self, occasion: Occasion) -> Step:
        """Add it, remembering the rate of the sample before."""
        arm = np.array([occasion.values[name] for name in ("arm_x", "arm_y", "arm_z")])
        before: Array | None = None

        def step(seen: Circumstances, readings: Readings) -> None:
            nonlocal before
            columns = _columns(seen, CHANNELS.index(occasion.channel), before)
            before = seen.gyro_radps[-1].copy()
            readings.of(occasion.channel)[:] += (columns * arm).sum(axis=1) * seen.interval_s

        return step

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return what one metre along each axis adds (n, 3), for samples from the first on."""
        return _columns(seen, CHANNELS.index(channel), None)


def _columns(seen: Circumstances, axis: int, before: Array | None) -> Array:
    rate = seen.gyro_radps
    first = rate[0] if before is None else before
    change = np.diff(rate, axis=0, prepend=first[None]) / seen.interval_s
    unit: NDArray[np.float64] = np.eye(3)[axis]
    # row `axis` of [ω×][ω×] = ω ωᵀ - ω²·1, and of [ω̇×]
    centrifugal = rate[:, axis : axis + 1] * rate - np.sum(rate**2, axis=1)[:, None] * unit
    euler = np.cross(unit[None, :], change)
    return np.asarray(centrifugal + euler)


EFFECT = SizeEffect()
