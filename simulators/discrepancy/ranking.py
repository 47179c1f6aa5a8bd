"""Which hypotheses lead beside a fit: scanned in two noises, their shapes refined, refitted together with the noise.

The two are the noise as fitted and the quiet one in which nothing slow is random; refitted with it, a random walk is
not sold as a drift nor the other way round.
"""

from __future__ import annotations

import math
import operator
from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from inertial.documents import CHANNELS
from simulators.discrepancy.atoms import best_line, score_of
from simulators.discrepancy.candidates import Hypothesis, Kind, Slot
from simulators.discrepancy.evidence import Evidence, Fit, bayes_factor
from simulators.discrepancy.look import Look
from simulators.discrepancy.margins import MARGIN, SAME, TIE
from simulators.discrepancy.rounding_errors import NEAR_HZ, largest_lines
from simulators.discrepancy.shapes import Shapes
from simulators.discrepancy.whitening import ROUNDED_AT, NoiseFit

Array = NDArray[np.float64]

_LEADERS = 12
_REFINED = 12
_BENT, _REFINES = 3.0, 0.3  # share of its promise that a chord of the right size may add, or another shape
_RANKED = 3  # answers that are kept for when they are asked for again
_SAME_GAIN = 1e-6  # share of a gain by which that of the same column may be off
_STEPS_TRIED = 3  # of a channel
_STEP_NATS, _LINE_NATS = 4.0, 3.0  # that a step or a line must promise to be tried
_NEAREST_SIZE = 1.25  # times what the nearest size tried explains, that the best may: they stand in a ratio of two
_SLACK = 6.0  # nats that refining a shape may still add to what it promises


@dataclass(frozen=True)
class Scored:
    """A hypothesis beside those already adopted: joint fit, gain [nats], Bayes factor less the penalty of looking."""

    hypothesis: Hypothesis
    fit: Fit
    gain: float
    score: float


class Ranking:
    """Of the hypotheses of one library by their evidence [nats]."""

    def __init__(self, evidence: Evidence) -> None:
        self.evidence, self.library, self.shapes = evidence, evidence.library, Shapes(evidence)
        names = {h.name for h in self.library.hypotheses if h.kind is Kind.NAMED}
        self.names = float(len(names) + 6)
        self.curves = float(sum(h.kind is Kind.EMPIRICAL for h in self.library.hypotheses))
        self._ranked: deque[tuple[Fit, tuple[Hypothesis, ...], list[Scored]]] = deque(maxlen=_RANKED)
        self._rounding: dict[int, tuple[Array, Array]] = {}

    def rank(self, current: Fit, adopted: Sequence[Hypothesis]) -> list[Scored]:
        """Return the leading hypotheses beside those adopted, best first, shapes refined, noise refitted.

        What promises far too little to be named, or to tie with a name, is left out. What was asked for of late is not
        done again.
        """
        for fit, beside, known in self._ranked:
            if fit is current and len(beside) == len(adopted) and all(map(operator.is_, beside, adopted)):
                return known
        wanted = dict.fromkeys(Kind, (MARGIN - TIE, math.inf))
        found = self._ranked_by(self._looks(current), current, adopted, wanted)
        self._ranked.append((current, tuple(adopted), found))
        return found

    def rank_against(self, own: Scored, current: Fit, adopted: Sequence[Hypothesis]) -> list[Scored]:
        """Return the leading hypotheses in the place of one, which is not among those adopted.

        Those that even in quiet noise would score far less than it are left out; not those that promised as much as it
        did, which may have scored far more as it has left quieter noise.
        """
        looks = self._looks(current)
        wanted = dict.fromkeys(Kind, (own.score - _SLACK, self.promise(own.hypothesis, looks) - TIE))
        return self._ranked_by(looks, current, adopted, wanted)

    def names_beside(self, current: Fit, adopted: Sequence[Hypothesis], least: float) -> list[Scored]:
        """Return the leading names beside those adopted, best first; those that promise far less than ``least`` not."""
        wanted = dict.fromkeys(Kind, (math.inf, math.inf)) | {Kind.NAMED: (least, math.inf)}
        ranked = self._ranked_by(self._looks(current), current, adopted, wanted)
        return [s for s in ranked if s.hypothesis.kind is Kind.NAMED]

    def score(self, hypothesis: Hypothesis, current: Fit, adopted: Sequence[Hypothesis]) -> Scored | None:
        """Return what a hypothesis gains beside those adopted, noise refitted; none where it cannot be fitted."""
        ids = [i for h in (*adopted, hypothesis) for i in h.columns]
        fixed = [i for h in (*adopted, hypothesis) if h.unit_amplitude for i in h.columns]
        fit = self.evidence.fit(ids, current, fixed)
        gain = fit.value - current.value
        if not math.isfinite(gain):
            return None
        return Scored(hypothesis, fit, gain, bayes_factor(gain, hypothesis.freedom, self.places(hypothesis)))

    def places(self, hypothesis: Hypothesis) -> float:
        """Return the number of places that a hypothesis was one of: names, times its shapes, or all curves."""
        if hypothesis.kind is Kind.EMPIRICAL:
            return self.curves
        if hypothesis.kind is Kind.REFERENCE:
            return self.names
        return self.names * hypothesis.places

    def promise(self, hypothesis: Hypothesis, looks: Sequence[Look]) -> float:
        """Return the score that a hypothesis would have in the noise of one of the looks."""
        gain = max(look.gain(hypothesis) for look in looks)
        return bayes_factor(gain, hypothesis.freedom, self.places(hypothesis))

    def channels(self, hypothesis: Hypothesis) -> set[int]:
        """Return the channels that a hypothesis touches in any scene."""
        return self.evidence.channels(hypothesis.columns)

    def unlike(self, taken: Collection[tuple[str, str]]) -> list[Hypothesis]:
        """Return the names of one column but those taken."""
        pool = [h for h in self.library.hypotheses if h.kind is Kind.NAMED and h.name not in taken]
        return [h for h in pool if len(h.columns) == 1 and h.columns[0] < self.evidence.base and not h.unit_amplitude]

    def quiet(self, current: Fit) -> dict[Slot, NoiseFit]:
        """Return the noise in which nothing slow is random: the stated one, or white and rounding alone."""
        return {slot: self.evidence.quiet(slot, rss) for slot, rss in current.rss.items()}

    def fit_of(self, hypotheses: Sequence[Hypothesis], start: Fit | None = None) -> Fit:
        """Return the joint fit of hypotheses and noise, from a fit nearby."""
        ids = [i for h in hypotheses for i in h.columns]
        return self.evidence.fit(ids, start, [i for h in hypotheses if h.unit_amplitude for i in h.columns])

    def polish(
        self, adopted: list[Hypothesis], current: Fit, some: slice = slice(None)
    ) -> tuple[list[Hypothesis], Fit]:
        """Refine the shapes, or some, once more, each beside all others and in the noise that is left with all."""
        for place, h in list(enumerate(adopted))[some]:
            if h.kind is not Kind.NAMED or not (h.shape or h.chord) or self.shapes.is_settled(h, current):
                continue
            others = [i for other in adopted if other is not h for i in other.columns]
            rest = replace(current, ids=tuple(i for i in current.ids if i in others or i in self.evidence.prior))
            finer = self.shapes.refine(h, rest, Look(self.evidence, rest, current.noise), current)
            if finer is h:
                continue
            trial = [*adopted[:place], finer, *adopted[place + 1 :]]
            fit = self.fit_of(trial, current)
            if fit.value > current.value:
                adopted, current = trial, fit
        return adopted, current

    def sharpened(self, one: Scored, current: Fit, adopted: Sequence[Hypothesis]) -> Scored:
        """Return a name with its shape refined in the noise that is left with it."""
        finer = self.shapes.refine(one.hypothesis, current, Look(self.evidence, current, one.fit.noise))
        again = self.score(finer, current, adopted) if finer is not one.hypothesis else None
        return again if again is not None and again.score > one.score else one

    def score_left(self, slot: Slot, fit: Fit, power: Array) -> Array:
        """Return d ln L / d reading (n,) [1/y] of what a fit leaves of a slot, in noise of a power (b,) [y²]."""
        left = self.library.left(slot, fit.ids, fit.amplitude)
        return score_of(left, power, self.evidence.basis[slot], self.library.spread[slot])

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
            at_best = promise * _NEAREST_SIZE if hypothesis.unit_amplitude else promise
            if promise + slack(promise, bent=bool(hypothesis.chord)) < least and at_best < alike:
                continue
            if not hypothesis.is_plain and refined < _REFINED:
                hypothesis, refined = self.shapes.refine(hypothesis, current, look), refined + 1
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

    def _is_rounding(self, one: Scored) -> bool:
        """Whether a line may be one of the rounding error.

        It is no larger than motion makes it with a quarter of the noise, or no evidence in noise as large as beside it.
        """
        h = one.hypothesis
        if h.effect != "sinusoid":
            return False
        scene, column = self.library.scenes[0], CHANNELS.index(h.channel)
        if h.shape["frequency"] < scene.freely_rounded_hz(column):
            return False
        if bayes_factor(one.gain / self._beside(one), h.freedom, self.places(h)) < MARGIN:
            return True
        if column not in self._rounding:
            noise = getattr(scene.model.noise, h.channel)
            found = float(scene.noise_sigma[column]) * math.sqrt(scene.seen.interval_s)
            least = ROUNDED_AT[0] * min(found, noise.white or math.inf)
            self._rounding[column] = largest_lines(scene, column, noise.model_copy(update={"white": least}))
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
            plain = np.array([plainness(h) for h in pool])
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

    def _late(self, current: Fit, looks: Sequence[Look]) -> list[Hypothesis]:
        """Return steps and lines where the whitened residual has them, a few a channel.

        Which of the steps is the best hangs on what the reference leaves open, which the residual alone does not say.
        """
        late: list[Hypothesis | None] = []
        for look in reversed(looks):
            for slot in self.evidence.slots:
                basis, power = self.evidence.basis[slot], look.noise[slot].power
                score = self.score_left(slot, current, power)
                for step in self.evidence.steps(slot).several(score, power, _STEPS_TRIED):
                    if step.gain > _STEP_NATS:
                        late.append(self.shapes.step(slot, step.first, step.alike))
                hertz, gain = best_line(score, power, basis)
                if gain > math.log(basis.n) + _LINE_NATS:
                    late.append(self.shapes.line(slot, hertz))
        return [h for h in late if h is not None]


def slack(score: float, *, bent: bool) -> float:
    """Return the nats that refining may still add to a score; a chord of another size may fit far better."""
    return max(_SLACK, (_BENT if bent else _REFINES) * score)


def plainest(named: Sequence[Scored]) -> Scored | None:
    """Return the best; of names that are one and the same in these recordings the bias, or else the scale factor.

    What is constant is a bias by definition (IEEE 528) until a recording shows what it depends on.
    """
    same = [s for s in named if s.score > named[0].score - SAME]
    return max(same, key=lambda s: plainness(s.hypothesis), default=None)


def plainness(hypothesis: Hypothesis) -> int:
    """Return the larger, the plainer a name is."""
    return {"bias_shift": 2, "scale_factor": 1}.get(hypothesis.effect, 0)
