"""Thermal lag: the bias follows a temperature that lags behind the thermometer."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.signal import lfilter

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


class ThermalLag(Effect):
    """Reading + coefficient × (lagging temperature - temperature), first-order lag from equality at the first sample.

    It is zero at any constant temperature and of opposite sign in heating and cooling: hysteresis.
    """

    name = "thermal_lag"
    text = "The sensor is warmer or colder than its thermometer while the temperature changes."
    term = "thermal hysteresis; temperature-gradient sensitivity (IEEE 528, 952)"
    stage = Stage.SENSOR
    channels = ChannelKind.SENSOR
    parameters = (
        Parameter(
            "coefficient", "y/K", "bias per kelvin of lag", {"accel": Range(1e-5, 1e-2), "gyro": Range(1e-9, 5e-6)}
        ),
        Parameter("time_constant", "s", "of the lag", {"any": Range(5.0, 2000.0)}),
    )
    shown_by = "rest while the temperature rises and falls again, faster than the time constant"
    source = "thermal time constants of housings, 10 s to 30 min; coefficients as of bias"

    def begin(self, occasion: Occasion) -> Step:
        """Filter the temperature along the way."""
        state: Array | None = None

        def step(seen: Circumstances, readings: Readings) -> None:
            nonlocal state
            temperature = seen.temperature_c[:, 0]
            lag, state = _lagging(temperature, seen.interval_s / occasion.values["time_constant"], state)
            added = occasion.values["coefficient"] * (lag - temperature)
            readings.of(occasion.channel)[:] += added * seen.interval_s

        return step

    def regressors(self, seen: Circumstances, channel: str, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the lagging temperature less the temperature, (n, 1), for samples from the first on."""
        temperature = seen.temperature_c[:, 0]
        lag, _ = _lagging(temperature, seen.interval_s / shape["time_constant"], None)
        return (lag - temperature)[:, None]


def _lagging(temperature_c: Array, step: float, state: Array | None) -> tuple[Array, Array]:
    """Return the lag's output and state for the next samples."""
    decay = float(np.exp(-step))
    if state is None:
        state = np.array([decay * float(temperature_c[0])])
    values, state = lfilter([1.0 - decay], [1.0, -decay], temperature_c, zi=state)
    return np.asarray(values), np.asarray(state)


EFFECT = ThermalLag()
