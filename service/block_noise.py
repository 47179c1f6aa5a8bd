"""The noise of a block from its own readings at rest, fit to weigh a run with.

The five-term model is found in the readings as they are. A block in a real vehicle also feels sway and hum, which no
such model describes: a fit to them at the sample rate can be out by ten at the time scale of a run. So each channel's
model is held against the Allan deviation at the nodes' 6 s, which is measured without any model, and where the two
disagree the model is found anew in means over a second, in which what is fast has averaged out.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from inertial.documents import CHANNELS, ChannelNoise, Noise
from inertial.increments import Increments
from inertial.noise import MINIMUM_SAMPLES, noise_of_block
from service.errors import RefusedInput

Array = NDArray[np.float64]

NODE_S = 6.0
MEAN_S = 1.0
DISAGREEMENT = 2.0
"""Predicted against measured Allan deviation; the latter is known to 12 % from the shortest run."""
FLICKER_ALLAN = 2.0 * math.log(2.0) / math.pi
QUIETEST = {"accel": 1e-7, "gyro": 1e-10}
"""White noise [m/s²/√Hz], [rad/s/√Hz] that no sensor is below; keeps the covariance of a noise-free file regular."""


def noise_of_span(span: Increments, place: str) -> Noise:
    """Return the noise of a span at rest.

    Raises
    ------
    RefusedInput
        Too short to tell; ``place`` names the recording.
    """
    try:
        found = _noise_in_means(span, 1)
        doubtful = [name for index, name in enumerate(CHANNELS) if not _describes(getattr(found, name), span, index)]
        if doubtful:
            # As many means as identification needs at least, where holds have left only short spans.
            slow = _noise_in_means(span, max(1, min(_rows(span, MEAN_S), len(span) // MINIMUM_SAMPLES)))
            found = found.model_copy(update={name: getattr(slow, name) for name in doubtful})
    except ValueError as error:
        raise RefusedInput(place, f"{error}.", "Record for longer, or give the noise by a block model.") from None
    return audible(found)


def audible(noise: Noise) -> Noise:
    """Return the noise with nothing below what any sensor has."""
    channels: dict[str, ChannelNoise] = {name: getattr(noise, name) for name in CHANNELS}
    raised = {
        name: channel.model_copy(update={"white": max(channel.white, QUIETEST[name.partition("_")[0]])})
        for name, channel in channels.items()
    }
    return noise.model_copy(update=raised)


def _rows(span: Increments, duration_s: float) -> int:
    return max(1, round(duration_s / float(np.median(span.interval_s))))


def _means(readings: Array, rows: int) -> Array:
    """Return means of so many rows each; what does not fill one is left out."""
    return np.asarray(readings[: len(readings) - len(readings) % rows].reshape(-1, rows, 3).mean(axis=1))


def _noise_in_means(span: Increments, rows: int) -> Noise:
    accel, gyro = (_means(readings, rows) for readings in span.readings())
    return noise_of_block(accel, gyro, rows * float(np.median(span.interval_s)))


def _describes(noise: ChannelNoise, span: Increments, channel: int) -> bool:
    """Return whether a channel's model agrees with the Allan deviation of its readings over 6 s."""
    means = _means(span.readings()[channel // 3], _rows(span, NODE_S))[:, channel % 3]
    measured = math.sqrt(0.5 * float(np.mean(np.diff(means) ** 2))) if len(means) > 1 else 0.0
    predicted = math.sqrt(
        noise.quantisation**2 / (4.0 * NODE_S**2)
        + noise.white**2 / NODE_S
        + FLICKER_ALLAN * noise.flicker**2
        + noise.random_walk**2 * NODE_S / 3.0
    )
    return predicted < DISAGREEMENT * measured and measured < DISAGREEMENT * predicted
