"""The search: adopt what explains most, beyond chance and beyond what names nothing, until only noise is left.

At each step every hypothesis is scanned at two noise models (the one fitted, and the quiet one in which nothing slow is
noise); the leaders have their shapes refined and are refitted jointly with the noise, so that a random walk is not sold
as a drift nor the other way round. The best is adopted if its Bayes factor, less the penalty for all places looked at,
passes a margin.
"""

from __future__ import annotations

import math
import operator
from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.fft import idct

from inertial.documents import CHANNELS
from simulators.discrepancy.atoms import best_line, score_of
from simulators.discrepancy.candidates import FITTED_PLACES, USUAL, Hypothesis, Kind, Slot, is_usual
from simulators.discrepancy.dead_band_width import half_width
from simulators.discrepancy.evidence import Evidence, Fit, bayes_factor
from simulators.discrepancy.look import Look
from simulators.discrepancy.noise_instead import NoiseInstead, noise_instead
from simulators.discrepancy.rounding_errors import NEAR_HZ, largest_lines
from simulators.discrepancy.sparse import find_sparse
from simulators.discrepancy.whitening import ROUNDED_AT, STATED, NoiseFit

Array = NDArray[np.float64]
Progress = Callable[[float, str], None]

MARGIN = math.log(100.0)
"""Bayes factor [nats] beyond the penalty of looking that a name must have, or all names that tie with it together.

Where nothing is hidden the mean Bayes factor of all that is looked at is 1, so that it is exp(MARGIN) once in a hundred
recordings at most (Markov).
"""
TIE = 3.0
"""Names whose fit is within so many nats of the best are one answer."""
SAME = 0.1
"""... and within so many are one column to these recordings: what lies between them is rounding."""
MOST_FINDINGS = 8
_AT_LAST = 0.8  # share of the margin that a name still has at the end of the search
_LEADERS = 12
_REFINED = 12
_SHARPENED = 3
_PAIRS, _PAIRS_LOOKED_AT = 4, 400  # of names that are tried at once
SLACK_OF_TWO = 3.0
"""Nats that refining may still add to what two names promise, of which at least one mostly has no shape to refine."""
_ORDERS = 2.0  # in which two names can be named
_FEW = 2  # steps and lines together that are still names
_BENT = 3.0  # share of its promise that a chord of the right size may add
_RETUNED = 4  # names that are tried with the shapes of others refined beside them, besides the best
_FAR = {"time_constant", "half_width", "limit", "reference", "nominal"}  # shapes that hang on all of a record
_RANKED = 3  # answers that are kept for when they are asked for again
_SAME_GAIN = 1e-6  # share of a gain by which that of the same column may be off
_STEPS_TRIED = 3  # of a channel
_STEP_NATS, _LINE_NATS = 4.0, 3.0  # that a step or a line must promise to be tried
_FELT = 0.5  # σ of a sample by which the reference's errors must move the input to be felt by a readout
_NEAR_TURN_S = 0.3  # of a turn's end, where what the turn does begins or ends
_LIKE_IT = 1.02  # times a name's evidence that a curve may have and still only mend its form
_NEAREST_SIZE = 1.25  # times what the nearest size tried explains, that the best may: they stand in a ratio of two
_SLACK = 6.0  # nats that refining a shape may still add to what it promises


@dataclass(frozen=True)
class Scored:
    """A hypothesis beside those already adopted: joint fit, gain [nats], Bayes factor less the penalty of looking."""

    hypothesis: Hypothesis
    fit: Fit
    gain: float
    score: float


@dataclass(frozen=True)
class Together:
    """Two names of one sensor, shapes refined, and their Bayes factor [nats] less the penalty of looking for two."""

    hypotheses: tuple[Hypothesis, Hypothesis]
    score: float


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
    instead: NoiseInstead | None = None
    """Larger noise on its sensor that ties with it."""


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
    """One search over a library."""

    def __init__(self, evidence: Evidence, progress: Progress | None = None) -> None:
        self.evidence, self.library = evidence, evidence.library
        self.progress = progress or _silent
        names = {h.name for h in self.library.hypotheses if h.kind is Kind.NAMED}
        self.names = float(len(names) + 6)
        self._ranked: deque[tuple[Fit, tuple[Hypothesis, ...], list[Scored]]] = deque(maxlen=_RANKED)
        self._rounding: dict[int, tuple[Array, Array]] = {}

    def run(self) -> Search:
        """Search until nothing more passes the margin."""
        bare = self.evidence.fit([])
        if self.evidence.restate(bare.rss) | self.evidence.stand(bare.noise):
            bare = self.evidence.fit([])
        self._correct(bare)
        adopted: list[Hypothesis] = []
        current = bare
        while len(adopted) < MOST_FINDINGS:
            self.progress(0.3 + 0.5 * len(adopted) / MOST_FINDINGS, f"looking beyond {len(adopted)} effects")
            known = len(adopted)
            adopted, current = self._with_new(current, adopted)
            if len(adopted) == known:
                break
            adopted, current = self.polish(*self._settle(adopted, current, adopted[:known]))
            if self.evidence.restate(current.rss):
                bare, current = self.evidence.fit([]), self.fit_of(adopted)
        adopted, current = self._settle(adopted, current, adopted, _AT_LAST)
        left = partial(self.rank, current, adopted)
        return Search(self.evidence, self._beside_others(adopted, current), current, bare, left)

    def _beside_others(self, adopted: Sequence[Hypothesis], current: Fit) -> list[Adopted]:
        """Return what each of the adopted gains when all others are there."""
        found = []
        for h in adopted:
            rest = [other for other in adopted if other is not h]
            own = self.score(h, self.fit_of(rest, current), rest)
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

    # one step ----------------------------------------------------------------------------------------------------

    def _with_new(self, current: Fit, adopted: Sequence[Hypothesis]) -> tuple[list[Hypothesis], Fit]:
        """Return what is adopted and what is next, a hypothesis, two names or what noise has swallowed; their fit."""
        best = self._next(current, adopted)
        if best is not None and best.hypothesis.kind is Kind.NAMED:
            return self._retuned(best, adopted, current)
        if best is not None and best.hypothesis.kind is Kind.REFERENCE:
            return [*adopted, best.hypothesis], best.fit
        pair = self._together(adopted, current)
        if pair is not None and (best is None or pair[0] > best.score - TIE):
            return pair[1:]
        if best is None:
            return self._swallowed(adopted, current)
        return self._for_curve(best, adopted, current) or ([*adopted, best.hypothesis], best.fit)

    def _next(self, current: Fit, adopted: Sequence[Hypothesis]) -> Scored | None:
        scored = self.rank(current, adopted)
        named = [s for s in scored if s.hypothesis.kind is Kind.NAMED and not self._is_noise(s, current)]
        other = [s for s in scored if s.hypothesis.kind is Kind.REFERENCE]
        curves = [s for s in scored if s.hypothesis.kind is Kind.EMPIRICAL]
        best = _plainest(named)
        if other and other[0].score > MARGIN and (best is None or other[0].score >= best.score):
            best = other[0]
        curve = curves[0] if curves else None
        if best is not None and curve is not None and curve.score > best.score:
            sharp = [self._sharpened(s, current, adopted) for s in named[:_SHARPENED]]
            named = sorted([*sharp, *named[_SHARPENED:]], key=lambda s: -s.score)
            best = max((best, named[0]), key=lambda s: s.score)
        certain = -math.inf if best is None else self._certain(best, named)
        if (
            curve is not None
            and curve.score > MARGIN + (_LIKE_IT * certain if certain > MARGIN else 0.0)
            and self.beyond_noise(curve, current) > MARGIN
        ):
            pair = self._pair(named[:4], adopted, curve)
            if pair is not None:
                return pair
            return curve
        return best if certain > MARGIN else None

    def beyond_noise(self, one: Scored, current: Fit) -> float:
        """Return the score of what acts on one sensor, held against larger noise with a name there if that is more.

        A walk of a coefficient or two is as good a shift or drift, and neither is certain then.
        """
        noise = self.instead(one.hypothesis, current)
        return one.score if noise is None else one.score - noise.nats

    def _is_noise(self, one: Scored, current: Fit) -> bool:
        """Whether a name is the worse explanation than larger noise, by much unless that is certain of itself."""
        noise = self.instead(one.hypothesis, current) if one.score > 0.0 else None
        return noise is not None and one.score < noise.nats - (0.0 if noise.certain else TIE)

    def instead(self, one: Hypothesis, current: Fit) -> NoiseInstead | None:
        """Return the larger noise that could stand in the place of what acts on one sensor; none of anything else."""
        channels = self.channels(one)
        return noise_instead(self.evidence, current, next(iter(channels))) if len(channels) == 1 else None

    def _certain(self, best: Scored, named: Sequence[Scored]) -> float:
        """Return the evidence that one of the names that tie with the best is there, whichever it is.

        Of hypotheses that share one penalty of looking the Bayes factors add up.
        """
        ties = [s for s in named if s is not best and s.score > best.score - TIE]
        return best.score + math.log1p(sum(math.exp(s.score - best.score) for s in ties))

    def _retuned(self, best: Scored, adopted: Sequence[Hypothesis], current: Fit) -> tuple[list[Hypothesis], Fit]:
        """Return what is adopted with the best name, or with one next to it if the shapes of others make it better.

        Alone, one of two names of a sensor has taken a shape that does some of the other's work.
        """
        if not self.shaped_beside(best.hypothesis, adopted):
            return [*adopted, best.hypothesis], best.fit
        tried = [self.retuned(s, adopted, current) for s in (best, *self.next_to(best, adopted, current))]
        most = max(score for score, _, _ in tried)
        _, both, fit = max((one for one in tried if one[0] > most - SAME), key=lambda one: _plainness(one[1][-1]))
        return both, fit

    def next_to(self, one: Scored, adopted: Sequence[Hypothesis], current: Fit) -> list[Scored]:
        """Return the names of one's sensor that promise most where the shapes of those adopted are left open."""
        channels = self.channels(one.hypothesis)
        other = [self._of_other_shape(h) for h in adopted if self.channels(h) & channels]
        loose = self.fit_of([*adopted, *(h for h in other if h is not None)], current)
        look = [Look(self.evidence, loose, one.fit.noise)]
        taken = {one.hypothesis.name, *(h.name for h in adopted)}
        pool = [h for h in self.unlike(taken) if self.channels(h) == channels]
        best: dict[tuple[str, str], Hypothesis] = {}
        for h in sorted(pool, key=lambda h: -self._promise(h, look) - SAME * _plainness(h)):
            best.setdefault(h.name, h)
        scored = [self.score(h, current, adopted) for h in list(best.values())[:_RETUNED]]
        return [s for s in scored if s is not None]

    def _of_other_shape(self, one: Hypothesis) -> Hypothesis | None:
        """Return a name at another shape, beside which it may be of any between; none if it has no such shape."""
        name = next((name for name in one.shape if name in _FAR), None)
        if name is None or one.unit_amplitude or one.kind is not Kind.NAMED:
            return None
        value = one.shape[name]
        shape = {**one.shape, name: value + _WIDTH[name] if name in ("reference", "nominal") else 1.3 * value}
        return self.library.trial(one.effect, one.channel, shape, one.places)

    def shaped_beside(self, one: Hypothesis, adopted: Sequence[Hypothesis]) -> bool:
        """Whether names of the same sensor have shapes that hang on all of a record."""
        mine = self.channels(one)
        return any(_FAR & set(h.shape) and self.channels(h) & mine for h in adopted if h.kind is Kind.NAMED)

    def retuned(self, one: Scored, adopted: Sequence[Hypothesis], current: Fit) -> tuple[float, list[Hypothesis], Fit]:
        """Return the score of a name with the shapes of those adopted refined beside it; all of them; their fit."""
        both, fit = self.polish([*adopted, one.hypothesis], one.fit)
        h = both[-1]
        return bayes_factor(fit.value - current.value, h.freedom, self.places(h)), both, fit

    def _together(self, adopted: Sequence[Hypothesis], current: Fit) -> tuple[float, list[Hypothesis], Fit] | None:
        """Return two names that only together explain what a wide noise model takes for noise: their score, fit of all.

        Each alone leaves so much that the noise stays wide, in which it has gained next to nothing. Beside the score
        stands what is adopted with them, for the shapes of the others may have changed.
        """
        wide = {slot[1]: slot for slot in self.evidence.slots if current.noise[slot].level != STATED}
        if not wide:
            return None
        look = Look(self.evidence, current, self.quiet(current))
        pool = self.unlike({h.name for h in adopted})
        best: tuple[float, list[Hypothesis], Fit] | None = None
        for channel, slot in wide.items():
            for pair in self.pairs([h for h in pool if self.channels(h) == {channel}], look, MARGIN):
                timed = [self._timed(h, slot, [*adopted, *(o for o in pair if o is not h)], current) for h in pair]
                score, both, fit = self.joint(timed, adopted, current)
                if score > max(MARGIN, best[0] if best else 0.0):
                    best = score, both, fit
        return best

    def _for_curve(
        self, curve: Scored, adopted: Sequence[Hypothesis], current: Fit
    ) -> tuple[list[Hypothesis], Fit] | None:
        """Return two names that do as well as a curve, or as it and a name of its sensor that it mends; fit of all.

        Where two hide on one sensor a single name of the wrong form may explain nearly all of both.
        """
        channels = self.channels(curve.hypothesis)
        mended = [h for h in adopted if h.kind is Kind.NAMED and self.channels(h) == channels]
        best: tuple[float, list[Hypothesis], Fit] | None = None
        for one in (None, *mended):
            rest = [h for h in adopted if h is not one]
            without = current if one is None else self.fit_of(rest, current)
            own = 0.0 if one is None else bayes_factor(current.value - without.value, one.freedom, self.places(one))
            least = curve.score + own - TIE
            look = Look(self.evidence, without, curve.fit.noise)
            pool = [h for h in self.unlike({h.name for h in rest}) if self.channels(h) == channels]
            for pair in self.pairs(pool, look, least - SLACK_OF_TWO):
                score, both, fit = self.joint(pair, rest, without)
                if score > least and (best is None or fit.value > best[0]):
                    best = fit.value, both, fit
        return None if best is None else best[1:]

    def joint(
        self, pair: Sequence[Hypothesis], adopted: Sequence[Hypothesis], current: Fit
    ) -> tuple[float, list[Hypothesis], Fit]:
        """Return the score of two names beside those adopted; all of them, shapes refined; their fit."""
        both, fit = self.polish([*adopted, *pair], self.fit_of([*adopted, *pair], current))
        pair = both[len(adopted) :]
        count, places = sum(h.freedom for h in pair), math.prod(self.places(h) for h in pair) / _ORDERS
        return bayes_factor(fit.value - current.value, count, places), both, fit

    def _timed(self, one: Hypothesis, slot: Slot, others: Sequence[Hypothesis], current: Fit) -> Hypothesis:
        """Return a step at its best time beside others in quiet noise; any other name as it is."""
        if one.effect != "bias_step":
            return one
        fit = self.fit_of(others, current)
        power = self.evidence.quiet(slot, fit.rss[slot]).power
        first, _ = self.evidence.steps(slot).best(self._score_left(slot, fit, power), power)
        return self.step_trial(slot, first) or one

    def channels(self, hypothesis: Hypothesis) -> set[int]:
        """Return the channels that a hypothesis touches in any scene."""
        return {channel for _, channel in self.evidence.touched(hypothesis.columns)}

    def unlike(self, taken: Collection[tuple[str, str]]) -> list[Hypothesis]:
        """Return the names of one column but those taken."""
        pool = [h for h in self.library.hypotheses if h.kind is Kind.NAMED and h.name not in taken]
        return [h for h in pool if len(h.columns) == 1 and h.columns[0] < self.evidence.base and not h.unit_amplitude]

    def pairs(self, pool: Sequence[Hypothesis], look: Look, least: float) -> list[list[Hypothesis]]:
        """Return the two names each that explain most together and promise more than ``least``, a few."""
        gains = look.pairs([h.columns[0] for h in pool])
        places = np.log([self.places(h) for h in pool])
        scores = gains - np.log(np.maximum(gains, 1.0)) - 1.0 - places[:, None] - places + math.log(_ORDERS)
        scores = np.triu(scores, 1)
        found: dict[tuple[tuple[str, str], ...], list[Hypothesis]] = {}
        for place in np.argsort(-scores, axis=None)[:_PAIRS_LOOKED_AT]:
            i, j = divmod(int(place), len(pool))
            names = (pool[i].name, pool[j].name)
            if scores[i, j] > least and names[0] != names[1] and names not in found:
                found[names] = [pool[i], pool[j]]
            if len(found) == _PAIRS:
                break
        return list(found.values())

    def _swallowed(self, adopted: Sequence[Hypothesis], current: Fit) -> tuple[list[Hypothesis], Fit]:
        """Return what is adopted with what wide noise has swallowed, a name or a step, a line or two; their fit.

        That something is there is certain by then, so that the name needs no more evidence than to stay.
        """
        for one in find_sparse(self.evidence, current):
            if one.sweep_hz or (one.repeats_hz and len(one.lines_hz) > _FEW):
                continue  # no name is like it
            named = [s for s in self.rank(current, adopted) if s.hypothesis.kind is Kind.NAMED]
            named = [s for s in named if one.slot in self.evidence.touched(s.hypothesis.columns)]
            if named and named[0].score > _AT_LAST * MARGIN:
                return [*adopted, named[0].hypothesis], named[0].fit
            if len(one.steps) + len(one.lines_hz) > _FEW:
                continue
            trials = [self.step_trial(one.slot, first) for first in one.steps]
            trials += [self.line_trial(one.slot, hertz) for hertz in one.lines_hz]
            new = [trial for trial in trials if trial is not None]
            fit = self.fit_of([*adopted, *new], current)
            count = sum(h.freedom for h in new)
            places = math.prod(self.places(h) for h in new)
            if bayes_factor(fit.value - current.value, count, places) > _AT_LAST * MARGIN:  # or it would not stay
                return [*adopted, *new], fit
        return list(adopted), current

    def _sharpened(self, one: Scored, current: Fit, adopted: Sequence[Hypothesis]) -> Scored:
        """Return a name with its shape refined in the noise that is left with it."""
        finer = self._refine(one.hypothesis, current, Look(self.evidence, current, one.fit.noise))
        again = self.score(finer, current, adopted) if finer is not one.hypothesis else None
        return again if again is not None and again.score > one.score else one

    def _pair(self, named: Sequence[Scored], adopted: Sequence[Hypothesis], curve: Scored) -> Scored | None:
        """Return the first of two names that together explain as much as a curve does.

        Steps at both ends of a turn do not count: they are what the turn does.
        """
        for first in named:
            if first.score < MARGIN:
                continue
            least = max(MARGIN, curve.score - TIE - first.score)
            seconds = self._names_beside(first.fit, [*adopted, first.hypothesis], least)
            if self._ends_a_turn(first.hypothesis):
                seconds = [s for s in seconds if not self._ends_a_turn(s.hypothesis)]
            if seconds and seconds[0].score > least:
                return first
        return None

    def _ends_a_turn(self, one: Hypothesis) -> bool:
        """Whether it is a step where a turn begins or ends."""
        at = np.array([one.shape["time"]]) if one.effect == "bias_step" else np.empty(0)
        return any(scene.near_turn_ends(at, _NEAR_TURN_S).any() for scene in self.library.scenes)

    def rank(self, current: Fit, adopted: Sequence[Hypothesis]) -> list[Scored]:
        """Return the leading hypotheses beside those adopted, best first, shapes refined, noise refitted.

        What was asked for of late is not done again.
        """
        for fit, beside, known in self._ranked:
            if fit is current and len(beside) == len(adopted) and all(map(operator.is_, beside, adopted)):
                return known
        found = self._ranked_by(self._looks(current), current, adopted, dict.fromkeys(Kind, (-math.inf, -math.inf)))
        self._ranked.append((current, tuple(adopted), found))
        return found

    def rank_against(self, own: Scored, current: Fit, adopted: Sequence[Hypothesis]) -> list[Scored]:
        """Return the leading hypotheses in the place of one, which is not among those adopted.

        Those that even in quiet noise would score far less than it are left out; not those that promised as much as it
        did, which may have scored far more as it has left quieter noise.
        """
        looks = self._looks(current)
        wanted = dict.fromkeys(Kind, (own.score - _SLACK, self._promise(own.hypothesis, looks) - TIE))
        return self._ranked_by(looks, current, adopted, wanted)

    def _names_beside(self, current: Fit, adopted: Sequence[Hypothesis], least: float) -> list[Scored]:
        """Return the leading names beside those adopted, best first; those that promise far less than ``least`` not."""
        wanted = dict.fromkeys(Kind, (math.inf, math.inf)) | {Kind.NAMED: (least, math.inf)}
        ranked = self._ranked_by(self._looks(current), current, adopted, wanted)
        return [s for s in ranked if s.hypothesis.kind is Kind.NAMED]

    def _looks(self, current: Fit) -> tuple[Look, Look]:
        """Return a look in the noise as fitted, and one in the noise in which nothing slow is random."""
        return Look(self.evidence, current, current.noise), Look(self.evidence, current, self.quiet(current))

    def _ranked_by(
        self,
        looks: tuple[Look, Look],
        current: Fit,
        adopted: Sequence[Hypothesis],
        wanted: dict[Kind, tuple[float, float]],
    ) -> list[Scored]:
        """Return the leading hypotheses, best first.

        ``wanted``: the score that one of each kind must promise, unless it promises the second; raised by the best.
        """
        _, look = looks
        scored: list[Scored] = []
        refined = 0
        for promise, hypothesis in self._leaders(current, adopted, looks):
            least, alike = wanted[hypothesis.kind]
            slack = _BENT if hypothesis.chord else 0.3  # a chord of another size may fit far better
            at_best = promise * _NEAREST_SIZE if hypothesis.unit_amplitude else promise
            if promise + max(_SLACK, slack * promise) < least and at_best < alike:
                continue
            if not hypothesis.is_plain and refined < _REFINED:
                hypothesis, refined = self._refine(hypothesis, current, look), refined + 1
            one = self._as_parallel(hypothesis, scored) or self.score(hypothesis, current, adopted)
            if one is not None and not self._is_rounding(one):
                scored.append(one)
                if one.score - TIE > least:
                    wanted[hypothesis.kind] = one.score - TIE, promise - TIE
        return sorted(scored, key=lambda s: -s.score)

    def _as_parallel(self, hypothesis: Hypothesis, scored: Sequence[Scored]) -> Scored | None:
        """Return the score of what is one and the same in these recordings as what has a score already, but in size."""
        for other in scored:
            ratio = self.library.ratio(hypothesis, other.hypothesis)
            if ratio is not None:
                fit = other.fit.with_parallel(other.hypothesis.columns[0], hypothesis.columns[0], ratio)
                score = bayes_factor(other.gain, hypothesis.freedom, self.places(hypothesis))
                return Scored(hypothesis, fit, other.gain, score)
        return None

    def _promise(self, hypothesis: Hypothesis, looks: Sequence[Look]) -> float:
        """Return the score that a hypothesis would have in the noise of one of the looks."""
        gain = max(look.gain(hypothesis) for look in looks)
        return bayes_factor(gain, hypothesis.freedom, self.places(hypothesis))

    def _is_rounding(self, one: Scored) -> bool:
        """Whether a line may be one of the rounding error.

        It is no larger than the motion makes it with half the noise, or no evidence if noise is as large as beside it.
        """
        h = one.hypothesis
        if h.effect != "sinusoid":
            return False
        scene, column = self.library.scenes[0], CHANNELS.index(h.channel)
        if h.shape["frequency"] < scene.freely_rounded_hz(column):
            return False
        if column not in self._rounding:
            noise = getattr(scene.model.noise, h.channel)
            found = float(scene.noise_sigma[column]) * math.sqrt(scene.seen.interval_s)
            least = ROUNDED_AT[0] * min(found, noise.white or math.inf)
            self._rounding[column] = largest_lines(scene, column, noise.model_copy(update={"white": least}))
        if bayes_factor(one.gain / self._beside(one), h.freedom, self.places(h)) < MARGIN:
            return True
        size = math.hypot(*(float(one.fit.amplitude[one.fit.ids.index(i)]) for i in h.columns))
        return size < float(np.interp(h.shape["frequency"], *self._rounding[column]))

    def _beside(self, line: Scored) -> float:
        """Return how many times the power of the noise model that beside a line is, where it is more."""
        slot, fit = (0, CHANNELS.index(line.hypothesis.channel)), line.fit
        basis = self.evidence.basis[slot]
        hertz = np.arange(basis.n) / (2.0 * basis.n * basis.interval_s)
        near = np.abs(hertz - line.hypothesis.shape["frequency"]) < NEAR_HZ
        left = self.library.left(slot, fit.ids, fit.amplitude)[near]
        return max(1.0, float(np.mean(left**2 / basis.each(fit.noise[slot].power)[near])))

    def _leaders(
        self, current: Fit, adopted: Sequence[Hypothesis], looks: Sequence[Look]
    ) -> list[tuple[float, Hypothesis]]:
        """Return what promises most, by the score that it would have in the noise of one of the looks."""
        taken = {h.name for h in adopted if h.effect not in ("sinusoid", "bias_step")}
        late = self._late(current, looks)
        pool = [h for h in self.library.hypotheses if h.name not in taken and max(h.columns) < self.evidence.base]
        pool += [h for h in self.library.corrected if h.name not in taken] + late
        picked: dict[tuple[str, str], tuple[float, Hypothesis]] = {}
        for look in looks:
            gains = look.gains(pool)
            scores = np.array([bayes_factor(g, h.freedom, self.places(h)) for g, h in zip(gains, pool, strict=True)])
            room = {Kind.NAMED: _LEADERS, Kind.REFERENCE: 3, Kind.EMPIRICAL: 3}
            seen: dict[tuple[str, str], tuple[float, Hypothesis]] = {}
            plain = np.array([_plainness(h) for h in pool])
            for place in np.argsort(-(scores + SAME * (plain > 0)), kind="stable"):
                h = pool[int(place)]
                if h.name in seen or gains[place] < 2.0:
                    continue
                as_good = [o for gain, o in seen.values() if abs(gain - gains[place]) < _SAME_GAIN * gain]
                new = all(self.library.ratio(h, other) is None for other in as_good)
                if new and not room[h.kind]:
                    continue
                seen[h.name] = float(gains[place]), h
                room[h.kind] -= new  # what is one and the same in these recordings takes one place
                if h.name not in picked or picked[h.name][0] < scores[place]:
                    picked[h.name] = float(scores[place]), h
        return sorted(picked.values(), key=lambda one: (one[1].kind is not Kind.NAMED, -one[0]))

    def quiet(self, current: Fit) -> dict[Slot, NoiseFit]:
        """Return the noise in which nothing slow is random: the stated one, or white and rounding alone."""
        return {slot: self.evidence.quiet(slot, rss) for slot, rss in current.rss.items()}

    def places(self, hypothesis: Hypothesis) -> float:
        """Return the number of places that a hypothesis was one of: names, times its shapes."""
        if hypothesis.kind is not Kind.NAMED:
            return self.names
        return self.names * hypothesis.places

    def score(self, hypothesis: Hypothesis, current: Fit, adopted: Sequence[Hypothesis]) -> Scored | None:
        """Return what a hypothesis gains beside those adopted, noise refitted; none where it cannot be fitted."""
        ids = [i for h in (*adopted, hypothesis) for i in h.columns]
        fixed = [i for h in (*adopted, hypothesis) if h.unit_amplitude for i in h.columns]
        fit = self.evidence.fit(ids, current, fixed)
        gain = fit.value - current.value
        if not math.isfinite(gain):
            return None
        return Scored(hypothesis, fit, gain, bayes_factor(gain, hypothesis.freedom, self.places(hypothesis)))

    # shapes ------------------------------------------------------------------------------------------------------

    def _gain(self, hypothesis: Hypothesis | None, look: Look) -> float:
        return -math.inf if hypothesis is None else look.gain(hypothesis)

    def _refine(self, hypothesis: Hypothesis, current: Fit, look: Look) -> Hypothesis:
        """Return the hypothesis at its best shape nearby."""
        if hypothesis.kind is not Kind.NAMED:
            return hypothesis
        if hypothesis.chord:
            return self._chord(hypothesis, current, look)
        names = [name for name in hypothesis.shape if name in _ZOOMS]
        if len(names) != 1 or len(hypothesis.shape) != 1:
            return hypothesis
        if hypothesis.effect == "dead_band":
            return self._as_samples_say(self._zoomed(hypothesis, look), look)
        return self._zoomed(hypothesis, look)

    def _as_samples_say(self, hypothesis: Hypothesis, look: Look) -> Hypothesis:
        """Return a dead band in the noise that its own samples show, where that explains more of the means."""
        gain = self._gain(hypothesis, look)
        if gain < MARGIN or hypothesis.channel in self.library.met:
            return hypothesis
        read = half_width(self.library.scenes, hypothesis.channel, hypothesis.shape["half_width"])
        if read is None:
            return hypothesis
        self.library.met[hypothesis.channel] = read.noise
        shape = {"half_width": read.value}
        trial = self.library.trial(hypothesis.effect, hypothesis.channel, shape, hypothesis.places)
        finer = None if trial is None else self._zoomed(trial, look)
        if finer is not None and self._gain(finer, look) > gain:
            return finer
        del self.library.met[hypothesis.channel]
        return hypothesis

    def _zoomed(self, hypothesis: Hypothesis, look: Look) -> Hypothesis:
        """Return the hypothesis at the best value nearby of the one number that its shape has."""
        (name,) = hypothesis.shape
        middle = hypothesis.shape[name]
        relative = name in ("time_constant", "half_width", "limit")
        width = self._width(name)
        best, value = hypothesis, self._gain(hypothesis, look)
        places = hypothesis.places
        if name in USUAL and is_usual(hypothesis.shape):
            places *= FITTED_PLACES
            value += math.log(FITTED_PLACES)
        for _ in range(_ZOOMS[name]):
            sides = [middle * math.exp(x) if relative else middle + x for x in (-width, width)]
            sides = [at for at in sides if name != "time_constant" or at <= self.library.longest_s]
            made = [self.library.trial(hypothesis.effect, hypothesis.channel, {name: at}, places) for at in sides]
            trials = [trial for trial in made if trial is not None]
            for trial, gain in zip(trials, look.gains(trials), strict=True):
                if gain > value:
                    best, value = trial, float(gain)
                else:
                    self.library.forget(trial)
            middle = best.shape[name]
            width *= 0.55
        return best

    def _width(self, name: str) -> float:
        """Return how far off a shape may be at first: a time constant's or a limit's logarithm, any other itself."""
        if name == "time":
            return _NEARBY * self.library.scenes[0].interval_s
        if name == "frequency":  # that of a spectrum is good for a line of some ten σ
            return _NEAR_LINE / self.library.longest_s
        return _WIDTH[name]

    def _chord(self, hypothesis: Hypothesis, current: Fit, look: Look) -> Hypothesis:
        """Take the columns as chords to the amplitudes they are found to have."""
        largest = {"clock_scale": 0.2, "latency": 1.0}.get(hypothesis.effect, 0.5)
        for _ in range(3):
            fit = self.evidence.fit([*current.ids, *hypothesis.columns], current)
            found = fit.amplitude[[fit.ids.index(i) for i in hypothesis.columns]]
            sizes = np.where(np.abs(found) < 1e-9, 1e-9, np.clip(found, -largest, largest))
            known = np.array(hypothesis.chord)
            if np.max(np.abs(sizes - known)) < 0.02 * np.max(np.abs(known)) or np.max(np.abs(found)) < 1e-9:
                break
            at = tuple(sizes.tolist())
            trial = self.library.setup_trial(hypothesis.effect, hypothesis.channel, at, hypothesis.shape)
            if trial is None or self._gain(trial, look) < self._gain(hypothesis, look) - 1.0:
                break
            hypothesis = trial
        return hypothesis

    def _late(self, current: Fit, looks: Sequence[Look]) -> list[Hypothesis]:
        """Return steps and lines where the whitened residual has them, a few a channel.

        Which of the steps is the best hangs on what the reference leaves open, which the residual alone does not say.
        """
        late: list[Hypothesis | None] = []
        for look in reversed(looks):
            for slot in self.evidence.slots:
                basis, power = self.evidence.basis[slot], look.noise[slot].power
                score = self._score_left(slot, current, power)
                for first, gain in self.evidence.steps(slot).several(score, power, _STEPS_TRIED):
                    if gain > _STEP_NATS:
                        late.append(self.step_trial(slot, first))
                hertz, gain = best_line(score, power, basis)
                if gain > math.log(basis.n) + _LINE_NATS:
                    late.append(self.line_trial(slot, hertz))
        return [h for h in late if h is not None]

    def _score_left(self, slot: Slot, fit: Fit, power: Array) -> Array:
        left = self.library.left(slot, fit.ids, fit.amplitude)
        return score_of(left, power, self.evidence.basis[slot], self.library.spread[slot])

    def step_trial(self, slot: Slot, first: int) -> Hypothesis | None:
        """Return a step before an analysed sample."""
        scene = self.library.scenes[slot[0]]
        shape = {"time": float(scene.data.edges_s[first * scene.group])}
        return self.library.trial("bias_step", CHANNELS[slot[1]], shape, 200.0)

    def line_trial(self, slot: Slot, hertz: float) -> Hypothesis | None:
        """Return a line."""
        places = 0.5 * self.evidence.basis[slot].n
        return self.library.trial("sinusoid", CHANNELS[slot[1]], {"frequency": hertz}, places)

    # second thoughts -----------------------------------------------------------------------------------------------

    def fit_of(self, hypotheses: Sequence[Hypothesis], start: Fit | None = None) -> Fit:
        """Return the joint fit of hypotheses and noise, from a fit nearby."""
        ids = [i for h in hypotheses for i in h.columns]
        return self.evidence.fit(ids, start, [i for h in hypotheses if h.unit_amplitude for i in h.columns])

    def _settle(
        self, adopted: list[Hypothesis], current: Fit, judged: Sequence[Hypothesis], share: float = 0.5
    ) -> tuple[list[Hypothesis], Fit]:
        """Drop those of the judged that the others, or a finer fit of noise and shapes, have made needless.

        Such keep less than a ``share`` of the margin that they passed.
        """
        for h in judged:
            rest = [other for other in adopted if other is not h]
            without = self.fit_of(rest, current)
            if bayes_factor(current.value - without.value, h.freedom, self.places(h)) < share * MARGIN:
                return self._settle(rest, without, [other for other in judged if other is not h], share)
        return adopted, current

    def polish(self, adopted: list[Hypothesis], current: Fit) -> tuple[list[Hypothesis], Fit]:
        """Refine the shapes once more, each beside all others and in the noise that is left with all of them."""
        for place, h in enumerate(adopted):
            if h.kind is not Kind.NAMED or not (h.shape or h.chord):
                continue
            others = [i for other in adopted if other is not h for i in other.columns]
            rest = replace(current, ids=tuple(i for i in current.ids if i in others or i in self.evidence.prior))
            finer = self._refine(h, rest, Look(self.evidence, rest, current.noise))
            if finer is h:
                continue
            trial = [*adopted[:place], finer, *adopted[place + 1 :]]
            fit = self.fit_of(trial, current)
            if fit.value > current.value:
                adopted, current = trial, fit
        return adopted, current


def _plainest(named: Sequence[Scored]) -> Scored | None:
    """Return the best; of names that are one and the same in these recordings the bias, or else the scale factor.

    What is constant is a bias by definition (IEEE 528) until a recording shows what it depends on.
    """
    same = [s for s in named if s.score > named[0].score - SAME]
    return max(same, key=lambda s: _plainness(s.hypothesis), default=None)


def _plainness(hypothesis: Hypothesis) -> int:
    return {"bias_shift": 2, "scale_factor": 1}.get(hypothesis.effect, 0)


def _silent(share: float, text: str) -> None:
    del share, text


_WIDTH = {"time_constant": 0.5, "half_width": 0.3, "limit": 0.05, "reference": 4.0, "nominal": 1.0}
_NEARBY = 10.0  # samples that a step may be off at first
_NEAR_LINE = 0.1  # of the frequency that turns once in twice the record, by which a line may be off
_ZOOMS = {"time_constant": 7, "half_width": 18, "limit": 20, "reference": 6, "nominal": 5, "time": 9, "frequency": 8}
