"""Whether structure is left that no name explains, and which names stood beside it for want of a better one."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import idct

from inertial.documents import CHANNELS
from simulators.discrepancy.adopt import Adopted, Search
from simulators.discrepancy.bursts import find_bursts
from simulators.discrepancy.candidates import Kind
from simulators.discrepancy.noise_names import NamedNoise
from simulators.discrepancy.nonstationarity import Unsteady, find_unsteady
from simulators.discrepancy.sparse import Sparse, find_sparse

Array = NDArray[np.float64]

MISFIT_SHARE = 0.05
"""A curve that gains less than this share of a name's evidence on the same sensor is that name's misfit."""
SILENCED_SHARE = 0.2
"""Jumps of less than this share of a limit's or a dead band's evidence are what it does to the noise near its edge."""
PHANTOM_SHARE = 0.01
"""A name that gains less than this share of another's on the same sensor only mends the other's form."""
_MANY_LINES = 4
_FEW_STEPS = 2  # of one channel that are still shocks of their own
_FORM_S, _FORM_ERROR = 1.0, 0.3  # over which a form is looked at, and the share of it that an error of it may be
_HARMONIC, _BAND, _DOMINANT = 0.01, 1.3, 0.9


@dataclass(frozen=True)
class Unexplained:
    """Structure without a name: plain descriptions, the names withdrawn for it, misfits of names that stay.

    ``curves`` are the adopted curves among it.
    """

    terms: list[dict[str, Any]]
    curves: list[Adopted]
    withdrawn: list[Adopted]
    misfits: list[dict[str, Any]]
    unsteady: list[dict[str, Any]]

    def document(self) -> dict[str, Any]:
        """Return what ``report.json`` says under ``remaining``."""
        return {"empirical": self.terms, "misfits": self.misfits, "unsteady": self.unsteady}


def judge(search: Search, named: Sequence[Adopted], noise: NamedNoise, silenced: Collection[str]) -> Unexplained:
    """Sort what was adopted without a name into misfits of a name and structure unknown.

    ``silenced``: channels whose noise comes and goes because a limit or a dead band silences it.
    A name whose evidence lies on a channel with structure unknown stood in for it, and is withdrawn.
    """
    gains = {id(a): search.gains(a.hypothesis) for a in named}
    terms: list[dict[str, Any]] = []
    curves: list[Adopted] = []
    misfits: list[dict[str, Any]] = []
    withdrawn: list[Adopted] = []
    for curve in search.of_kind(Kind.EMPIRICAL):
        sensor = curve.hypothesis.channel
        beside = [a for a in named if gains[id(a)].get(sensor, 0.0) * MISFIT_SHARE > curve.gain]
        entry = _described(curve, search)
        if beside:
            misfits.append({**entry, "of": max(beside, key=lambda a: a.gain).hypothesis.effect})
            continue
        terms.append(entry)
        curves.append(curve)
        withdrawn += [a for a in named if _mostly_on(gains[id(a)], sensor)]
    for small in named:
        for large in named:
            channel, among = max(gains[id(small)].items(), key=lambda one: one[1], default=("", 0.0))
            weak = among < PHANTOM_SHARE * gains[id(large)].get(channel, 0.0)
            weak &= small is not large and small not in withdrawn and _mostly_on(gains[id(small)], channel)
            if weak and _mends(search, small, large, channel):
                withdrawn.append(small)
                misfits.append({**_described(small, search), "of": large.hypothesis.effect})
    for channel in CHANNELS:
        lines = [a for a in named if a.hypothesis.effect == "sinusoid" and a.hypothesis.channel == channel]
        largest = max(lines, key=lambda a: a.gain, default=None)
        if largest is not None and largest.gain > _DOMINANT * sum(a.gain for a in lines):
            for small in lines:  # what swells and wanes has lines beside its own
                if small is not largest and small not in withdrawn:
                    withdrawn.append(small)
                    misfits.append({**_described(small, search), "of": "sinusoid"})
            continue
        text = _together(search, lines)
        if text is None:
            continue
        total = sum(a.gain for a in lines)
        withdrawn += lines + _stood_in(named, gains, channel, total)
        hertz = sorted(a.hypothesis.shape["frequency"] for a in lines)
        terms.append({"kind": "periodic", "channel": channel, "term": text, "evidence_nats": total, "hertz": hertz})
    for channel in CHANNELS:
        steps = [a for a in named if a.hypothesis.name == ("bias_step", channel)]
        if len(steps) > _FEW_STEPS:
            total = sum(a.gain for a in steps)
            withdrawn += steps + _stood_in(named, gains, channel, total)
            term = f"{len(steps)} jumps"
            terms.append({"kind": "sparse", "channel": channel, "term": term, "evidence_nats": total})
    for other in (n for n in noise.other if n.channel not in silenced):
        low, high = other.band_hz
        text = f"noise of another colour from {low:.2g} to {high:.2g} Hz"
        terms.append({"kind": "noise", "channel": other.channel, "term": text, "evidence_nats": other.gain})
    swallowed = [
        _swallowed(one)
        for one in find_sparse(search.evidence, search.fit)
        if CHANNELS[one.slot[1]] not in silenced or one.nats > SILENCED_SHARE * _most(gains, CHANNELS[one.slot[1]])
    ]
    restless = [one for one in _unsteady(search, noise) if one.channel not in silenced]
    unsteady = swallowed + [_restless(one) for one in restless]
    for found in unsteady:
        terms.append(found)
        withdrawn += _stood_in(named, gains, str(found["channel"]), float(found["evidence_nats"]))
    return Unexplained(terms, curves, withdrawn, misfits, unsteady)


def _unsteady(search: Search, noise: NamedNoise) -> list[Unsteady]:
    """Return what comes and goes, and larger white noise that does, of which low frequencies show little."""
    found = find_unsteady(search.evidence, search.fit)
    white = {one.channel for one in noise.found if one.effect == "random_walk"} - {one.channel for one in found}
    return found + find_bursts(search.evidence, search.fit, white)


def _most(gains: Mapping[int, Mapping[str, float]], channel: str) -> float:
    """Return what the name of most evidence on a channel gains there."""
    return max((one.get(channel, 0.0) for one in gains.values()), default=0.0)


def _stood_in(
    named: Sequence[Adopted], gains: Mapping[int, Mapping[str, float]], channel: str, nats: float
) -> list[Adopted]:
    """Return the names that stood in for an unknown of so many nats on a channel, where most of their evidence lies."""
    return [a for a in named if _mostly_on(gains[id(a)], channel) and a.gain * MISFIT_SHARE < nats]


def _mends(search: Search, small: Adopted, large: Adopted, channel: str) -> bool:
    """Whether a name may be no more than an error in the form of a larger one on a channel.

    Such an error is nowhere much larger than a part of the form, neither in time nor in frequency.
    """
    evidence, fit = search.evidence, search.fit
    for slot in (slot for slot in evidence.slots if CHANNELS[slot[1]] == channel):
        basis = evidence.basis[slot]
        weight = basis.each(fit.noise[slot].power ** -0.5)
        sizes = dict(zip(fit.ids, fit.amplitude, strict=True))
        one, other = (
            weight * evidence.library.added(slot, ids, np.array([sizes[i] for i in ids]))
            for ids in (small.hypothesis.columns, large.hypothesis.columns)
        )
        blocks = np.arange(0, basis.n, max(1, round(_FORM_S / basis.interval_s)))
        for values, starts in (((one, other), basis.bounds[:-1]), ((idct(one), idct(other)), blocks)):
            power, form = (np.add.reduceat(v**2, starts) for v in values)
            if np.sum(power[power > _FORM_ERROR**2 * form]) > 0.5 * np.sum(power):
                return False
    return True


def _mostly_on(gains: Mapping[str, float], channel: str) -> bool:
    """Whether half of a name's evidence or more lies on a channel."""
    return gains.get(channel, 0.0) >= 0.5 * sum(gains.values())


def _described(adopted: Adopted, search: Search) -> dict[str, Any]:
    h = adopted.hypothesis
    amplitudes = [float(search.fit.amplitude[search.fit.ids.index(i)]) for i in h.columns]
    return {
        "kind": "curve" if h.kind is Kind.EMPIRICAL else h.effect,
        "channel": h.channel,
        "term": h.effect,
        "amplitude": amplitudes[0],
        "evidence_nats": adopted.score,
    }


def _together(search: Search, lines: Sequence[Adopted]) -> str | None:
    """Return what several lines of one channel make up, as far as the record can tell; none: each is its own."""
    if len(lines) < 2:
        return None
    time_s = search.evidence.library.scenes[0].time_s
    resolution_hz = 0.4 / float(time_s[-1] - time_s[0])
    frequencies = [a.hypothesis.shape["frequency"] for a in lines]
    lowest = min(frequencies)
    if max(frequencies) < _BAND * lowest:
        return "a narrow band, not one line"
    off = [abs(f - lowest * round(f / lowest)) for f in frequencies]
    near = [o < resolution_hz * f / lowest + _HARMONIC * lowest for o, f in zip(off, frequencies, strict=True)]
    if all(near):
        return "harmonics of one line"
    return "many lines" if len(lines) > 2 else None


def _swallowed(one: Sparse) -> dict[str, Any]:
    """Return in words what a wide noise model had swallowed."""
    count = len(one.steps)
    parts = [f"{count} jump{'s' if count > 1 else ''}"] if count else []
    hertz = sorted(one.lines_hz)
    if len(hertz) > _MANY_LINES:
        parts.append(f"{len(hertz)} lines from {hertz[0]:.3g} to {hertz[-1]:.3g} Hz")
    elif hertz:
        parts.append(f"line{'s' if len(hertz) > 1 else ''} at {', '.join(f'{line:.3g}' for line in hertz)} Hz")
    if one.repeats_hz:
        parts = [f"a wave that repeats every {1.0 / one.repeats_hz:.3g} s"]
    if one.sweep_hz:
        parts.append(f"a line that sweeps from {one.sweep_hz[0]:.3g} to {one.sweep_hz[1]:.3g} Hz")
    text = " and ".join(parts)
    return {"kind": "sparse", "channel": CHANNELS[one.slot[1]], "term": text, "evidence_nats": one.nats}


def _restless(one: Unsteady) -> dict[str, Any]:
    """Return in words what comes and goes."""
    text = "what is left comes and goes"
    return {"kind": "unsteady", "channel": one.channel, "term": text, "at_s": one.at_s, "evidence_nats": one.nats}
