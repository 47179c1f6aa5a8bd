"""The whole of it: compare, name, add, show. ``discrepancy()`` is the Python call; the report is plain data."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.recording import Recording
from inertial.documents import CHANNELS, BlockModel, EffectEntry, ParameterValue
from simulators.discrepancy.adopt import Adopted, Search, Searcher
from simulators.discrepancy.candidates import REWIRED, Hypothesis, Kind, Library, Slot
from simulators.discrepancy.clipping import find_clipped
from simulators.discrepancy.compare import MOST_SAMPLES, Scene, compare, following_vibrations
from simulators.discrepancy.edge_noise import told_by_noise
from simulators.discrepancy.evidence import Evidence, Fit, bayes_factor
from simulators.discrepancy.gap import navigation_gap, rms, where
from simulators.discrepancy.heldout import HeldOut
from simulators.discrepancy.influence import gains_but, too_few_samples
from simulators.discrepancy.lateness import as_late
from simulators.discrepancy.margins import FALSE_ALARM_RATE, MARGIN, TIE
from simulators.discrepancy.mount_sway import angle_rad
from simulators.discrepancy.next_recording import Question, Rival, propose, propose_longer, propose_unseen
from simulators.discrepancy.noise_names import TERMS, NamedNoise, NoiseFinding, name_noise
from simulators.discrepancy.outliers import Outlier, find_outliers
from simulators.discrepancy.parameters import parameters_of
from simulators.discrepancy.read_off import ReadOff, combined
from simulators.discrepancy.remarks import remarks
from simulators.discrepancy.rivals import find_rivals, names_instead
from simulators.discrepancy.silence import find_silenced
from simulators.discrepancy.silenced_noise import WITHOUT, told_by_silence
from simulators.discrepancy.standing import Stuck, find_stuck, without_stuck
from simulators.discrepancy.steady_clock import at_steady_rate
from simulators.discrepancy.stood_between_steps import stood_between_steps
from simulators.discrepancy.switched_on import since_switch_on
from simulators.discrepancy.time_tags import TimeTags, find_time_tags
from simulators.discrepancy.unexplained import Unexplained, judge
from simulators.discrepancy.whitening import LEVELS
from simulators.discrepancy.wiring import Mistake, find_mistakes, mend
from simulators.discrepancy.words import in_words
from simulators.effects import get_effect
from simulators.effects.base import SampleEffect, unit_of
from simulators.model_store import save_model

Array = NDArray[np.float64]
Progress = Callable[[float, str], None]

SCHEMA = "inertrim/discrepancy/1"
_SURE = 100.0  # nats of a limit or a dead band whose samples are taken out
_MOSTLY = 0.5  # share of a channel's samples
_WIDE = 1.5  # σ of a sample that such a band is wide at least
OF_THE_RECORDING = frozenset({"lost_samples", "stuck_samples"})
"""Effects that happened to a recording and are no property of the block: reported, not added to its model."""


@dataclass(frozen=True)
class Report:
    """What was found. ``document`` is ``report.json``; ``model`` the model with it added, or the one given."""

    document: dict[str, Any]
    model: BlockModel
    scenes: tuple[Scene, ...]
    search: Search

    @property
    def verdict(self) -> str:
        """``named``, ``tie``, ``unknown`` or ``none``."""
        return str(self.document["verdict"])

    @property
    def findings(self) -> list[dict[str, Any]]:
        """What was named, the most evident first."""
        return list(self.document["findings"])


def discrepancy(
    recordings: Sequence[Recording], model: BlockModel, out: Path | None = None, progress: Progress | None = None
) -> Report:
    """Find where recordings and a block's model disagree, name what is missing, add it, show the gap shrink.

    Parameters
    ----------
    recordings : of the same block.
    model : what the simulator believes of it.
    out : folder for ``report.json``, ``report.html`` and the new model; none: nothing is written.
    progress : called with the share done and a word on what is being done.

    Raises
    ------
    RecordingError, ScenarioError, DocumentError
        A recording or the model cannot be used; the text says which, why and what to do.
    ValueError
        No recording.
    """
    if not recordings:
        raise ValueError("no recording given; give one or more")
    tell = progress or _silent
    tell(0.02, "predicting")
    counted = at_steady_rate(since_switch_on(recordings))
    raw = _compared(counted, model)
    mistakes = find_mistakes(raw)

    def again(tags: TimeTags) -> list[Scene]:
        return _mended(_compared([tags.undone(recording) for recording in counted], model), mistakes)

    mended = _mended(raw, mistakes)
    tags, mended = find_time_tags(mended, again) or (None, mended)
    scenes, stuck, read_off, outliers = [], [], [], []
    for scene in mended:
        within, clipped = find_clipped(scene)
        heard, silenced = find_silenced(within)
        free, standing = find_stuck(heard)
        tame, wild = find_outliers(free)
        scenes.append(tame)
        stuck += standing
        read_off += clipped + silenced
        outliers += wild
    search = _searched(scenes, tell, beside=bool(mistakes or tags or stuck or read_off))
    met, wired, stood = _met_by_noise(search), _wired(search), stood_between_steps(search)
    if met or wired or stood:
        scenes = [reduce(lambda seen, one: WITHOUT[one.effect](seen, one), met, scene) for scene in scenes]
        scenes = [without_stuck(scene, [one for place, one in stood if place == n]) for n, scene in enumerate(scenes)]
        scenes = _mended(scenes, wired)
        stuck += [one for _, one in stood]
        read_off += met
        mistakes += wired
        search = _searched(scenes, lambda share, text: tell(0.8 + 0.05 * share, text), beside=True)
    undone: list[Mistake | TimeTags] = [*mistakes, tags] if tags is not None else [*mistakes]
    report = _report(recordings, model, raw, scenes, search, undone, stuck, combined(read_off), outliers, tell)
    if out is not None:
        _write(report, out)
    tell(1.0, "done")
    return report


def _compared(recordings: Sequence[Recording], model: BlockModel) -> list[Scene]:
    return [compare(recording, model, MOST_SAMPLES // len(recordings)) for recording in recordings]


def _mended(scenes: list[Scene], mistakes: list[Mistake]) -> list[Scene]:
    return [_rewired(scene, mistakes) for scene in scenes] if mistakes else scenes


def _searched(scenes: list[Scene], tell: Progress, *, beside: bool) -> Search:
    tell(0.1, "listing what could explain")
    library = Library(as_late(scenes))
    tell(0.25, "gathering")
    evidence = Evidence(library)
    return told_by_silence(told_by_noise(Searcher(evidence, tell, beside=beside).run()))


def _met_by_noise(search: Search) -> list[ReadOff]:
    """Return limits and dead bands that were named and have no rival, met by the noise: what they leave is no noise."""
    named = [a for a in search.of_kind(Kind.NAMED) if a.hypothesis.effect in WITHOUT and a.score > _SURE]
    found = []
    for one in _without_rival(search, named):
        h, everything = one.hypothesis, [a.hypothesis for a in search.adopted]
        (size,) = parameters_of(search.evidence, h, everything, search.fit).values()
        noise = max(float(scene.noise_sigma[CHANNELS.index(h.channel)]) for scene in search.evidence.library.scenes)
        if h.effect == "saturation" or size.value > _WIDE * noise:
            found.append(ReadOff(h.effect, h.channel, size.value, size.sigma or 0.0, one.score))
    return found


def _wired(search: Search) -> list[Mistake]:
    """Return mistakes of wiring that were too little to be seen before, but named: each sensor has its own noise."""
    named = [a for a in search.of_kind(Kind.NAMED) if a.hypothesis.effect in REWIRED]
    return [
        Mistake(one.hypothesis.effect, one.hypothesis.channel, explained=2.0 * one.score)
        for one in _without_rival(search, named)
    ]


def _without_rival(search: Search, named: Sequence[Adopted]) -> list[Adopted]:
    find_rivals(search, named, _silent)
    return [one for one in named if not one.ties and not one.pairs]


def _rewired(scene: Scene, mistakes: list[Mistake]) -> Scene:
    exchanged = [one for one in mistakes if one.effect == "axis_swap"]
    missing = mend(scene.data.missing.astype(np.float64), exchanged) > 0.0
    data = replace(scene.data, sent=mend(scene.data.sent, mistakes), missing=missing)
    return following_vibrations(replace(scene, measured=mend(scene.measured, mistakes), data=data))


def _report(
    recordings: Sequence[Recording],
    model: BlockModel,
    raw: list[Scene],
    scenes: list[Scene],
    search: Search,
    undone: Sequence[Mistake | TimeTags],
    stuck: list[Stuck],
    read_off: list[ReadOff],
    outliers: list[Outlier],
    tell: Progress,
) -> Report:
    evidence = search.evidence
    held = HeldOut(evidence, search.fit)
    whole = held.gap()
    named, rejected = _kept(search, held)
    noise = name_noise(evidence, search.fit)
    silenced = {a.hypothesis.channel for a in named if isinstance(get_effect(a.hypothesis.effect), SampleEffect)}
    unexplained = judge(search, named, noise, silenced | {one.channel for one in read_off})
    named = [a for a in named if not any(a is other for other in unexplained.withdrawn)]
    curves = sorted(unexplained.curves, key=lambda a: -a.score)[:1]
    find_rivals(search, [*named, *curves], lambda share, text: tell(0.85 + 0.1 * share, text))
    tell(0.95, "writing down")
    findings = [finding for one in undone for finding in _undone_findings(one, search)]
    findings += _repair_findings(scenes, stuck)
    findings += [_read_off_finding(one, scenes) for one in read_off]
    findings += sorted((_finding(a, search, held) for a in named), key=lambda f: -f["evidence_nats"])
    no_noise = {term["channel"] for term in unexplained.unsteady} | silenced  # a dead band that comes and goes is noise
    no_noise |= {one.channel for one in read_off if _mostly_gone(scenes, one.channel)}
    # An error in the form of a large name is noise to what is left of it.
    off = {m["channel"]: m["evidence_nats"] for m in sorted(unexplained.misfits, key=lambda m: m["evidence_nats"])}
    more = [n for n in noise.found if n.channel not in no_noise and n.score > off.get(n.channel, 0.0)]
    findings += [_noise_finding(n, search) for n in more]
    verdict = "none"
    if unexplained.terms:
        verdict = "unknown"
    elif any(f["alternatives"] for f in findings):
        verdict = "tie"
    elif findings:
        verdict = "named"
    added = _entries(findings, recordings)
    child = _child(model, added) if added else model
    slots = evidence.slots
    before, after = whole.rms(slots)
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "verdict": verdict,
        "text": "",
        "findings": findings,
        "remaining": unexplained.document(),
        "reference": [_reference(a, search.fit) for a in search.of_kind(Kind.REFERENCE)] + _sway(noise),
        "rejected": rejected,
        "remarks": remarks(recordings),
        "outliers": [asdict(one) for one in outliers],
        "gap": {
            "whitened_rms": {"before": rms(search, slots, search.bare), "after": rms(search, slots, search.fit)},
            "heldout_rms": {"before": before, "after": after},
            "structured_share": _structured(search, slots),
            "navigation_m": navigation_gap(raw, scenes, search),
            "steps": _steps(search),
        },
        "where": where(search),
        "noise": _noise_document(search),
        "false_alarm_rate": FALSE_ALARM_RATE,
        "model": {"parent": model.sha256(), "sha256": child.sha256() if added else None},
        "inputs": _inputs(recordings),
        "next_recording": [],
    }
    document["next_recording"] = _next(search, named, curves, findings, unexplained)
    document["text"] = in_words(document)
    return Report(document, child, tuple(scenes), search)


def _kept(search: Search, held: HeldOut) -> tuple[list[Adopted], list[dict[str, Any]]]:
    """Keep the names that predict what their fit did not see; say of the others why not."""
    named, rejected = [], []
    for adopted in search.of_kind(Kind.NAMED):
        reason = _refused(adopted.hypothesis, search, held)
        if reason is None:
            named.append(adopted)
        else:
            h = adopted.hypothesis
            rejected.append({"effect": h.effect, "channel": h.channel, "reason": reason})
    return named, rejected


def _refused(h: Hypothesis, search: Search, held: HeldOut) -> str | None:
    """Say why a name is not to be kept; none: it is."""
    if h.unit_amplitude:
        return None
    gained = held.gained(h.columns)
    if gained <= 0.0:
        return f"does not predict held-out data better (by {gained:.1f} in χ²)"
    few = too_few_samples(h)
    whole, others = gains_but(search.evidence, h, search.fit, few)
    if others < min(0.5 * whole, MARGIN + len(h.columns)):
        which = "a single sample (without it" if few == 1 else f"{few} samples (without them"
        return f"rests on {which} {others:.1f} of {whole:.1f} nats are left)"
    return None


def _mostly_gone(scenes: Sequence[Scene], channel: str) -> bool:
    """Whether most of a channel was taken out: much of what is left is ends of gaps, where rounding adds to noise."""
    gone = [scene.data.missing[:, CHANNELS.index(channel)] for scene in scenes]
    return float(np.mean(np.concatenate(gone))) > _MOSTLY


def _finding(adopted: Adopted, search: Search, held: HeldOut) -> dict[str, Any]:
    h, evidence = adopted.hypothesis, search.evidence
    everything = [a.hypothesis for a in search.adopted]
    values = parameters_of(evidence, h, everything, search.fit)
    slots = sorted(evidence.touched(h.columns))
    before, after = held.gap(h.columns).rms(slots)
    without = [x for other in everything if other is not h for x in other.columns]
    rest = evidence.fit(
        without, search.fit, [x for o in everything if o.unit_amplitude and o is not h for x in o.columns]
    )
    return {
        "effect": h.effect,
        "channel": h.channel,
        "parameters": {name: value.model_dump() for name, value in values.items()},
        "confidence": _confidence(adopted),
        "alternatives": _alternatives(adopted),
        "runners_up": [
            _rival(s.hypothesis, adopted.score - s.score)
            for s in adopted.rivals
            if s.hypothesis.kind is Kind.NAMED and s.score <= adopted.score - TIE
        ],
        "evidence_nats": adopted.score,
        "size_sigma": math.sqrt(max(2.0 * adopted.gain, 0.0)),
        "gap_before": rms(search, slots, rest),
        "gap_after": rms(search, slots, search.fit),
        "heldout_before": before,
        "heldout_after": after,
        "text": get_effect(h.effect).text,
    }


def _confidence(adopted: Adopted) -> float:
    """Return the probability of this name among those that were looked at, and that it is there at all."""
    scores = [s.score for s in adopted.ties] + [adopted.score - pair.behind for pair in adopted.pairs]
    scores += [adopted.score - adopted.instead[1]] if adopted.instead is not None else []
    odds = sum(math.exp(min(score - adopted.score, 50.0)) for score in scores) + math.exp(-adopted.score)
    return 1.0 / (1.0 + odds)


def _alternatives(adopted: Adopted) -> list[dict[str, Any]]:
    """Return what ties with a name: names, and then those that do only together with another, each once."""
    found = [_rival(s.hypothesis, adopted.score - s.score) for s in adopted.ties]
    if adopted.instead is not None:
        noise, behind = adopted.instead
        found += [{"effect": name, "channel": noise.channel, "behind_nats": behind} for name in noise.names]
    known = {adopted.hypothesis.name, *(s.hypothesis.name for s in adopted.ties)}
    for pair in adopted.pairs:
        for h, other in (pair.hypotheses, pair.hypotheses[::-1]):
            if h.name not in known:
                known.add(h.name)
                also = {"together_with": _told(other)} | ({"in_place_of_both": _told(pair.but)} if pair.but else {})
                found.append({**_rival(h, pair.behind), **also})
    return found


def _rival(hypothesis: Hypothesis, behind: float) -> dict[str, Any]:
    return {**_told(hypothesis), "behind_nats": behind}


def _told(hypothesis: Hypothesis) -> dict[str, str]:
    return {"effect": hypothesis.effect, "channel": hypothesis.channel}


def _plain(
    effect: str, channel: str, parameters: dict[str, ParameterValue], evidence: float, before: float, after: float
) -> dict[str, Any]:
    return {
        "effect": effect,
        "channel": channel,
        "parameters": {name: value.model_dump() for name, value in parameters.items()},
        "confidence": 1.0 - math.exp(-min(evidence, 50.0)),
        "alternatives": [],
        "runners_up": [],
        "evidence_nats": evidence,
        "size_sigma": math.sqrt(2.0 * max(evidence, 0.0)),
        "gap_before": before,
        "gap_after": after,
        "heldout_before": before,
        "heldout_after": after,
        "text": get_effect(effect).text,
    }


def _undone_findings(one: Mistake | TimeTags, search: Search) -> list[dict[str, Any]]:
    if isinstance(one, Mistake):
        return [_wiring_finding(one, search)]
    before, after = _undone_rms(search, search.evidence.slots, one.explained)
    found = []
    if one.delay_sigma_s:
        delay = ParameterValue(value=one.delay_s, sigma=one.delay_sigma_s, unit="s")
        late = _plain("latency", "all", {"delay": delay}, 0.5 * one.explained, before, after)
        if len(one.told_by) == 1:
            late["alternatives"] = [{"effect": "latency", "channel": one.told_by[0], "behind_nats": 0.0}]
        found.append(late)
    if one.clock_sigma:
        error = ParameterValue(value=one.clock_error, sigma=one.clock_sigma, unit="1")
        found.append(_plain("clock_scale", "all", {"error": error}, 0.5 * one.explained, before, after))
    return found


def _undone_rms(search: Search, slots: Sequence[Slot], explained: float) -> tuple[float, float]:
    """Return the whitened RMS with what was undone, which explains so much in χ², and without."""
    after = rms(search, slots, search.fit)
    count = sum(search.evidence.basis[s].n for s in slots)
    return math.sqrt(after**2 + explained / max(count, 1)), after


def _wiring_finding(mistake: Mistake, search: Search) -> dict[str, Any]:
    values = {}
    if mistake.effect == "unit_error":
        values["factor"] = ParameterValue(value=mistake.factor, sigma=0.0, unit="1")
    names = [n for part in mistake.channel.split("<-") for n in CHANNELS if n.startswith(part)]
    slots = [s for s in search.evidence.slots if CHANNELS[s[1]] in names]
    before, after = _undone_rms(search, slots, mistake.explained)
    finding = _plain(mistake.effect, mistake.channel, values, 0.5 * mistake.explained, before, after)
    behind = 0.5 * mistake.explained - bayes_factor(0.5 * mistake.explained, 1, 1.0)
    if mistake.constant and mistake.effect != "axis_swap" and behind < TIE:  # a shift of just that size
        finding["alternatives"] = [{"effect": "bias_shift", "channel": mistake.channel, "behind_nats": behind}]
    return finding


def _repair_findings(scenes: list[Scene], stuck: list[Stuck]) -> list[dict[str, Any]]:
    findings = []
    frames = sum(len(scene.time_s) for scene in scenes)
    lost = sum(scene.data.lost for scene in scenes)
    if lost:
        share = lost / frames
        sigma = math.sqrt(share * (1.0 - share) / frames)
        value = {"fraction": ParameterValue(value=share, sigma=sigma, unit="1")}
        findings.append(_plain("lost_samples", "all", value, 50.0, 1.0, 1.0))
    for one in stuck:
        values = {
            "start": ParameterValue(value=one.start_s, sigma=one.sigma_s, unit="s"),
            "duration": ParameterValue(value=one.duration_s, sigma=math.sqrt(2.0) * one.sigma_s, unit="s"),
        }
        findings.append(_plain("stuck_samples", one.channel, values, 50.0, 1.0, 1.0))
    return findings


def _read_off_finding(one: ReadOff, scenes: list[Scene]) -> dict[str, Any]:
    parameter = get_effect(one.effect).parameters[0]
    value = ParameterValue(value=one.value, sigma=one.sigma, unit=unit_of(parameter, one.channel))
    frames = sum(len(scene.time_s) for scene in scenes)
    before = math.sqrt(1.0 + 2.0 * one.nats / frames)
    return _plain(one.effect, one.channel, {parameter.name: value}, one.nats, before, 1.0)


def _noise_finding(noise: NoiseFinding, search: Search) -> dict[str, Any]:
    parameter, _ = TERMS[noise.effect]
    effect = get_effect(noise.effect)
    unit = unit_of(effect.parameters[0], noise.channel)
    slots = [s for s in search.evidence.slots if CHANNELS[s[1]] == noise.channel]
    squares = count = 0.0
    for slot in slots:
        stated = search.evidence.stated[slot]
        if stated is not None:
            squares += float(np.sum(search.fit.rss[slot] / stated))
            count += search.evidence.basis[slot].n
    value, sigma = noise.value, noise.sigma
    if noise.effect == "quantisation":  # the step itself, of which the noise found is what goes beyond the step stated
        stated_step = getattr(search.evidence.library.scenes[0].model.noise, noise.channel).quantisation
        value = math.hypot(noise.value, stated_step)
        sigma *= noise.value / value
    values = {parameter: ParameterValue(value=value, sigma=sigma, unit=unit)}
    before, after = math.sqrt(squares / max(count, 1.0)), rms(search, slots, search.fit)
    finding = _plain(noise.effect, noise.channel, values, noise.score, before, after)
    finding["alternatives"] = [{"effect": t, "channel": noise.channel, "behind_nats": 1.5} for t in noise.ties]
    finding["alternatives"] += [_rival(h, behind) for h, behind in names_instead(search, noise.channel)]
    return finding


def _reference(adopted: Adopted, fit: Fit) -> dict[str, Any]:
    h = adopted.hypothesis
    return {
        "error": h.effect,
        "of": h.channel,
        "evidence_nats": adopted.score,
        "values": [float(fit.amplitude[fit.ids.index(i)]) for i in h.columns],
        "text": _REFERENCE_TEXT[h.effect],
    }


def _sway(noise: NamedNoise) -> list[dict[str, Any]]:
    """Return the sway of the mount, if it does: σ of its angle [rad], if a gyro tells it, and correlation time [s]."""
    if noise.sway is None:
        return []
    correlation_s = noise.sway.correlation_s
    angle = angle_rad(noise.sway, noise.swaying)
    size = "" if angle is None else f" by {angle * 1e6:.2g} µrad (1σ)"
    return [
        {
            "error": "mount_sway",
            "of": ", ".join(noise.sway.evidence_nats),
            "evidence_nats": sum(noise.sway.evidence_nats.values()),
            "values": ([] if angle is None else [angle]) + [correlation_s],
            "text": f"the mount sways{size}, forgetting its angle within {correlation_s:.2g} s",
        }
    ]


_REFERENCE_TEXT = {
    "turn_timing": "the turns did not start and stop when stated (seconds late, start and end of each turn)",
    "turn_angle": "the turns were not as large as stated (radians each)",
    "turn_timing_and_angle": "the turns were neither timed nor sized as stated",
    "turn_axis": "the turns were about other axes than stated (radians, two for each turn)",
    "turn_motion": "the turns differed from what is stated in time, size and axis",
    "lever_arm": "the block did not turn about its own centre (metres along x, y, z)",
}


def _structured(search: Search, slots: Sequence[Slot]) -> dict[str, float]:
    """Return the share of the residual's variance that is more than noise, before and after."""
    shares = {}
    for name, fit in (("before", search.bare), ("after", search.fit)):
        value = rms(search, slots, fit) ** 2
        shares[name] = max(0.0, 1.0 - 1.0 / value) if value > 0.0 else 0.0
    return shares


def _steps(search: Search) -> list[dict[str, Any]]:
    """Return the whitened RMS as the findings go in one after the other."""
    evidence = search.evidence
    steps = [{"added": "nothing", "whitened_rms": rms(search, evidence.slots, search.bare)}]
    so_far: list[Hypothesis] = []
    for adopted in search.adopted:
        so_far.append(adopted.hypothesis)
        fit = evidence.fit(
            [i for h in so_far for i in h.columns],
            search.fit,
            [i for h in so_far if h.unit_amplitude for i in h.columns],
        )
        label = f"{adopted.hypothesis.effect} on {adopted.hypothesis.channel}"
        steps.append({"added": label, "whitened_rms": rms(search, evidence.slots, fit)})
    return steps


def _noise_document(search: Search) -> dict[str, Any]:
    """Return the noise found, as white density and the slow terms' share, by channel."""
    document = {}
    for slot in search.evidence.slots:
        power, basis = search.fit.noise[slot].power, search.evidence.basis[slot]
        white = math.sqrt(float(np.median(power[len(power) // 2 :])) * basis.interval_s)
        level = LEVELS[search.fit.noise[slot].level]
        document[f"{slot[0]}:{CHANNELS[slot[1]]}"] = {"white": white, "level": level}
    return document


def _next(
    search: Search,
    named: Sequence[Adopted],
    curves: Sequence[Adopted],
    findings: Sequence[dict[str, Any]],
    unexplained: Unexplained,
) -> list[dict[str, Any]]:
    """Return proposals for what has no name, else for the least certain finding, else for what may hide unseen.

    Each finding gets its own best one as well.
    """
    evidence, fit = search.evidence, search.fit
    asked = [*named, *curves]
    questions = [Question(a.hypothesis, _asked_of(a), a.instead[0] if a.instead else None) for a in asked]
    answers = [[asdict(p) for p in answer] for answer in propose(evidence, fit, questions)]
    by_name = {a.hypothesis.name: answer for a, answer in zip(asked, answers, strict=True)}
    for finding in findings:
        name = finding["effect"], finding["channel"]
        longer = propose_longer(evidence, finding["effect"], finding["channel"], finding["evidence_nats"])
        finding["next_recording"] = by_name.get(name, [asdict(longer)])[:1]
    if curves:
        return by_name[curves[0].hypothesis.name]
    if unexplained.terms:
        term = unexplained.terms[0]
        return [asdict(propose_longer(evidence, term["term"], term["channel"], float(term["evidence_nats"])))]
    if named:
        return by_name[min(named, key=lambda a: (not (a.ties or a.pairs or a.instead), a.score)).hypothesis.name]
    return [asdict(proposal) for proposal in propose_unseen(evidence, fit)]


def _asked_of(adopted: Adopted) -> list[Rival]:
    """Return what a next recording is to tell a name from: what ties with it, else its nearest rivals."""
    tied = [Rival([s.hypothesis]) for s in adopted.ties]
    tied += [Rival(pair.hypotheses, pair.but) for pair in adopted.pairs]
    if tied or adopted.instead is not None:
        return tied
    return [Rival([s.hypothesis]) for s in adopted.rivals[:2] if s.hypothesis.kind is Kind.NAMED]


def _child(model: BlockModel, added: list[EffectEntry]) -> BlockModel:
    """Return the model with effects added; a readout in coarser steps takes the place of the steps that it had."""
    steps = {entry.channel for entry in added if entry.effect == "quantisation"}
    finer = {name: getattr(model.noise, name).model_copy(update={"quantisation": 0.0}) for name in steps}
    update = {"parent": model.sha256(), "effects": [*model.effects, *added]}
    return model.model_copy(update={**update, "noise": model.noise.model_copy(update=finer)} if steps else update)


def _entries(findings: list[dict[str, Any]], recordings: Sequence[Recording]) -> list[EffectEntry]:
    entries = []
    for finding in findings:
        if finding["effect"] in OF_THE_RECORDING:
            continue
        kept = ("evidence_nats", "confidence", "gap_before", "gap_after", "heldout_before", "heldout_after")
        evidence = {name: finding[name] for name in kept}
        evidence["alternatives"] = finding["alternatives"]
        evidence["rejected"] = finding["runners_up"]
        evidence["recordings"] = _inputs(recordings)
        parameters = {name: ParameterValue(**value) for name, value in finding["parameters"].items()}
        sigma = next((p.sigma for p in parameters.values()), None)
        entries.append(
            EffectEntry(
                effect=finding["effect"],
                channel=finding["channel"],
                parameters=parameters,
                sigma=sigma,
                evidence=evidence,
            )
        )
    return entries


def _inputs(recordings: Sequence[Recording]) -> dict[str, str]:
    inputs: dict[str, str] = {}
    for recording in recordings:
        if recording.path.is_file() and recording.meta_path.is_file():
            inputs.update(recording.inputs())
    return inputs


def _write(report: Report, out: Path) -> None:
    """Write the report as JSON and HTML, and the new model beside them."""
    from simulators.discrepancy.page import render

    out.mkdir(parents=True, exist_ok=True)
    for name, text in (
        ("report.json", json.dumps(report.document, indent=2, allow_nan=False) + "\n"),
        ("report.html", render(report)),
    ):
        part = out / f"{name}.part"
        part.write_text(text, encoding="utf-8")
        part.replace(out / name)
    digest = report.document["model"]["sha256"]
    if digest:
        save_model(report.model, out / f"{digest}.json")


def _silent(share: float, text: str) -> None:
    del share, text
