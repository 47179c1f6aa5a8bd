"""Parameters of an adopted hypothesis with their uncertainty, its shape's uncertainty included."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from inertial.documents import ParameterValue
from simulators.discrepancy.candidates import Column, Hypothesis
from simulators.discrepancy.dead_band_width import half_width
from simulators.discrepancy.evidence import Evidence, Fit
from simulators.effects import get_effect
from simulators.effects.base import unit_of

_SHIFT = {"time_constant": 0.05, "half_width": 0.02, "limit": 0.002, "reference": 0.5, "nominal": 0.1}
_UNTOLD = {"reference": 100.0, "nominal": 30.0}  # σ from which on these are what they are taken to be
_REACH, _LOOKS = 4.0, 17  # σ of a time constant to either side over which its likelihood is looked at, and where
_WIDEST = 0.5  # of its logarithm, for this
_RELATIVE = ("time_constant", "half_width", "limit")


def parameters_of(
    evidence: Evidence, hypothesis: Hypothesis, everything: Sequence[Hypothesis], fit: Fit
) -> dict[str, ParameterValue]:
    """Return value and 1σ of every parameter, in SI.

    A shape is varied by fitting, beside the column, its change with the shape: to first order that change's amplitude
    is the shape's shift, and its covariance with the column's own amplitude is accounted for. A time constant's σ is
    that of its whole likelihood, which is anything but symmetric where an amplitude makes up for it.
    """
    effect = get_effect(hypothesis.effect)
    ids = [i for h in everything for i in h.columns]
    fixed = [i for h in everything if h.unit_amplitude for i in h.columns]
    shapes = [name for name in hypothesis.shape if name != "rides"]
    change = _change(evidence, hypothesis, shapes[0]) if shapes else None
    late = None
    if change is not None:
        column, shift = change
        evidence.library.columns.append(column)
        late = len(evidence.library.columns) - 1
        fit = evidence.fit([*ids, late], fit, fixed)
    free = [i for i in fit.ids if i not in fixed]
    sigma = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    values: dict[str, ParameterValue] = {}
    amplitudes = [p for p in effect.parameters if p.name not in hypothesis.shape]
    for parameter, i in zip(amplitudes, hypothesis.columns, strict=False):
        place = free.index(i)
        unit = unit_of(parameter, hypothesis.channel)
        values[parameter.name] = ParameterValue(value=float(fit.amplitude[place]), sigma=float(sigma[place]), unit=unit)
    for parameter in effect.parameters:
        name = parameter.name
        if name not in hypothesis.shape:
            continue
        value, spread = hypothesis.shape[name], None
        if late is not None and name == shapes[0]:
            place = free.index(late)
            size = 1.0 if hypothesis.unit_amplitude else float(fit.amplitude[free.index(hypothesis.columns[0])])
            if size != 0.0:
                moved, spread = float(fit.amplitude[place]) * shift / size, abs(float(sigma[place]) * shift / size)
                if spread > _UNTOLD.get(name, np.inf):  # a constant beside it makes up for any other
                    spread = None
                else:
                    value += moved if abs(moved) < 2.0 * spread else 0.0
        if name == "frequency":
            spread = _frequency_sigma(evidence, values)
            values = _with_phase(values)
        if name == "time":
            spread = max(spread or 0.0, _change_point_sigma(evidence, hypothesis, fit))
        values[name] = ParameterValue(value=float(value), sigma=spread, unit=unit_of(parameter, hypothesis.channel))
    if hypothesis.effect == "dead_band":
        values = _by_samples(evidence, hypothesis, values)
    if shapes == ["time_constant"] and values["time_constant"].sigma:
        values = _by_likelihood(evidence, hypothesis, everything, fit, values)
    return values


def _by_samples(
    evidence: Evidence, hypothesis: Hypothesis, values: dict[str, ParameterValue]
) -> dict[str, ParameterValue]:
    """Return a dead band's half-width as its samples say, where they say it."""
    ((name, mean),) = values.items()
    read = half_width(evidence.library.scenes, hypothesis.channel, mean.value)
    return values if read is None else {name: mean.model_copy(update={"value": read.value, "sigma": read.sigma})}


def _by_likelihood(
    evidence: Evidence,
    hypothesis: Hypothesis,
    everything: Sequence[Hypothesis],
    fit: Fit,
    values: dict[str, ParameterValue],
) -> dict[str, ParameterValue]:
    """Return an amplitude and its time constant with their rms about these values over the likelihood of both.

    All time constants on a logarithmic scale count alike, up to the longest that the record can tell from a constant.
    """
    amplitude, shape = values.items()
    middle, width = shape[1].value, min((shape[1].sigma or 0.0) / shape[1].value, _WIDEST)
    others = [h for h in everything if h is not hypothesis]
    fixed = [i for h in others if h.unit_amplitude for i in h.columns]
    found = []
    for place in np.linspace(-_REACH, _REACH, _LOOKS):
        at = middle * float(np.exp(place * width))
        if place > 0.0 and at > evidence.library.longest_s:
            break
        trial = evidence.library.trial(hypothesis.effect, hypothesis.channel, {shape[0]: at}, hypothesis.places)
        if trial is None:
            continue
        one = evidence.fit([i for h in (*others, trial) for i in h.columns], fit, fixed)
        column = one.ids.index(trial.columns[0])
        found.append((at, one.value, one.amplitude[column], one.covariance[column, column]))
        evidence.library.forget(trial)
    at, value, size, variance = np.array(found).T
    weight = np.exp(value - value.max())
    spreads = {
        amplitude[0]: variance + (size - amplitude[1].value) ** 2,
        shape[0]: (at - middle) ** 2,
    }
    return {
        name: values[name].model_copy(update={"sigma": float(np.sqrt(weight @ square / weight.sum()))})
        for name, square in spreads.items()
    }


def _change_point_sigma(evidence: Evidence, hypothesis: Hypothesis, fit: Fit) -> float:
    """Return the 1σ of a step's time [s], S the noise density: 95 % lie within 11·S/step² (Bai 1997), 1.96 times it."""
    slot = next(iter(evidence.touched(hypothesis.columns)))
    power = fit.noise[slot].power
    density = float(np.median(power[len(power) // 3 :])) * evidence.basis[slot].interval_s
    step = float(fit.amplitude[fit.ids.index(hypothesis.columns[0])])
    return 11.0 / 1.96 * density / step**2 if step != 0.0 else 0.0


def _frequency_sigma(evidence: Evidence, amplitudes: dict[str, ParameterValue]) -> float | None:
    """Return the 1σ of a line's frequency [Hz]: √3·σ_A/(π·A·T), T the record's length (Rife and Boorstyn 1974)."""
    size = float(np.linalg.norm([v.value for v in amplitudes.values()]))
    sigma = float(np.mean([v.sigma or 0.0 for v in amplitudes.values()]))
    time_s = evidence.library.scenes[0].time_s
    return float(np.sqrt(3.0)) * sigma / (np.pi * size * float(time_s[-1] - time_s[0])) if size > 0.0 else None


def _with_phase(amplitudes: dict[str, ParameterValue]) -> dict[str, ParameterValue]:
    """Return a line's cosine and sine with the σ that they have at the record's start where its frequency is not known.

    The phase there is known by half as well as at a known frequency (Rife and Boorstyn 1974).
    """
    size = max(float(np.linalg.norm([v.value for v in amplitudes.values()])), 1e-300)
    across = {name: 1.0 - (v.value / size) ** 2 for name, v in amplitudes.items()}
    return {
        name: v.model_copy(update={"sigma": (v.sigma or 0.0) * float(np.sqrt(1.0 + 3.0 * across[name]))})
        for name, v in amplitudes.items()
    }


def _change(evidence: Evidence, hypothesis: Hypothesis, name: str) -> tuple[Column, float] | None:
    """Return how the column changes when its shape is shifted, and by how much it was."""
    library = evidence.library
    value = hypothesis.shape[name]
    shift = _SHIFT.get(name, 0.0) * (value if name in _RELATIVE else 1.0)
    scene = library.scenes[0]
    if name == "time":
        shift = 2.0 * scene.seen.interval_s
    if shift == 0.0:  # a line's frequency: its change is two columns, its σ follows from the phase's
        return None
    later = library.trial(hypothesis.effect, hypothesis.channel, {name: value + shift}, hypothesis.places)
    if later is None:
        return None
    one, two = library.columns[hypothesis.columns[0]], library.columns[later.columns[0]]
    parts = {slot: two.parts[slot] - one.parts[slot] for slot in one.parts if slot in two.parts}
    if not parts or all(not np.any(p) for p in parts.values()):
        return None
    return Column(parts), shift
