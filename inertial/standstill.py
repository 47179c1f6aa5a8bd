"""Is the block standing still? One detector for every grade of block, live by chunk and over a whole recording.

While the block stands, the velocity and angle it gains run along straight lines (gravity, Earth rate and bias are all
constant), with sensor noise about them. Judged is how far they stray: the range of the accumulated increments less
their own mean rate, sensor by sensor, over the last 40 s or since the block was last disturbed. A knock, a sway or the
beginning of a turn all stray; bias does not, nor does the warm-up drift of a good sensor. A steady turn, which is a
straight line as well, shows by a mean rate that neither the Earth nor a bias explains.

A limit is what harmless sway may reach plus a multiple of the block's own noise over that time, never above a cap
that no noise excuses. Harmless comes from a real ring-laser block: parked quietly it strays by up to 165 arcsec and
0.02 m/s within 40 s, with people moving about in the vehicle by 1000 arcsec and 0.3 m/s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from inertial.compiled import compiled
from inertial.documents import CHANNELS, ChannelNoise, Noise
from inertial.earth import EARTH_RATE_RADPS
from inertial.increments import Increments

Array = NDArray[np.float64]

_ARCSEC = math.radians(1.0) / 3600.0
MEMORY_S = 40.0
"""Longest stretch that must be straight [s]; slower motion than it shows is for verification to find."""
HOP_S = 0.1
"""How often it is judged [s]."""
HARMLESS = np.array([0.02] * 3 + [160.0 * _ARCSEC] * 3)
"""Sway that does not count as motion: [m/s] by accelerometer, [rad] by gyro."""
CAPS = np.array([1.0] * 3 + [math.radians(1.5)] * 3)
"""Straying that no noise excuses: [m/s], [rad]."""
HARMLESS_RATE_RADPS = math.radians(0.01)
_NOISE_MULTIPLE = 4.0  # range of a Brownian bridge: P(> 4 σ√T) = 2(4·4² − 1)e^(−2·4²) = 2e-12 (Kuiper 1960)
_BIAS_MULTIPLE = 150.0  # bias against 1 s of white noise: no grade of gyro from laser to MEMS has more
_RATE_AFTER_S = 1.0
_LEAST_NOISE_S = 20.0  # sway that looks like noise comes in bursts: a short stretch may have it all
_MEMORY_HOPS = round(MEMORY_S / HOP_S)
_HOP_SAMPLES = 1024  # a faster block is judged more often
_LEARNING_S = 2.0
_QUIETEST_SHARE = 0.25


@dataclass(frozen=True)
class Disturbance:
    """The block moved: when it was noticed, on which sensor, by how much and what was allowed.

    ``channel`` is a name of :data:`inertial.documents.CHANNELS`, with ``value`` and ``limit`` in m/s or rad of
    straying, or ``"rate"`` with both in rad/s.
    """

    time_s: float
    channel: str
    value: float
    limit: float

    def __str__(self) -> str:
        """Return the sentence for people."""
        if self.channel == "rate":
            value, limit, unit = math.degrees(self.value), math.degrees(self.limit), "deg/s of mean rate"
        elif self.channel.startswith("gyro"):
            value, limit, unit = self.value / _ARCSEC, self.limit / _ARCSEC, f"arcsec on {self.channel}"
        else:
            value, limit, unit = self.value, self.limit, f"m/s on {self.channel}"
        return f"moved at {self.time_s:.1f} s: {value:.3g} {unit}, limit {limit:.3g}"


class StillnessDetector:
    """Watches samples as they come; the same verdicts however they are cut into chunks.

    Parameters
    ----------
    noise
        Of the block: from its model, or :func:`learn_noise` of a quiet stretch.
    """

    def __init__(self, noise: Noise) -> None:
        channels = [noise.accel_x, noise.accel_y, noise.accel_z, noise.gyro_x, noise.gyro_y, noise.gyro_z]
        self._noise = np.array([[c.white, c.flicker, c.quantisation] for c in channels])
        bias = _BIAS_MULTIPLE * max(c.white for c in channels[3:])
        self._limits = np.array([*HARMLESS, *CAPS, EARTH_RATE_RADPS + HARMLESS_RATE_RADPS + bias])
        self._memory = np.zeros((4 * _MEMORY_HOPS, 19))
        self._hop = np.zeros((_HOP_SAMPLES, 7))
        self._counts = np.zeros(3, np.int64)
        self._still_for = np.zeros(1)

    @property
    def still_for_s(self) -> float:
        """Return how long the block has stood without a disturbance [s]; zero while it moves."""
        return float(self._still_for[0])

    def feed(
        self, time_s: ArrayLike, dv_mps: ArrayLike, dtheta_rad: ArrayLike, interval_s: ArrayLike
    ) -> list[Disturbance]:
        """Take the next samples and return the disturbances that show by their end.

        Parameters
        ----------
        time_s, interval_s : (n,)
            Device time at the end of each sample, and its interval [s].
        dv_mps, dtheta_rad : (n, 3)
            Increments as sent, body axes.
        """
        time, interval = np.asarray(time_s, dtype=np.float64), np.asarray(interval_s, dtype=np.float64)
        increments = np.hstack([np.asarray(dv_mps, dtype=np.float64), np.asarray(dtheta_rad, dtype=np.float64)])
        found = np.empty((len(time), 4))
        count = _watch(
            increments,
            interval,
            self._noise,
            self._limits,
            self._memory,
            self._hop,
            self._counts,
            self._still_for,
            found,
        )
        names = (*CHANNELS, "rate")
        return [Disturbance(float(time[int(row[0])]), names[int(row[1])], row[2], row[3]) for row in found[:count]]


def first_disturbance(window: Increments, noise: Noise) -> Disturbance | None:
    """Return what shows first that the block moved within a window, or None if it stood still."""
    time = window.start_s + np.cumsum(window.interval_s)
    found = StillnessDetector(noise).feed(time, window.dv_mps, window.dtheta_rad, window.interval_s)
    return found[0] if found else None


def still_spans(
    time_s: ArrayLike,
    dv_mps: ArrayLike,
    dtheta_rad: ArrayLike,
    interval_s: ArrayLike,
    noise: Noise,
    *,
    margin_s: float = 2.0,
) -> list[tuple[float, float]]:
    """Return the spans of device time [s] in which the block stood, ``margin_s`` away from any disturbance."""
    time, interval = np.asarray(time_s, dtype=np.float64), np.asarray(interval_s, dtype=np.float64)
    found = StillnessDetector(noise).feed(time, dv_mps, dtheta_rad, interval)
    edges = [float(time[0] - interval[0]) - margin_s, *(d.time_s for d in found), float(time[-1]) + margin_s]
    spans = [(begin + margin_s, end - margin_s) for begin, end in pairwise(edges)]
    return [(begin, end) for begin, end in spans if end > begin]


def learn_noise(dv_mps: ArrayLike, dtheta_rad: ArrayLike, interval_s: ArrayLike) -> Noise:
    """Return the block's own noise as its quietest quarter shows it, whatever else went on.

    White noise from the differences of neighbouring 2 s sums, of which the lower quartile is 0.319·2σ√(2 s/2) for a
    normal deviate; quantisation as the smallest step between readings. Good enough to set limits by; for the noise
    itself see :mod:`inertial.noise`.

    Raises
    ------
    ValueError
        Less than 10 s.
    """
    interval = np.asarray(interval_s, dtype=np.float64)
    block = np.floor(np.cumsum(interval) / _LEARNING_S - 1e-6).astype(np.int64)
    blocks = int(block[-1]) if len(block) else 0  # the last may be cut
    if blocks < 5:
        raise ValueError(f"{interval.sum():.1f} s are too short to learn the noise from; give 10 s or more")
    increments = np.hstack([np.asarray(dv_mps, dtype=np.float64), np.asarray(dtheta_rad, dtype=np.float64)])
    learnt = {}
    for channel, name in enumerate(CHANNELS):
        sums = np.bincount(block, increments[:, channel])[:blocks] / np.bincount(block, interval)[:blocks]
        quartile = float(np.quantile(np.abs(np.diff(sums)), _QUIETEST_SHARE))
        steps = np.abs(np.diff(increments[:, channel]))
        smallest = float(np.min(steps[steps > 1e-12], initial=np.inf))
        step = smallest if math.isfinite(smallest) else 0.0
        quartile = max(quartile, step / _LEARNING_S)  # differences below a step cannot be told
        learnt[name] = ChannelNoise(
            white=quartile / 0.3186 / math.sqrt(2.0) * math.sqrt(_LEARNING_S),
            quantisation=step,
        )
    return Noise.model_validate(learnt)


@compiled
def _watch(
    increments: Array,
    interval: Array,
    noise: Array,
    limits: Array,
    memory: Array,
    hop: Array,
    counts: NDArray[np.int64],
    still_for: Array,
    found: Array,
) -> int:
    """Write the disturbances into ``found`` (sample, channel or 6 for rate, value, limit); return how many.

    ``memory`` holds the hops of the stretch in rows ``counts[0]`` to ``counts[1]``: sums, extremes of the partial sums
    about the hop's own straight line, duration. ``hop`` gathers the ``counts[2]`` samples of the hop under way.
    """
    count = 0
    for k in range(increments.shape[0]):
        for c in range(6):
            hop[counts[2], c] = increments[k, c]
        hop[counts[2], 6] = interval[k]
        counts[2] += 1
        time = 0.0
        for j in range(counts[2]):
            time += hop[j, 6]
        if time < 0.999 * HOP_S and counts[2] < hop.shape[0]:
            continue
        if counts[1] == memory.shape[0]:  # the stretch moves back to the beginning, which it left long ago
            for h in range(counts[1] - counts[0]):
                for c in range(19):
                    memory[h, c] = memory[counts[0] + h, c]
            counts[1] -= counts[0]
            counts[0] = 0
        _summarise(hop, counts[2], time, memory, counts[1])
        counts[1] += 1
        counts[0] = max(counts[0], counts[1] - _MEMORY_HOPS)
        counts[2] = 0
        still_for[0] += time
        channel, value, limit = _judge(memory, counts[0], counts[1], noise, limits)
        if channel >= 0:
            found[count, 0], found[count, 1], found[count, 2], found[count, 3] = k, channel, value, limit
            count += 1
            counts[0] = counts[1]
            still_for[0] = 0.0
    return count


@compiled
def _summarise(hop: Array, samples: int, time: float, memory: Array, row: int) -> None:
    memory[row, 18] = time
    for c in range(6):
        total = 0.0
        for j in range(samples):
            total += hop[j, c]
        at = lowest = highest = 0.0
        for j in range(samples):
            at += hop[j, c] - total * hop[j, 6] / time
            lowest, highest = min(lowest, at), max(highest, at)
        memory[row, c], memory[row, 6 + c], memory[row, 12 + c] = total, lowest, highest


@compiled
def _judge(memory: Array, first: int, last: int, noise: Array, limits: Array) -> tuple[int, float, float]:
    """Return the sensor that strays most beyond its limit (6: the mean rate; −1: none), its value and limit."""
    time = 0.0
    for h in range(first, last):
        time += memory[h, 18]
    grown = max(time, _LEAST_NOISE_S)
    worst, channel, value, allowed, square = 1.0, -1, 0.0, 0.0, 0.0
    for c in range(6):
        mean = 0.0
        for h in range(first, last):
            mean += memory[h, c]
        mean /= time
        if c >= 3:
            square += mean * mean
        at = lowest = highest = 0.0
        for h in range(first, last):
            after = at + memory[h, c] - mean * memory[h, 18]
            lowest = min(lowest, min(at, after) + memory[h, 6 + c])
            highest = max(highest, max(at, after) + memory[h, 12 + c])
            at = after
        own = noise[c, 0] ** 2 * grown + (0.3 * noise[c, 1] * grown) ** 2 + noise[c, 2] ** 2
        limit = min(limits[6 + c], limits[c] + _NOISE_MULTIPLE * math.sqrt(own))
        if highest - lowest > worst * limit:
            worst, channel, value, allowed = (highest - lowest) / limit, c, highest - lowest, limit
    rate = math.sqrt(square)
    if time > _RATE_AFTER_S and rate > worst * limits[12]:
        channel, value, allowed = 6, rate, limits[12]
    return channel, value, allowed
