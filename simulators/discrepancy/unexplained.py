"""Whether structure is left that no name explains, and which names stood beside it for want of a better one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import idct

from inertial.documents import CHANNELS
from simulators.discrepancy.adopt import MISFIT_SHARE, Adopted, Search
from simulators.discrepancy.candidates import Kind, Slot
from simulators.discrepancy.noise_names import OtherNoise

Array = NDArray[np.float64]

BURSTS = 12.0
"""Standard deviations by which the noise's power may vary from block to block."""
_BLOCK_S = 1.0
_HARMONIC = 0.01


@dataclass(frozen=True)
class Unexplained:
    """Structure without a name: plain descriptions, the names withdrawn for it, misfits of names that stay."""

    terms: list[dict[str, Any]]
    withdrawn: list[Adopted]
    misfits: list[dict[str, Any]]
    bursts: list[dict[str, Any]]

    def document(self) -> dict[str, Any]:
        """Return what ``report.json`` says under ``remaining``."""
        return {"empirical": self.terms, "misfits": self.misfits, "unsteady": self.bursts}


def judge(search: Search, named: Sequence[Adopted], other_noise: Sequence[OtherNoise]) -> Unexplained:
    """Sort what was adopted without a name into misfits of a name and structure unknown."""
    terms: list[dict[str, Any]] = []
    misfits: list[dict[str, Any]] = []
    withdrawn: list[Adopted] = []
    for curve in search.of_kind(Kind.EMPIRICAL):
        sensor = curve.hypothesis.channel
        beside = [a for a in named if sensor in _sensors(a, search)]
        largest = max((a.gain for a in beside), default=0.0)
        entry = _described(curve, search)
        if curve.gain < MISFIT_SHARE * largest:
            misfits.append({**entry, "of": max(beside, key=lambda a: a.gain).hypothesis.effect})
            continue
        terms.append(entry)
        withdrawn += [a for a in beside if a.gain < 20.0 * curve.gain and _single(a, search)]
    for small in named:
        for large in named:
            both = _single(small, search) and _sensors(small, search) == _sensors(large, search)
            if small is not large and both and small.gain < MISFIT_SHARE * large.gain and small not in withdrawn:
                withdrawn.append(small)
                misfits.append({**_described(small, search), "of": large.hypothesis.effect})
    lines = _harmonics(search, named)
    if lines:
        withdrawn += [a for a in lines if a not in withdrawn]
        channel = lines[0].hypothesis.channel
        frequencies = sorted(a.hypothesis.shape["frequency"] for a in lines)
        terms.append({"kind": "periodic", "channel": channel, "term": "harmonics of one line", "hertz": frequencies})
    for noise in other_noise:
        low, high = noise.band_hz
        text = f"noise of another colour from {low:.2g} to {high:.2g} Hz"
        terms.append({"kind": "noise", "channel": noise.channel, "term": text, "evidence_nats": noise.gain})
    bursts = _unsteady(search)
    terms += [{"kind": "bursts", **burst} for burst in bursts]
    return Unexplained(terms, withdrawn, misfits, bursts)


def _sensors(adopted: Adopted, search: Search) -> set[str]:
    return {CHANNELS[c] for _, c in search.evidence.touched(adopted.hypothesis.columns)}


def _single(adopted: Adopted, search: Search) -> bool:
    return len(_sensors(adopted, search)) == 1


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


def _harmonics(search: Search, named: Sequence[Adopted]) -> list[Adopted]:
    """Return the lines of one channel that are overtones of its lowest, as far as the record can tell; or none."""
    time_s = search.evidence.library.scenes[0].time_s
    resolution_hz = 0.4 / float(time_s[-1] - time_s[0])
    for channel in CHANNELS:
        lines = [a for a in named if a.hypothesis.effect == "sinusoid" and a.hypothesis.channel == channel]
        if len(lines) < 2:
            continue
        frequencies = [a.hypothesis.shape["frequency"] for a in lines]
        lowest = min(frequencies)
        off = [abs(f - lowest * round(f / lowest)) for f in frequencies]
        near = [o < resolution_hz * f / lowest + _HARMONIC * lowest for o, f in zip(off, frequencies, strict=True)]
        if all(near) or len(lines) > 2:
            return lines
    return []


def _unsteady(search: Search) -> list[dict[str, Any]]:
    """Return channels whose whitened remainder has more power in some seconds than in others."""
    found = []
    for slot in search.evidence.slots:
        z, when = _burst_score(search, slot)
        if z > BURSTS:
            text = "noise in bursts"
            found.append({"channel": CHANNELS[slot[1]], "term": text, "at_s": when, "sigmas": z})
    return found


def _burst_score(search: Search, slot: Slot) -> tuple[float, float]:
    evidence, library = search.evidence, search.evidence.library
    basis = evidence.basis[slot]
    left = library.residual[slot].copy()
    for i, amplitude in zip(search.fit.ids, search.fit.amplitude, strict=True):
        part = library.columns[i].parts.get(slot)
        if part is not None:
            left -= amplitude * part
    weight = np.repeat(1.0 / np.sqrt(search.fit.noise[slot].power), basis.counts.astype(np.int64))
    white = np.asarray(idct(weight * left, norm="ortho"))
    length = max(8, round(_BLOCK_S / basis.interval_s))
    count = basis.n // length
    if count < 20:
        return 0.0, 0.0
    squares = np.minimum(white**2, 25.0)[: count * length].reshape(count, length)
    means = squares.mean(axis=1)
    expected = float(squares.var()) / length
    z = (float(means.var()) / expected - 1.0) * math.sqrt(count / 2.0)
    scene = library.scenes[slot[0]]
    return z, float(scene.time_s[0] + (int(np.argmax(means)) + 0.5) * length * basis.interval_s)
