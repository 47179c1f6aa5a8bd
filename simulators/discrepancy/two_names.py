"""Two names of one sensor at once, of which each alone explains little, or something else explains both nearly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from simulators.discrepancy.candidates import Hypothesis, Kind, Slot
from simulators.discrepancy.evidence import Fit, bayes_factor
from simulators.discrepancy.look import Look
from simulators.discrepancy.margins import TIE
from simulators.discrepancy.ranking import Ranking, Scored, slack

SLACK_OF_TWO = 3.0
"""Nats that refining may still add to what two names promise, of which at least one mostly has no shape to refine."""
_PAIRS, _LOOKED_AT = 4, 400
_ORDERS = 2.0  # in which two names can be named
_WAVES_OF_A_LINE = 3.0  # in a record, or a drift and another name may be like it


@dataclass(frozen=True)
class Together:
    """Two names, shapes refined, and how far behind what they tie with they are [nats].

    That is one name, or two, of which ``but`` is the other.
    """

    hypotheses: tuple[Hypothesis, Hypothesis]
    behind: float
    but: Hypothesis | None = None


def together(
    ranking: Ranking, adopted: Sequence[Hypothesis], current: Fit, margin: float
) -> tuple[float, list[Hypothesis], Fit] | None:
    """Return two names that only together explain what a wide noise model takes for noise: their score, fit of all.

    Their score passes the ``margin``. Each alone leaves so much that the noise stays wide, in which it has gained next
    to nothing. Beside the score stands what is adopted with them, for the shapes of the others may have changed.
    """
    wide = {slot[1]: slot for slot in ranking.evidence.slots if not ranking.evidence.is_told(slot, current)}
    if not wide:
        return None
    look = Look(ranking.evidence, current, ranking.quiet(current))
    pool = ranking.unlike({h.name for h in adopted})
    best: tuple[float, list[Hypothesis], Fit] | None = None
    for channel, slot in wide.items():
        for pair in pairs(ranking, [h for h in pool if ranking.channels(h) == {channel}], look, margin):
            timed = [_timed(ranking, h, slot, [*adopted, *(o for o in pair if o is not h)], current) for h in pair]
            score, both, fit = joint(ranking, timed, adopted, current, margin)
            if score > max(margin, best[0] if best else 0.0):
                best = score, both, fit
    return best


def in_place_of_curve(
    ranking: Ranking, curve: Scored, adopted: Sequence[Hypothesis], current: Fit
) -> tuple[list[Hypothesis], Fit] | None:
    """Return two names that do as well as a curve, or as it and a name of its sensor that it mends; fit of all.

    Where two hide on one sensor a single name of the wrong form may explain nearly all of both.
    """
    channels = ranking.channels(curve.hypothesis)
    mended = [h for h in adopted if h.kind is Kind.NAMED and ranking.channels(h) == channels]
    best: tuple[float, list[Hypothesis], Fit] | None = None
    for one in (None, *mended):
        rest = [h for h in adopted if h is not one]
        without = current if one is None else ranking.fit_of(rest, current)
        own = 0.0 if one is None else bayes_factor(current.value - without.value, one.freedom, ranking.places(one))
        least = curve.score + own - TIE
        look = Look(ranking.evidence, without, curve.fit.noise)
        for pair in pairs(ranking, of_its_sensor(ranking, curve.hypothesis, rest), look, least - SLACK_OF_TWO):
            score, both, fit = joint(ranking, pair, rest, without, least)
            if score > least and (best is None or fit.value > best[0]):
                best = fit.value, both, fit
    return None if best is None else best[1:]


def in_place_of_one(
    ranking: Ranking, adopted: Sequence[Hypothesis], current: Fit, margin: float
) -> tuple[list[Hypothesis], Fit] | None:
    """Return what is adopted with two names in the place of one that do better by more than a margin; fit of all.

    One name of a wrong shape may have taken so much of two that what is left passes for a random walk. It may be one of
    the two itself, at another shape.
    """
    wide = {slot[1] for slot in ranking.evidence.slots if not ranking.evidence.is_told(slot, current)}
    better, best = margin, None
    for one in adopted:
        if one.kind is not Kind.NAMED or len(ranking.channels(one)) > 1 or not ranking.channels(one) <= wide:
            continue
        rest = [h for h in adopted if h is not one]
        without = ranking.fit_of(rest, current)
        own = bayes_factor(current.value - without.value, one.freedom, ranking.places(one))
        look = Look(ranking.evidence, without, ranking.quiet(current))
        for pair in pairs(ranking, of_its_sensor(ranking, one, rest), look, own + better - SLACK_OF_TWO):
            score, both, fit = joint(ranking, pair, rest, without, own + better)
            if score > own + better:
                better, best = score - own, (both, fit)
    return best


def of_its_sensor(ranking: Ranking, one: Hypothesis, rest: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return the names that act on a name's sensors alone, itself at all its shapes among them, but for the rest."""
    return [h for h in ranking.unlike({o.name for o in rest}) if ranking.channels(h) == ranking.channels(one)]


def in_place_of_two(
    ranking: Ranking, adopted: Sequence[Hypothesis], current: Fit
) -> tuple[list[Hypothesis], Fit] | None:
    """Return what is adopted with two names in the place of two that do worse by more than a tie; fit of all.

    What goes best alone may not be what goes best with another: of three accelerometers two that are off are nearly
    gravity, which leaves the third to be off by as much.
    """
    better, best = TIE, None
    for first, second in exchangeable(ranking, adopted):
        rest = [h for h in adopted if h is not first and h is not second]
        without = ranking.fit_of(rest, current)
        own = of_two(ranking, (first, second), current.value - without.value)
        for score, both, fit in exchanges(ranking, (first, second), rest, without, current, own + better):
            if score > own + better:
                better, best = score - own, (both, fit)
    return best


def exchangeable(ranking: Ranking, adopted: Sequence[Hypothesis]) -> list[tuple[Hypothesis, Hypothesis]]:
    """Return every two names in whose place two others might do better: not lines of many waves, which none is like."""
    longest_s = max(float(np.ptp(scene.time_s)) for scene in ranking.library.scenes)
    line = [h.effect == "sinusoid" and h.shape["frequency"] * longest_s > _WAVES_OF_A_LINE for h in adopted]
    named = [h for h, is_line in zip(adopted, line, strict=True) if h.kind is Kind.NAMED and not is_line]
    return list(combinations(named, 2))


def exchanges(
    ranking: Ranking,
    mine: tuple[Hypothesis, Hypothesis],
    rest: Sequence[Hypothesis],
    without: Fit,
    current: Fit,
    least: float,
) -> list[tuple[float, list[Hypothesis], Fit]]:
    """Return the two other names each that score more than ``least`` in the place of two: score, all, their fit.

    Of two that share no sensor, one of the others must touch what both do: else each is asked for alone. What it does
    elsewhere, the other may undo.
    """
    first, second = (ranking.channels(h) for h in mine)
    others = ranking.unlike({h.name for h in (*mine, *rest)})
    linking = [h for h in others if ranking.channels(h) & first and ranking.channels(h) & second]
    reach = (first | second).union(*map(ranking.channels, linking))
    pool = [h for h in others if ranking.channels(h) & reach]
    links = [bool(first & second) or h in linking for h in pool]
    look = Look(ranking.evidence, without, current.noise)
    told = pairs(ranking, pool, look, least - SLACK_OF_TWO, np.array(links, dtype=np.bool_))
    found = [joint(ranking, pair, rest, without, least) for pair in told]
    return [one for one in found if one[0] > least]


def joint(
    ranking: Ranking, pair: Sequence[Hypothesis], adopted: Sequence[Hypothesis], current: Fit, least: float
) -> tuple[float, list[Hypothesis], Fit]:
    """Return the score of two names beside those adopted; all of them, shapes refined; their fit.

    The two are refined first. What is so far below the ``least`` that is asked for that no refining brings it there is
    left as it is.
    """
    both, own = [*adopted, *pair], slice(len(adopted), None)
    fit = ranking.fit_of(both, current)
    score = of_two(ranking, pair, fit.value - current.value)
    bent = any(h.chord and not ranking.shapes.is_settled(h, fit) for h in pair)
    for some in (own, slice(len(adopted))):
        if score + slack(score, bent=bent) < least:
            break
        both, fit = ranking.polish(both, fit, some)
        score, bent = of_two(ranking, both[own], fit.value - current.value), False
    return score, both, fit


def of_two(ranking: Ranking, pair: Sequence[Hypothesis], gain: float) -> float:
    """Return the Bayes factor [nats] of two names that gain so much, less the penalty of looking for two."""
    places = math.prod(ranking.places(h) for h in pair) / _ORDERS
    return bayes_factor(gain, sum(h.freedom for h in pair), places)


def pairs(
    ranking: Ranking, pool: Sequence[Hypothesis], look: Look, least: float, one_of: NDArray[np.bool_] | None = None
) -> list[list[Hypothesis]]:
    """Return the two names each that explain most together and promise more than ``least``, a few.

    At least one of them is ``one_of`` the pool, where that is given.
    """
    gains = look.pairs([h.columns[0] for h in pool])
    places = np.log([ranking.places(h) for h in pool])
    scores = gains - np.log(np.maximum(gains, 1.0)) - 1.0 - places[:, None] - places + math.log(_ORDERS)
    if one_of is not None:
        scores = np.where(one_of[:, None] | one_of, scores, -math.inf)
    scores = np.where(np.triu(np.ones_like(scores), 1) > 0.0, scores, -math.inf)
    found: dict[tuple[tuple[str, str], ...], list[Hypothesis]] = {}
    for place in np.argsort(-scores, axis=None)[:_LOOKED_AT]:
        i, j = divmod(int(place), len(pool))
        names = (pool[i].name, pool[j].name)
        if scores[i, j] > least and names[0] != names[1] and names not in found:
            found[names] = [pool[i], pool[j]]
        if len(found) == _PAIRS:
            break
    return list(found.values())


def _timed(ranking: Ranking, one: Hypothesis, slot: Slot, others: Sequence[Hypothesis], current: Fit) -> Hypothesis:
    """Return a step at its best time beside others in quiet noise; any other name as it is."""
    if one.effect != "bias_step":
        return one
    fit = ranking.fit_of(others, current)
    power = ranking.evidence.quiet(slot, fit.rss[slot]).power
    step = ranking.evidence.steps(slot).best(ranking.score_left(slot, fit, power), power)
    return ranking.shapes.step(slot, step.first, step.alike) or one
