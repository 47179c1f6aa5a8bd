"""The search: adopt what explains most, beyond chance and beyond what names nothing, until only noise is left.

The best of a ranking is adopted if its Bayes factor, less the penalty for all places looked at, passes a margin. What
larger noise with a name, or a curve without one, does better is not adopted under a name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.fft import idct

from inertial.documents import CHANNELS
from simulators.discrepancy.candidates import Hypothesis, Kind
from simulators.discrepancy.evidence import Evidence, Fit, bayes_factor
from simulators.discrepancy.margins import FURTHER, MARGIN, TIE
from simulators.discrepancy.noise_instead import NoiseInstead, beyond_noise, held_against_noise, noise_instead
from simulators.discrepancy.ranking import Ranking, Scored, plainest
from simulators.discrepancy.retuning import best_retuned
from simulators.discrepancy.sparse import find_sparse
from simulators.discrepancy.two_names import Together, in_place_of_curve, in_place_of_one, in_place_of_two, together

Progress = Callable[[float, str], None]

MOST_FINDINGS = 8
_AT_LAST = 0.8  # share of the margin that a name still has at the end of the search
_SHARPENED = 3
_FEW = 2  # steps and lines together that are still names
_FELT = 0.5  # σ of a sample by which the reference's errors must move the input to be felt by a readout
_NEAR_TURN_S = 0.3  # of a turn's end, where what the turn does begins or ends
_NEAR_IT = 0.25  # share of a curve's evidence that a name must have to be asked whether it could still do as well
_LIKE_IT = 1.02  # times a name's evidence that a curve may have and still only mend its form


@dataclass(eq=False)
class Adopted:
    """An adopted hypothesis, beside all others; its rivals, best first, once they were looked for (:mod:`.rivals`)."""

    hypothesis: Hypothesis
    gain: float
    score: float
    ties: list[Scored] = field(default_factory=list)
    rivals: list[Scored] = field(default_factory=list)
    pairs: list[Together] = field(default_factory=list)
    """Two names each that tie with it, best first."""
    instead: tuple[NoiseInstead, float] | None = None
    """Larger noise on its sensor that ties with it, and how far behind it is [nats]."""
    noise_nats: float = 0.0
    """Evidence of noise that it makes, in which what could stand in its place would have to be larger by itself."""


@dataclass(frozen=True)
class Search:
    """Outcome: what was adopted, the fit with it, the fit of the noise alone; ``left()``: what leads beside it all."""

    evidence: Evidence
    adopted: list[Adopted]
    fit: Fit
    bare: Fit
    left: Callable[[], list[Scored]]

    def of_kind(self, kind: Kind) -> list[Adopted]:
        """Return what was adopted of one kind."""
        return [a for a in self.adopted if a.hypothesis.kind is kind]

    def with_instead(self, entry: Adopted, other: Adopted) -> Search:
        """Return the search with another adopted in the place of one."""
        adopted = [other if one is entry else one for one in self.adopted]
        everything = [one.hypothesis for one in adopted]
        ranking = Ranking(self.evidence)
        fit = ranking.fit_of(everything, self.fit)
        return replace(self, adopted=adopted, fit=fit, left=partial(ranking.rank, fit, everything))

    def gains(self, hypothesis: Hypothesis) -> dict[str, float]:
        """Return what one of the adopted gains [nats] by channel: what the others with it would lose without it."""
        others = [a.hypothesis for a in self.adopted if a.hypothesis is not hypothesis]
        fixed = [i for h in others if h.unit_amplitude for i in h.columns]
        without = self.evidence.fit([i for h in others for i in h.columns], self.fit, fixed)
        gains: dict[str, float] = {}
        for slot in self.evidence.slots:
            channel = CHANNELS[slot[1]]
            change = self.evidence.slot_value(slot, self.fit) - self.evidence.slot_value(slot, without)
            gains[channel] = gains.get(channel, 0.0) + max(change, 0.0)
        return gains


class Searcher:
    """One search over a library; ``beside`` whether names were found, and undone, before it."""

    def __init__(self, evidence: Evidence, progress: Progress | None = None, *, beside: bool = False) -> None:
        self.evidence, self.library, self.ranking = evidence, evidence.library, Ranking(evidence)
        self.progress, self.beside = progress or _silent, beside

    def run(self) -> Search:
        """Search until nothing more passes the margin, or two names have put each other out in turn."""
        bare = self.evidence.fit([])
        if self.evidence.restate(bare.rss) | self.evidence.stand(bare):
            bare = self.evidence.fit([])
        self._correct(bare)
        adopted: list[Hypothesis] = []
        current = bare
        been: set[tuple[str, ...]] = set()
        while len(adopted) < MOST_FINDINGS and (state := _state(adopted)) not in been:
            been.add(state)
            self.progress(0.3 + 0.5 * len(adopted) / MOST_FINDINGS, f"looking beyond {len(adopted)} effects")
            known = len(adopted)
            adopted, current = self._with_new(current, adopted)
            if len(adopted) == known:
                split = in_place_of_one(self.ranking, adopted, current, self._margin(adopted))
                if split is None:
                    break
                adopted, current = split
            adopted, current = self.ranking.polish(*self._settle(adopted, current, adopted[:known]))
            adopted, current = in_place_of_two(self.ranking, adopted, current) or (adopted, current)
            if self.evidence.restate(current.rss):
                bare, current = self.evidence.fit([]), self.ranking.fit_of(adopted)
        adopted, current = self._settle(adopted, current, adopted, _AT_LAST)
        left = partial(self.ranking.rank, current, adopted)
        return Search(self.evidence, self._beside_others(adopted, current), current, bare, left)

    def _beside_others(self, adopted: Sequence[Hypothesis], current: Fit) -> list[Adopted]:
        """Return what each of the adopted gains when all others are there."""
        found = []
        for h in adopted:
            rest = [other for other in adopted if other is not h]
            own = self.ranking.score(h, self.ranking.fit_of(rest, current), rest)
            if own is not None:
                found.append(Adopted(h, own.gain, own.score))
        return found

    def _correct(self, bare: Fit) -> None:
        """Let readout effects act on the input with the reference's own errors in it, where these are to be felt."""
        for slot in self.evidence.slots:
            scene = self.library.scenes[slot[0]]
            if scene.group > 1:
                continue
            off = self.library.residual[slot] - self.library.left(slot, bare.ids, bare.amplitude)
            change = idct(off, norm="ortho") * self.library.spread[slot]
            if np.max(np.abs(change)) > _FELT * scene.noise_sigma[slot[1]]:
                self.library.correct(slot, np.asarray(change))

    def _with_new(self, current: Fit, adopted: Sequence[Hypothesis]) -> tuple[list[Hypothesis], Fit]:
        """Return what is adopted and what is next, a hypothesis, two names or what noise has swallowed; their fit."""
        best = self._next(current, adopted)
        if best is not None and best.hypothesis.kind is Kind.NAMED:
            return best_retuned(self.ranking, best, adopted, current)
        if best is not None and best.hypothesis.kind is Kind.REFERENCE:
            return [*adopted, best.hypothesis], best.fit
        pair = together(self.ranking, adopted, current, self._margin(adopted))
        if pair is not None and (best is None or pair[0] > best.score - TIE):
            score, both, fit = pair
            columns = [i for h in both[len(adopted) :] for i in h.columns]
            # What one name does not do better than noise, the second must do by the margin of a further one.
            if not self._is_noise(score, columns, fit, current, FURTHER):
                return both, fit
        if best is None:
            return self._swallowed(adopted, current)
        return in_place_of_curve(self.ranking, best, adopted, current) or ([*adopted, best.hypothesis], best.fit)

    def _margin(self, adopted: Sequence[Hypothesis]) -> float:
        """Return the evidence that the next name must have."""
        return FURTHER if self.beside or any(h.kind is Kind.NAMED for h in adopted) else MARGIN

    def _next(self, current: Fit, adopted: Sequence[Hypothesis]) -> Scored | None:
        margin = self._margin(adopted)
        scored = self.ranking.rank(current, adopted)
        named = [
            s
            for s in scored
            if s.hypothesis.kind is Kind.NAMED and not self._is_noise(s.score, s.hypothesis.columns, s.fit, current)
        ]
        other = [s for s in scored if s.hypothesis.kind is Kind.REFERENCE]
        curves = [s for s in scored if s.hypothesis.kind is Kind.EMPIRICAL]
        best = plainest(named)
        if other and other[0].score > MARGIN and (best is None or other[0].score >= best.score):
            best = other[0]
        curve = curves[0] if curves else None
        if best is not None and curve is not None and curve.score > best.score:
            near = [s for s in named[:_SHARPENED] if s.score > _NEAR_IT * curve.score]
            sharp = [self.ranking.sharpened(s, current, adopted) for s in near]
            named = sorted([*sharp, *named[len(near) :]], key=lambda s: -s.score)
            best = max((best, named[0]), key=lambda s: s.score)
        certain = -math.inf if best is None else self._certain(best, named)
        shown = curve is not None and curve.score > margin and beyond_noise(self.evidence, curve, current)[0] > margin
        # That something is there the curve has shown, or noise that is larger without a name.
        least = MARGIN if shown or (best is not None and self._took_its_place(best, current)) else margin
        if curve is not None and shown and curve.score > least + (_LIKE_IT * certain if certain > least else 0.0):
            return self._pair(named[:4], adopted, curve) or curve
        return best if certain > least else None

    def _is_noise(self, score: float, columns: Sequence[int], fit: Fit, current: Fit, least: float = 0.0) -> bool:
        """Whether a name or two do not explain at least so much more than larger noise, or nearly where that is unsure.

        A walk of a coefficient or two is as good a shift or drift: where neither is certain, both are told.
        """
        if score <= 0.0:
            return False
        beyond, noise = held_against_noise(self.evidence, score, columns, fit, current)
        return noise is not None and beyond < least - (0.0 if noise.certain else TIE)

    def _took_its_place(self, one: Scored, current: Fit) -> bool:
        """Whether noise that is larger than stated, of no name, has taken for itself what one may explain.

        Such is noise that only the mean asks for, of which one coefficient is all that shows. Not a mount's sway, which
        several gyros show.
        """
        channels = self.evidence.channels(one.hypothesis.columns)
        slots = [slot for slot in self.evidence.slots if slot[1] in channels]
        if len(channels) != 1 or any(self.evidence.stated[slot] is None for slot in slots):
            return False
        larger = any(not self.evidence.is_told(slot, current) for slot in slots)
        return larger and not noise_instead(self.evidence, current, channels.pop()).names

    def _certain(self, best: Scored, named: Sequence[Scored]) -> float:
        """Return the evidence that one of the names that tie with the best is there, whichever it is.

        Of hypotheses that share one penalty of looking the Bayes factors add up.
        """
        ties = [s for s in named if s is not best and s.score > best.score - TIE]
        return best.score + math.log1p(sum(math.exp(s.score - best.score) for s in ties))

    def _swallowed(self, adopted: Sequence[Hypothesis], current: Fit) -> tuple[list[Hypothesis], Fit]:
        """Return what is adopted with what wide noise has swallowed, a name or a step, a line or two; their fit.

        That something is there is certain by then, so that the name needs no more evidence than to stay.
        """
        for one in find_sparse(self.evidence, current):
            if one.sweep_hz or (one.repeats_hz and len(one.lines_hz) > _FEW):
                continue  # no name is like it
            named = [s for s in self.ranking.rank(current, adopted) if s.hypothesis.kind is Kind.NAMED]
            named = [s for s in named if one.slot in self.evidence.touched(s.hypothesis.columns)]
            if named and named[0].score > _AT_LAST * MARGIN:
                return [*adopted, named[0].hypothesis], named[0].fit
            if len(one.steps) + len(one.lines_hz) > _FEW:
                continue
            trials = [self.ranking.shapes.step(one.slot, first) for first in one.steps]
            trials += [self.ranking.shapes.line(one.slot, hertz) for hertz in one.lines_hz]
            new = [trial for trial in trials if trial is not None]
            fit = self.ranking.fit_of([*adopted, *new], current)
            count = sum(h.freedom for h in new)
            places = math.prod(self.ranking.places(h) for h in new)
            if bayes_factor(fit.value - current.value, count, places) > _AT_LAST * MARGIN:  # or it would not stay
                return [*adopted, *new], fit
        return list(adopted), current

    def _pair(self, named: Sequence[Scored], adopted: Sequence[Hypothesis], curve: Scored) -> Scored | None:
        """Return the first of two names that together explain as much as a curve does.

        Steps at both ends of a turn do not count: they are what the turn does.
        """
        for first in named:
            if first.score < max(MARGIN, _NEAR_IT * curve.score):
                continue
            least = max(MARGIN, curve.score - TIE - first.score)
            seconds = self.ranking.names_beside(first.fit, [*adopted, first.hypothesis], least)
            if self._ends_a_turn(first.hypothesis):
                seconds = [s for s in seconds if not self._ends_a_turn(s.hypothesis)]
            if seconds and seconds[0].score > least:
                return first
        return None

    def _ends_a_turn(self, one: Hypothesis) -> bool:
        """Whether it is a step where a turn begins or ends."""
        at = np.array([one.shape["time"]]) if one.effect == "bias_step" else np.empty(0)
        return any(scene.near_turn_ends(at, _NEAR_TURN_S).any() for scene in self.library.scenes)

    def _settle(
        self, adopted: list[Hypothesis], current: Fit, judged: Sequence[Hypothesis], share: float = 0.5
    ) -> tuple[list[Hypothesis], Fit]:
        """Drop those of the judged that the others, or a finer fit of noise and shapes, have made needless.

        Such keep less than a ``share`` of the margin that they passed.
        """
        for h in judged:
            rest = [other for other in adopted if other is not h]
            without = self.ranking.fit_of(rest, current)
            if bayes_factor(current.value - without.value, h.freedom, self.ranking.places(h)) < share * MARGIN:
                return self._settle(rest, without, [other for other in judged if other is not h], share)
        return adopted, current


def _state(adopted: Sequence[Hypothesis]) -> tuple[str, ...]:
    """Return what is adopted, by names and about what shapes."""
    return tuple(sorted(f"{h.name} {[f'{value:.2g}' for value in h.shape.values()]}" for h in adopted))


def _silent(share: float, text: str) -> None:
    del share, text
