"""Which recording to make next: of those a launcher or a table could make, the one that splits names best.

For each, the model predicts what the leading name would add and how well its rival could imitate that; half the squared
whitened distance left is the evidence [nats] to be expected. Where nothing was found, the same is asked of every effect
of the library at the least of its typical sizes: which of them could hide in these data, and where would they show?
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.recording import Recording
from drivers.recording_meta import MotionMeta, TurnMeta, VibrationMeta
from drivers.samples import empty_samples
from inertial.documents import CHANNELS, BlockModel, ChannelNoise, Noise
from simulators.discrepancy.candidates import Hypothesis, Kind, Library, Slot
from simulators.discrepancy.compare import Scene, compare
from simulators.discrepancy.evidence import Evidence, Fit
from simulators.discrepancy.noise_instead import NoiseInstead
from simulators.discrepancy.whitening import STATED
from simulators.effects import effects, get_effect
from simulators.effects.base import Effect, LinearEffect, Stage
from simulators.effects.size_effect import SizeEffect
from simulators.effects.thermal_lag import ThermalLag

Array = NDArray[np.float64]

RATE_HZ = 5.0
MOST_IMAGINED = 6_000
"""Samples of an imagined recording; a longer one is imagined at a lower rate."""
REST_S = 1200.0
MOVED_S = 300.0
HIDDEN_NATS = 12.0
"""Evidence below which an effect may be there unseen: margin, Occam factor and places looked at, together."""
_MOST_NATS = 50.0  # beyond which more evidence tells nothing more


@dataclass(frozen=True)
class Proposal:
    """A recording, what it would tell about, and the evidence [nats] to be expected from it."""

    name: str
    text: str
    about: str
    expected_nats: float


@dataclass(frozen=True)
class _Plan:
    name: str
    text: str
    duration_s: float
    motion: tuple[MotionMeta, ...] = ()
    rise_c: float = 0.0
    swing_v: float = 0.0


def _turn(start_s: float, end_s: float, rate_dps: float, axis: list[float]) -> TurnMeta:
    return TurnMeta(kind="turn", start_s=start_s, end_s=end_s, rate_dps=rate_dps, axis=axis, frame="body")


_X, _Y, _Z = [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]
PLANS = (
    _Plan("rest_longer", "twenty minutes at rest", REST_S),
    _Plan(
        "second_attitude",
        "five minutes in six attitudes: a quarter turn about x, then y, then z, and again",
        MOVED_S,
        tuple(_turn(40.0 * k + 20.0, 40.0 * k + 29.0, 10.0, (_X, _Y, _Z)[k % 3]) for k in range(6)),
    ),
    _Plan(
        "slow_turn",
        "turns of 2 deg/s about each axis, both ways",
        MOVED_S,
        tuple(
            _turn(45.0 * k + 5.0, 45.0 * k + 45.0, (2.0, -2.0)[k % 2], (_X, _X, _Y, _Y, _Z, _Z)[k]) for k in range(6)
        ),
    ),
    _Plan(
        "fast_turn",
        "turns of 60 deg/s and 20 deg/s about each axis, both ways",
        MOVED_S,
        tuple(
            _turn(24.0 * k + 6.0, 24.0 * k + 18.0, (60.0, -60.0, 20.0, -20.0)[k % 4], (_X, _Y, _Z)[k // 4])
            for k in range(12)
        ),
    ),
    _Plan(
        "vibration",
        "rest, a minute and a half of 1 g rms vibration from 10 to 40 Hz, rest",
        MOVED_S,
        (
            VibrationMeta(
                kind="vibration", start_s=100.0, end_s=190.0, axis=[1.0, 1.0, 1.0], grms=1.0, band_hz=[10.0, 40.0]
            ),
        ),
    ),
    _Plan("heat", "twenty minutes at rest while the block warms by 20 K and cools again", REST_S, rise_c=20.0),
    _Plan("supply", "five minutes at rest while the supply goes from 24 V to 32 V and back", MOVED_S, swing_v=4.0),
)


def _plans(evidence: Evidence) -> tuple[_Plan, ...]:
    """Return the plans; the rest is to be longer than what there is."""
    span_s = max(float(scene.data.edges_s[-1] - scene.data.edges_s[0]) for scene in evidence.library.scenes)
    if 2.0 * span_s <= REST_S:
        return PLANS
    rest = replace(PLANS[0], text="a rest twice as long as this recording", duration_s=2.0 * span_s)
    return (rest, *PLANS[1:])


@dataclass(frozen=True)
class Rival:
    """One name or two that stand in the place of a leader, or of it and one other."""

    names: Sequence[Hypothesis]
    but: Hypothesis | None = None


@dataclass(frozen=True)
class Question:
    """A leader and its nearest rivals, and larger noise if that ties."""

    leader: Hypothesis
    rivals: Sequence[Rival]
    instead: NoiseInstead | None


def propose(evidence: Evidence, fit: Fit, questions: Sequence[Question]) -> list[list[Proposal]]:
    """Return for each question the recordings, the most telling between leader and rivals first."""
    scene = evidence.library.scenes[0]
    model = scene.model.model_copy(update={"noise": _noise(evidence, fit)})
    names = {asked.leader.name for asked in questions}
    for rival in itertools.chain(*(asked.rivals for asked in questions)):
        names |= {h.name for h in (*rival.names, *([rival.but] if rival.but else []))}
    answers: list[list[Proposal]] = [[] for _ in questions]
    for plan in _plans(evidence) if questions else ():
        imagined = Evidence(Library([_imagined(scene, model, plan)], only=names))
        for answer, asked in zip(answers, questions, strict=True):
            name = f"{asked.leader.effect} on {asked.leader.channel}"
            answer.append(Proposal(plan.name, plan.text, name, _expected(imagined, asked, fit)))
    return [sorted(answer, key=lambda p: -p.expected_nats) for answer in answers]


def propose_longer(evidence: Evidence, term: str, channel: str, nats: float) -> Proposal:
    """Return the recording for noise or lines without a name: evidence on them grows with the time at rest."""
    scene = evidence.library.scenes[0]
    rest = _plans(evidence)[0]
    longer = rest.duration_s / float(scene.data.edges_s[-1] - scene.data.edges_s[0])
    return Proposal(rest.name, rest.text, f"{term} on {channel}", nats * longer)


def propose_unseen(evidence: Evidence, fit: Fit) -> list[Proposal]:
    """Return the recordings that would show most of the effects that could hide in these data, the best first."""
    scene = evidence.library.scenes[0]
    power = {slot: fit.noise[slot].power for slot in evidence.slots}
    seen = _visible(evidence, power)
    wanted = {(e.name, c) for e in effects().values() for c in e.channel_names() if _least(e, c) is not None}
    hidden = {name for name in wanted if seen.get(name, 0.0) < HIDDEN_NATS}
    model = scene.model.model_copy(update={"noise": _noise(evidence, fit)})
    proposals: list[tuple[float, Proposal]] = []
    for plan in _plans(evidence):
        imagined = Evidence(Library([_imagined(scene, model, plan)], only=hidden, plain=True))
        shown = _visible(imagined, {slot: imagined.power(slot) for slot in imagined.slots})
        if not shown:
            continue
        effect, channel = max(shown, key=lambda name: shown[name])
        total = sum(min(nats, _MOST_NATS) for nats in shown.values())
        count = sum(nats >= HIDDEN_NATS for nats in shown.values())
        about = f"{effect} on {channel}" + (f" and {count - 1} more that could hide here" if count > 1 else "")
        proposals.append((total, Proposal(plan.name, plan.text, about, shown[effect, channel])))
    return [proposal for _, proposal in sorted(proposals, key=lambda one: -one[0])]


def _visible(evidence: Evidence, power: dict[Slot, Array]) -> dict[tuple[str, str], float]:
    """Return the evidence [nats] that each effect would give at the least of its typical sizes, at its plainest shape.

    What the reference may be off is left to it.
    """
    shown: dict[tuple[str, str], float] = {}
    information = evidence.information(power)
    for h in evidence.library.hypotheses:
        size = _least(get_effect(h.effect), h.channel) if h.kind is Kind.NAMED else None
        if size is not None and not h.unit_amplitude:
            own = float(np.mean(np.diag(information)[list(h.columns)]))
            shown[h.name] = max(shown.get(h.name, 0.0), 0.5 * size**2 * own)
    return shown


def _least(effect: Effect, channel: str) -> float | None:
    """Return the least typical size [SI] of an effect's first parameter, none where it is a shape or has none."""
    if not isinstance(effect, LinearEffect | SizeEffect | ThermalLag) and effect.stage is not Stage.SETUP:
        return None
    parameter = effect.parameters[0]
    kind = "accel" if channel.startswith("accel") else "gyro"
    span = parameter.typical.get(kind, parameter.typical.get("any"))
    return None if span is None else span.low


def _noise(evidence: Evidence, fit: Fit) -> Noise:
    """Return each channel's noise: as stated where it is, else white of the density found in the middle of the band."""
    found = {}
    for c, name in enumerate(CHANNELS):
        if evidence.stated[0, c] is not None and fit.noise[0, c].level == STATED:
            found[name] = getattr(evidence.library.scenes[0].model.noise, name)
            continue
        power = fit.noise[0, c].power
        density = float(np.exp(np.mean(np.log(power[len(power) // 4 : len(power) // 2]))))
        found[name] = ChannelNoise(white=float(np.sqrt(density * evidence.basis[0, c].interval_s)))
    return Noise(**found)


def _imagined(scene: Scene, model: BlockModel, plan: _Plan) -> Scene:
    rate_hz = min(RATE_HZ, MOST_IMAGINED / plan.duration_s)
    count = round(plan.duration_s * rate_hz)
    samples = empty_samples(count)
    samples["sequence"] = np.arange(count)
    samples["time"] = np.arange(1, count + 1) / rate_hz
    phase = np.clip(samples["time"] / plan.duration_s, 0.0, 1.0)
    samples["temperature"][:, 0] = 20.0 + plan.rise_c * np.sin(np.pi * phase) ** 2
    samples["supply"] = 28.0 - plan.swing_v * np.cos(2.0 * np.pi * phase)
    meta = scene.recording.meta
    block = meta.block.model_copy(update={"sample_rate_hz": rate_hz, "model": None, "calibration": None})
    meta = meta.model_copy(update={"motion": list(plan.motion), "window": [], "block": block, "columns": {}})
    imagined = compare(Recording(samples, meta, Path(plan.name), Path(plan.name)), model)
    # Nothing was measured: what the comparison took for the vibration's course is set to nothing.
    return replace(imagined, measured=imagined.predicted.copy())


def _expected(evidence: Evidence, asked: Question, fit: Fit) -> float:
    library, leader = evidence.library, asked.leader
    own = _imagine(library, leader, fit)
    if own is None:
        return 0.0
    power = {slot: evidence.power(slot) for slot in evidence.slots}
    least = _distance(evidence, power, [own], ())
    rivals = {(tuple(h.name for h in one.names), one.but and one.but.name): one.but for one in asked.rivals}
    for (names, _), but in rivals.items():
        both = [own] if but is None else [own, _imagine(library, but, fit)]
        told = [one for one in both if one is not None]
        if leader.name not in names:  # counted from elsewhere, with a constant beside it: no recording tells that apart
            for other in itertools.product(*([h for h in library.hypotheses if h.name == name] for name in names)):
                least = min(least, _distance(evidence, power, told, [i for h in other for i in h.columns]))
    if asked.instead is not None:
        slot = 0, CHANNELS.index(asked.instead.channel)
        power[slot] = evidence.basis[slot].stated(asked.instead.noise, 0.0)
        least = min(least, _distance(evidence, power, [own], ()))
    return least


def _imagine(library: Library, adopted: Hypothesis, fit: Fit) -> tuple[Hypothesis, Array] | None:
    """Return what is most like an adopted name in an imagined recording, and its amplitudes; none if nothing is."""
    own = [h for h in library.hypotheses if h.name == adopted.name]
    if not own:
        return None
    wanted = min(own, key=lambda h: _shape_distance(h, adopted))
    amplitude = np.array([fit.amplitude[fit.ids.index(i)] for i in adopted.columns])
    return wanted, amplitude[: len(wanted.columns)]


def _shape_distance(one: Hypothesis, two: Hypothesis) -> float:
    near = 0.0
    for name, value in one.shape.items():
        near += abs(float(np.log((abs(value) + 1e-9) / (abs(two.shape.get(name, value)) + 1e-9))))
    return near


def _distance(
    evidence: Evidence, power: dict[Slot, Array], told: Sequence[tuple[Hypothesis, Array]], others: Sequence[int]
) -> float:
    """Return half the squared whitened length of what is ``told`` and neither nuisances nor ``others`` imitate."""
    wanted, amplitude = [i for h, _ in told for i in h.columns], np.concatenate([size for _, size in told])
    ids = [*wanted, *evidence.prior, *others]
    k = len(wanted)
    matrix, _ = evidence.normal(ids, power)
    for place, i in enumerate(ids):
        if i in evidence.prior:
            matrix[place, place] += 1.0 / evidence.prior[i] ** 2
    inside = matrix[:k, :k]
    if len(ids) > k:
        rest = matrix[k:, k:] + 1e-10 * np.diag(np.diag(matrix[k:, k:]) + 1e-300)
        inside = inside - matrix[:k, k:] @ np.linalg.solve(rest, matrix[k:, :k])
    return float(0.5 * amplitude @ inside @ amplitude)
