"""A generic basis that names nothing: if it explains more than every name, the discrepancy has none of the names.

Smooth functions of time, waves that die out, temperature, supply, the sensor's own input, products of inputs, and of
one with the size of another, memory of the input, whether it fades or is hysteresis, and ringing after changes of
motion.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from inertial.compiled import compiled
from simulators.discrepancy.compare import AWAY_V, Scene

Array = NDArray[np.float64]

_MEMORY_S = (0.15, 0.5, 1.5, 6.0, 25.0)  # from a filter's to that of what creeps
_FEWEST_KEPT = 2.0  # samples that a memory lasts
_PLAYS = (0.1, 0.2, 0.3, 0.45)  # shares of half the input's range
_LASTING, _WAVES = (0.05, 0.12, 0.25), (1.0, 2.0, 3.0, 4.0, 6.0)
_TURNED = 0.1  # of an input's largest size, that it must have in the other direction too
_RINGS_S, _PERIODS_S = (2.0, 6.0), (1.0, 1.4, 2.0, 2.8, 4.0, 5.6)
_NAMES = ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z")


def generic_columns(scene: Scene, channel: int) -> Iterator[tuple[str, Array]]:
    """Yield name and columns (n, k) of every generic function for a channel."""
    for name, column in _single_columns(scene, channel):
        yield name, column[:, None]
    yield from _dying_waves(scene)
    yield from _ringing(scene)


def _dying_waves(scene: Scene) -> Iterator[tuple[str, Array]]:
    """Yield waves that die out from the start of the record on: two poles of a transient."""
    span_s = float(scene.time_s[-1] - scene.time_s[0])
    along = (scene.time_s - scene.time_s[0]) / span_s
    for lasting in _LASTING:
        for waves in _WAVES:
            decay, phase = np.exp(-along / lasting), 2.0 * np.pi * waves * along
            name = f"wave of {waves:g} periods that dies out in {lasting * span_s:.0f} s"
            yield name, np.column_stack([decay * np.cos(phase), decay * np.sin(phase)])


def _ringing(scene: Scene) -> Iterator[tuple[str, Array]]:
    """Yield what rings after every change of the rate of turn."""
    if not scene.turns():
        return
    interval_s = scene.seen.interval_s
    knocks = np.linalg.norm(np.diff(scene.seen.gyro_radps, axis=0, prepend=scene.seen.gyro_radps[:1]), axis=1)
    for lasting_s in _RINGS_S:
        for period_s in _PERIODS_S:
            pole = np.exp((2j * np.pi / period_s - 1.0 / lasting_s) * interval_s)
            rings = lfilter([1.0], [1.0, -pole], knocks.astype(np.complex128))
            name = f"ringing of {period_s:g} s after turns, {lasting_s:g} s long"
            yield name, np.column_stack([rings.real, rings.imag])


def _single_columns(scene: Scene, channel: int) -> Iterator[tuple[str, Array]]:
    seen = scene.seen
    n = seen.time_s.size
    phase = np.pi * (np.arange(n) + 0.5) / n
    for k in range(1, 7):
        yield f"cos {k}/2 of the span", np.cos(k * phase)
    inputs = np.hstack([seen.accel_mps2, seen.gyro_radps])
    own = inputs[:, channel]
    largest = float(np.max(np.abs(own)))
    if largest > 0.0 and float(np.ptp(own)) > 1e-6 * largest:
        unit = own / largest
        yield "input^4", unit**4
        yield "input^5", unit**5
        yield "input^7", unit**7
        yield "sign of input", np.tanh(50.0 * unit)
        yield "root of input", np.sign(unit) * np.sqrt(np.abs(unit))
        yield "bend of input at a tenth", np.tanh(10.0 * unit)
        for span in (span for span in _MEMORY_S if span > _FEWEST_KEPT * seen.interval_s):
            decay = float(np.exp(-seen.interval_s / span))
            past, _ = lfilter([1.0 - decay], [1.0, -decay], unit, zi=np.array([decay * unit[0]]))
            yield f"memory of input, {span:g} s", past - unit
        for share in _PLAYS:
            yield f"hysteresis of input, {share:g} of its range", _play(unit, 0.5 * share * float(np.ptp(unit))) - unit
    if scene.warm and np.ptp(seen.temperature_c[:, 0]) > 0.3:
        warmth = seen.temperature_c[:, 0] - seen.temperature_c[:, 0].mean()
        warmth = warmth / np.max(np.abs(warmth))
        yield "temperature^2", warmth**2
        yield "temperature^3", warmth**3
        slope = np.gradient(warmth)
        yield "temperature slope", slope
        yield "temperature slope^2", slope**2
        yield "temperature x time", warmth * np.cos(phase)
    if scene.supplied and np.ptp(seen.supply_v) > AWAY_V:
        tension = seen.supply_v - seen.supply_v.mean()
        tension = tension / np.max(np.abs(tension))
        yield "supply^2", tension**2
        if largest > 0.0:
            yield "input x supply", own / largest * tension
    sizes = np.max(np.abs(inputs), axis=0)
    for i in range(6):
        for j in range(i + 1, 6):
            if (
                sizes[i] > 0
                and sizes[j] > 0
                and (np.ptp(inputs[:, i]) > 1e-3 * sizes[i]) | (np.ptp(inputs[:, j]) > 1e-3 * sizes[j])
            ):
                yield f"{_NAMES[i]} x {_NAMES[j]}", inputs[:, i] * inputs[:, j] / (sizes[i] * sizes[j])
    # Two others, one by its size, as friction and heat go by; of one that keeps its sign it is the product itself.
    others = [i for i in range(6) if i != channel and sizes[i] > 0]
    turned = np.minimum(-inputs.min(axis=0), inputs.max(axis=0)) > _TURNED * sizes
    for i, j in itertools.permutations(others, 2):
        if turned[j]:
            yield f"{_NAMES[i]} x size of {_NAMES[j]}", inputs[:, i] * np.abs(inputs[:, j]) / (sizes[i] * sizes[j])
    if largest > 0.0 and np.ptp(own) > 1e-3 * largest:
        yield "input x time", own / largest * np.cos(phase)


@compiled
def _play(values: Array, half_width: float) -> Array:
    """Return values (n,) as a gear with play follows them, of which any hysteresis is a sum (Prandtl-Ishlinskii)."""
    followed = np.empty_like(values)
    place = values[0]
    for i in range(len(values)):
        place = min(max(place, values[i] - half_width), values[i] + half_width)
        followed[i] = place
    return followed
