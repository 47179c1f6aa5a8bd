"""What else could stand in the place of an adopted name, the others present: another name, or two together.

A single name of the wrong form may explain two that hide on one sensor nearly as well as they do, and one whose
coefficient is counted from an unusual temperature or voltage *is* a constant and the same name counted from the usual
one. Two such names tie with the one found as a third name would.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from inertial.documents import CHANNELS
from simulators.discrepancy.adopt import Adopted, Search
from simulators.discrepancy.candidates import Hypothesis, Kind, is_usual
from simulators.discrepancy.evidence import Fit, bayes_factor
from simulators.discrepancy.look import Look
from simulators.discrepancy.margins import TIE
from simulators.discrepancy.noise_instead import beyond_noise
from simulators.discrepancy.ranking import Ranking, Scored
from simulators.discrepancy.retuning import next_to, retuned, shaped_beside
from simulators.discrepancy.two_names import (
    SLACK_OF_TWO,
    Together,
    exchangeable,
    exchanges,
    joint,
    of_its_sensor,
    of_two,
    pairs,
)
from simulators.discrepancy.whitening import STATED

_LISTED = 8


def find_rivals(search: Search, asked: Sequence[Adopted], tell: Callable[[float, str], None]) -> None:
    """Say of some of what was adopted what else could stand in its place, all others present.

    ``tell`` is called with the share done and a word on what is being done.
    """
    ranking = Ranking(search.evidence)
    for place, entry in enumerate(asked):
        h = entry.hypothesis
        tell(place / len(asked), f"looking for rivals of {h.effect}")
        rest = [other.hypothesis for other in search.adopted if other is not entry]
        without = ranking.fit_of(rest, search.fit)
        own = ranking.score(h, without, rest)
        assert own is not None  # or it had not been adopted
        own = replace(own, score=own.score + entry.noise_nats)
        ranked = [s for s in ranking.rank_against(own, without, rest) if s.hypothesis.name != h.name]
        if h.kind is Kind.NAMED and shaped_beside(ranking, h, rest):
            ranked = _likelier(ranked, _retuned(ranking, own, rest, without))
        entry.rivals = ranked[:_LISTED]
        if h.kind is Kind.NAMED:
            entry.ties = [s for s in ranked if s.hypothesis.kind is Kind.NAMED and s.score > own.score - TIE]
            entry.pairs = _pairs(ranking, own, rest, without)
            beyond, noise = beyond_noise(search.evidence, own, without)
            entry.instead = (noise, beyond) if noise is not None and noise.names and beyond < TIE else None
    entries = {id(one.hypothesis): one for one in asked}
    for first, second in exchangeable(ranking, [one.hypothesis for one in asked]):
        _exchanged(ranking, search, entries[id(first)], entries[id(second)])


def _likelier(ranked: Sequence[Scored], again: Sequence[Scored]) -> list[Scored]:
    """Return what was ranked once and again, best first, each name once."""
    best: dict[tuple[str, str], Scored] = {}
    for one in sorted([*ranked, *again], key=lambda s: -s.score):
        best.setdefault(one.hypothesis.name, one)
    return list(best.values())


def _retuned(ranking: Ranking, own: Scored, rest: Sequence[Hypothesis], without: Fit) -> list[Scored]:
    """Return the names next to one with the shapes of others of the sensor refined beside each.

    As found they are those that go best with it.
    """
    tried = [retuned(ranking, s, rest, without) for s in next_to(ranking, own, rest, without)]
    return [Scored(both[-1], fit, fit.value - without.value, score) for score, both, fit in tried]


def names_instead(search: Search, channel: str) -> list[tuple[Hypothesis, float]]:
    """Return the names that tie with a channel's larger noise, and how far behind it they are [nats].

    They leave the channel no larger noise, or do better than it, though not by the margin that a name must have.
    """
    evidence, column = search.evidence, CHANNELS.index(channel)
    slots = [slot for slot in evidence.slots if slot[1] == column]
    found = []
    for one in search.left():
        h = one.hypothesis
        if h.kind is Kind.NAMED and evidence.channels(h.columns) == {column} and one.score > 0.0:
            behind = -beyond_noise(evidence, one, search.fit)[0]
            if behind < 0.0 or (behind < TIE and all(one.fit.noise[slot].level == STATED for slot in slots)):
                found.append((h, behind))
    return found


def _pairs(ranking: Ranking, own: Scored, rest: Sequence[Hypothesis], without: Fit) -> list[Together]:
    """Return the two names each that tie with one, best first."""
    h = own.hypothesis
    if len(ranking.channels(h)) != 1:
        return []
    look = Look(ranking.evidence, without, own.fit.noise)
    mine = bayes_factor(look.gain(h), h.freedom, ranking.places(h))
    tied = []
    pool = [
        o for o in of_its_sensor(ranking, h, rest) if o.name != h.name or (is_usual(o.shape) and not is_usual(h.shape))
    ]
    for pair in pairs(ranking, pool, look, mine - TIE - SLACK_OF_TWO):
        same = h.name in (pair[0].name, pair[1].name)
        score, both, fit = joint(ranking, pair, rest, without, -math.inf if same else own.score - TIE)
        if same:
            score = max(score, own.score + fit.value - own.fit.value)  # the same in other words: the fit alone counts
        if score > own.score - TIE:
            tied.append(Together((both[-2], both[-1]), own.score - score))
    return sorted(tied, key=lambda one: one.behind)


def _exchanged(ranking: Ranking, search: Search, first: Adopted, second: Adopted) -> None:
    """Add to the pairs of each of two names which other two would do as well as both of them."""
    mine = first.hypothesis, second.hypothesis
    rest = [one.hypothesis for one in search.adopted if one is not first and one is not second]
    without = ranking.fit_of(rest, search.fit)
    own = of_two(ranking, mine, search.fit.value - without.value)
    tied = {s.hypothesis.name for one in (first, second) for s in one.ties}
    for score, both, _ in exchanges(ranking, mine, rest, without, search.fit, own - TIE):
        if not tied & {h.name for h in both[-2:]}:  # or it says again what each alone has said
            first.pairs.append(Together((both[-2], both[-1]), own - score, mine[1]))
            second.pairs.append(Together((both[-1], both[-2]), own - score, mine[0]))
