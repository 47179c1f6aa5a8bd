"""Whether structure is left that no name explains, and which names stood beside it for want of a better one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import idct

from inertial.documents import CHANNELS
from simulators.discrepancy.adopt import Adopted, Search
from simulators.discrepancy.candidates import Kind, Slot
from simulators.discrepancy.noise_names import OtherNoise

Array = NDArray[np.float64]

MISFIT_SHARE = 0.05
"""A curve that gains less than this share of a name's evidence on the same sensor is that name's misfit."""
PHANTOM_SHARE = 0.01
"""A name that gains less than this share of another's on the same sensor only mends the other's form."""
BURSTS = 12.0
"""Standard deviations by which the noise's power may vary from block to block."""
_BLOCK_S = 1.0
_HARMONIC = 0.01


@dataclass(frozen=True)
class Unexplained:
    """Structure without a name: plain descriptions, the names withdrawn for it, misfits of names that stay.

    ``curves`` are the adopted curves among it.
    """

    terms: list[dict[str, Any]]
    curves: list[Adopted]
    withdrawn: list[Adopted]
    misfits: list[dict[str, Any]]
    bursts: list[dict[str, Any]]

    def document(self) -> dict[str, Any]:
        """Return what ``report.json`` says under ``remaining``."""
        return {"empirical": self.terms, "misfits": self.misfits, "unsteady": self.bursts}


def judge(search: Search, named: Sequence[Adopted], other_noise: Sequence[OtherNoise]) -> Unexplained:
    """Sort what was adopted without a name into misfits of a name and structure unknown.

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
            if small is not large and weak and small not in withdrawn and _mostly_on(gains[id(small)], channel):
                withdrawn.append(small)
                misfits.append({**_described(small, search), "of": large.hypothesis.effect})
    lines = _harmonics(search, named)
    if lines:
        withdrawn += lines
        terms.append(
            {
                "kind": "periodic",
                "channel": lines[0].hypothesis.channel,
                "term": "harmonics of one line",
                "evidence_nats": sum(a.gain for a in lines),
                "hertz": sorted(a.hypothesis.shape["frequency"] for a in lines),
            }
        )
    for noise in other_noise:
        low, high = noise.band_hz
        text = f"noise of another colour from {low:.2g} to {high:.2g} Hz"
        terms.append({"kind": "noise", "channel": noise.channel, "term": text, "evidence_nats": noise.gain})
    bursts = _unsteady(search)
    terms += [{"kind": "bursts", **burst} for burst in bursts]
    return Unexplained(terms, curves, withdrawn, misfits, bursts)


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
            entry = {"channel": CHANNELS[slot[1]], "term": text, "at_s": when, "sigmas": z}
            found.append({**entry, "evidence_nats": 0.5 * z**2})
    return found


def _burst_score(search: Search, slot: Slot) -> tuple[float, float]:
    """Return by how many σ the whitened power varies from block to block, and the time of the largest.

    Blocks with samples that are no measurement, which are smooth, do not count.
    """
    library = search.evidence.library
    basis, scene = search.evidence.basis[slot], library.scenes[slot[0]]
    left = library.left(slot, search.fit.ids, search.fit.amplitude)
    weight = np.repeat(1.0 / np.sqrt(search.fit.noise[slot].power), basis.counts.astype(np.int64))
    white = np.asarray(idct(weight * left, norm="ortho"))
    length = max(8, round(_BLOCK_S / basis.interval_s))
    count = basis.n // length
    missing = scene.data.missing[: count * length * scene.group, slot[1]].reshape(count, -1).any(axis=1)
    if np.sum(~missing) < 20:
        return 0.0, 0.0
    squares = np.minimum(white**2, 25.0)[: count * length].reshape(count, length)[~missing]
    means = squares.mean(axis=1)
    expected = float(squares.var()) / length
    z = (float(means.var()) / expected - 1.0) * math.sqrt(len(means) / 2.0)
    worst = int(np.flatnonzero(~missing)[int(np.argmax(means))])
    return z, float(scene.time_s[0] + (worst + 0.5) * length * basis.interval_s)
