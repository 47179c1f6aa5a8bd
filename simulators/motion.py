"""True motion of a block on its launcher, and the increments that ideal sensors would integrate from it.

The block turns about its own centre while the launcher stands on the Earth, so its specific force is the reaction to
gravity, plus vibration. Within one motion the attitude turns at a constant rate about one axis, so that every
increment has a closed form: with ``u`` the axis, ``φ = w·(t − start)`` and ``p`` the vector at the motion's start,

    ∫R(u, −φ)p dt = u(u·p)·T + (p − u(u·p))·∫cos φ dt − (u × p)·∫sin φ dt

(Rodrigues' formula, integrated). ``p`` is gravity's reaction for the specific force and the Earth's rate for the rate.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from inertial.attitude import rotation_matrix
from inertial.compiled import compiled
from inertial.earth import Site

Array = NDArray[np.float64]
Vector = tuple[float, float, float]

TONES = 128
"""Sinusoids that make up one random vibration; by the central limit theorem its samples are Gaussian."""
RAMP_SHARE = 0.05
"""Share of a vibration's span over which it swells, and again over which it fades."""
_ANCHOR = 64  # samples between exact evaluations of a tone; between them it advances by one rotation a sample


@dataclass(frozen=True)
class Turn:
    """Constant rate [rad/s] about an axis fixed in the ``body`` (inner) or in the ``tangent`` frame (outer axis)."""

    start_s: float
    end_s: float
    rate_radps: float
    axis: Vector
    frame: Literal["body", "tangent"] = "body"


@dataclass(frozen=True)
class Vibration:
    """Gaussian vibration of the case along a body axis, its spectrum flat within ``band_hz``; rms [m/s²]."""

    start_s: float
    end_s: float
    axis: Vector
    rms_mps2: float
    band_hz: tuple[float, float]


Motion = Turn | Vibration


@dataclass(frozen=True)
class Setup:
    """How a block stands and what will be done with it: truth, or what somebody believes of it.

    ``C_tb`` (3, 3) is the attitude at time 0; ``motions`` are in time order and gaps between them are rest.
    """

    site: Site
    azimuth_rad: float
    C_tb: Array
    motions: tuple[Motion, ...] = ()

    def with_motion(self, motion: Motion) -> Setup:
        """Return the same with ``motion`` in place of whatever was planned in its span."""
        kept: list[Motion] = [motion]
        for other in self.motions:
            if other.start_s < motion.start_s:
                kept.append(replace(other, end_s=min(other.end_s, motion.start_s)))
            if other.end_s > motion.end_s:
                kept.append(replace(other, start_s=max(other.start_s, motion.end_s)))
        return replace(self, motions=tuple(sorted(kept, key=lambda m: m.start_s)))


@dataclass(frozen=True)
class _Segment:
    """A span of constant rate: ``C_bt(t) = after · R(axis, −rate·(t − start)) · before``."""

    start_s: float
    end_s: float
    rate_radps: float
    axis: Array
    before: Array
    after: Array

    def C_tb(self, time_s: Array) -> Array:
        turned = rotation_matrix(self.axis * (self.rate_radps * (time_s - self.start_s))[..., None])
        return np.asarray(self.before.T @ turned @ self.after.T)


class Trajectory:
    """Truth of a set-up: attitude at any time, ideal increments over any samples.

    ``seed`` draws the random vibration; nothing else here is random.

    Raises
    ------
    ValueError
        Motions that overlap, end before they start, or turn about no axis.
    """

    def __init__(self, setup: Setup, seed: int = 0) -> None:
        self.setup = setup
        self._earth_radps = setup.site.earth_rate_radps(setup.azimuth_rad)
        self._gravity_mps2 = setup.site.gravity_mps2
        self._segments = _segments(setup)
        self._vibrations = [_Tones(m, seed) for m in setup.motions if isinstance(m, Vibration)]

    def attitude(self, time_s: Array) -> Array:
        """Return ``C_tb`` (n, 3, 3) at times (n,) [s]."""
        time_s = np.asarray(time_s, dtype=np.float64)
        C_tb = np.empty((*time_s.shape, 3, 3))
        for segment in self._segments:
            within = (time_s >= segment.start_s) & (time_s < segment.end_s)
            C_tb[within] = segment.C_tb(time_s[within])
        return C_tb

    def increments(self, first: int, count: int, rate_hz: float, epoch_s: float = 0.0) -> tuple[Array, Array]:
        """Return ideal increments, velocity (count, 3) [m/s] and angle with respect to inertial space (count, 3) [rad].

        Sample k covers the time from ``epoch_s + k/rate_hz`` to ``epoch_s + (k + 1)/rate_hz``; the first one is
        ``k = first``. The figures of a sample do not depend on the others asked for with it.
        """
        edges = epoch_s + np.arange(first, first + count + 1) / rate_hz
        dv, dtheta = self.smooth_increments(edges)
        for tones in self._vibrations:
            if edges[-1] > tones.start_s and edges[0] < tones.end_s:
                dv += np.diff(tones.speed(first, count + 1, rate_hz, epoch_s))[:, None] * tones.axis
        return dv, dtheta

    def smooth_increments(self, edges: Array) -> tuple[Array, Array]:
        """Return the same between any edges (n + 1,) [s], without the vibrations: increments (n, 3) each."""
        count = len(edges) - 1
        dv, dtheta = np.zeros((count, 3)), np.zeros((count, 3))
        for segment in self._segments:
            low = int(np.searchsorted(edges, segment.start_s, "right")) - 1
            high = int(np.searchsorted(edges, segment.end_s, "left"))
            if low < count and high > 0:
                self._add(segment, edges, max(low, 0), min(high, count), dv, dtheta)
        return dv, dtheta

    def _add(self, segment: _Segment, edges: Array, low: int, high: int, dv: Array, dtheta: Array) -> None:
        _accumulate(
            edges,
            low,
            high,
            segment.start_s,
            segment.end_s,
            segment.rate_radps,
            segment.axis,
            segment.before @ np.array([0.0, 0.0, self._gravity_mps2]),
            segment.before @ self._earth_radps,
            segment.after @ segment.axis * segment.rate_radps,
            segment.after,
            dv,
            dtheta,
        )


def _segments(setup: Setup) -> list[_Segment]:
    """Return the turns with the rests between them, each with its attitude at the start."""
    segments: list[_Segment] = []
    C_tb, end_s = np.asarray(setup.C_tb, dtype=np.float64), -math.inf
    up = np.array([0.0, 0.0, 1.0])
    previous_end = -math.inf
    for motion in setup.motions:
        if not motion.start_s < motion.end_s:
            raise ValueError(f"motion from {motion.start_s} s to {motion.end_s} s ends before it starts")
        if motion.start_s < previous_end:
            raise ValueError(f"motion from {motion.start_s} s begins before the one ahead ends at {previous_end} s")
        previous_end = motion.end_s
        if not isinstance(motion, Turn):
            continue
        if motion.start_s > end_s:
            segments.append(_Segment(end_s, motion.start_s, 0.0, up, C_tb.T, np.eye(3)))
        axis = _unit(motion.axis)
        before, after = (C_tb.T, np.eye(3)) if motion.frame == "body" else (np.eye(3), C_tb.T)
        turn = _Segment(motion.start_s, motion.end_s, motion.rate_radps, axis, before, after)
        segments.append(turn)
        turned = _turned(motion.axis, motion.rate_radps * (motion.end_s - motion.start_s))
        C_tb, end_s = np.asarray(before.T @ turned @ after.T), motion.end_s
    # A rest has no start of its own: with rate zero its attitude is the same however far back it reaches.
    segments.append(_Segment(end_s, math.inf, 0.0, up, C_tb.T, np.eye(3)))
    return [replace(s, start_s=max(s.start_s, -1e12)) for s in segments]


@lru_cache(maxsize=1024)
def _turned(axis: Vector, angle_rad: float) -> Array:
    """Return the rotation (3, 3) about an axis; set-ups that are compared have nearly all turns in common."""
    return rotation_matrix(_unit(axis) * angle_rad)


def _unit(axis: Vector) -> Array:
    vector = np.asarray(axis, dtype=np.float64)
    length = float(np.linalg.norm(vector))
    if not length > 0.0:
        raise ValueError(f"axis {axis} has no direction; give [x, y, z] of a length above zero")
    return vector / length


@compiled
def _accumulate(
    edges: Array,
    low: int,
    high: int,
    start_s: float,
    end_s: float,
    rate: float,
    axis: Array,
    force: Array,
    earth: Array,
    turning: Array,
    after: Array,
    dv: Array,
    dtheta: Array,
) -> None:
    """Add one segment's share to samples low…high; ``force`` and ``earth`` are p at its start, see the module."""
    along_force = axis[0] * force[0] + axis[1] * force[1] + axis[2] * force[2]
    along_earth = axis[0] * earth[0] + axis[1] * earth[1] + axis[2] * earth[2]
    cross_force, cross_earth = np.cross(axis, force), np.cross(axis, earth)
    f, w = np.empty(3), np.empty(3)
    for k in range(low, high):
        begin, end = max(edges[k], start_s), min(edges[k + 1], end_s)
        span = end - begin
        cosine, sine = span, 0.0  # ∫cos φ dt, ∫sin φ dt
        if rate != 0.0:
            middle = rate * (0.5 * (begin + end) - start_s)
            chord = 2.0 * math.sin(0.5 * rate * span) / rate
            cosine, sine = math.cos(middle) * chord, math.sin(middle) * chord
        for i in range(3):
            f[i] = axis[i] * along_force * (span - cosine) + force[i] * cosine - cross_force[i] * sine
            w[i] = axis[i] * along_earth * (span - cosine) + earth[i] * cosine - cross_earth[i] * sine
        for i in range(3):
            dv[k, i] += after[i, 0] * f[0] + after[i, 1] * f[1] + after[i, 2] * f[2]
            dtheta[k, i] += after[i, 0] * w[0] + after[i, 1] * w[1] + after[i, 2] * w[2] + turning[i] * span


def vibration_mean_square(setup: Setup, time_s: Array) -> Array:
    """Return the mean square (n,) [(m/s²)²] of the vibration planned at times (n,): rms² within each span, else 0."""
    mean_square = np.zeros(time_s.shape)
    for motion in setup.motions:
        if isinstance(motion, Vibration):
            mean_square[(time_s >= motion.start_s) & (time_s < motion.end_s)] = motion.rms_mps2**2
    return mean_square


class _Tones:
    """One random vibration as sinusoids of equal power, one drawn in each equal part of the band.

    The speed is their exact integral under an envelope that is zero at both ends, so that the block comes to rest
    again; increments are differences of the speed and therefore exact, above half the sample rate too.
    """

    def __init__(self, vibration: Vibration, seed: int) -> None:
        low, high = vibration.band_hz
        if not 0.0 < low < high:
            raise ValueError(f"vibration band {vibration.band_hz} Hz is not [low, high] above zero")
        self.start_s, self.end_s = vibration.start_s, vibration.end_s
        self.axis = _unit(vibration.axis)
        span = np.array([vibration.start_s, vibration.end_s])
        rng = np.random.default_rng([seed, zlib.crc32(span.tobytes())])
        frequency_hz = low + (high - low) * (np.arange(TONES) + rng.random(TONES)) / TONES
        self._omega = 2.0 * math.pi * frequency_hz
        self._phase = rng.uniform(0.0, 2.0 * math.pi, TONES)
        self._amplitude = vibration.rms_mps2 * math.sqrt(2.0 / TONES) / self._omega

    def speed(self, first: int, count: int, rate_hz: float, epoch_s: float) -> Array:
        """Return the speed (count,) [m/s] along the axis at the edges ``epoch_s + k/rate_hz``."""
        ramp_s = RAMP_SHARE * (self.end_s - self.start_s)
        return _speed(
            first,
            count,
            rate_hz,
            epoch_s,
            self.start_s,
            self.end_s,
            ramp_s,
            self._omega,
            self._phase,
            self._amplitude,
        )


@compiled
def _speed(
    first: int,
    count: int,
    rate_hz: float,
    epoch_s: float,
    start_s: float,
    end_s: float,
    ramp_s: float,
    omega: Array,
    phase: Array,
    amplitude: Array,
) -> Array:
    speed = np.zeros(count)
    step_cos, step_sin = np.cos(omega / rate_hz), np.sin(omega / rate_hz)
    c, s = np.zeros_like(omega), np.zeros_like(omega)
    anchor = first - first % _ANCHOR
    for k in range(anchor, first + count):
        t = epoch_s + k / rate_hz
        if k % _ANCHOR == 0:
            for i in range(omega.size):
                angle = omega[i] * (t - start_s) + phase[i]
                c[i], s[i] = math.cos(angle), math.sin(angle)
        else:
            for i in range(omega.size):
                turned = c[i] * step_cos[i] - s[i] * step_sin[i]
                s[i] = s[i] * step_cos[i] + c[i] * step_sin[i]
                c[i] = turned
        if k < first or t <= start_s or t >= end_s:
            continue
        total = 0.0
        for i in range(omega.size):
            total += amplitude[i] * s[i]
        inside = min(t - start_s, end_s - t)
        envelope = 1.0 if inside >= ramp_s else 0.5 - 0.5 * math.cos(math.pi * inside / ramp_s)
        speed[k - first] = envelope * total
    return speed
