"""Names beside others of one sensor whose shapes hang on all of a record, judged with these refined beside each.

Alone, one of two names of a sensor has taken a shape that does some of the other's work.
"""

from __future__ import annotations

from collections.abc import Sequence

from simulators.discrepancy.candidates import Hypothesis, Kind
from simulators.discrepancy.evidence import Fit, bayes_factor
from simulators.discrepancy.look import Look
from simulators.discrepancy.margins import SAME
from simulators.discrepancy.ranking import Ranking, Scored, plainness
from simulators.discrepancy.shapes import OF_ALL

_TRIED = 4  # besides the best


def best_retuned(
    ranking: Ranking, best: Scored, adopted: Sequence[Hypothesis], current: Fit
) -> tuple[list[Hypothesis], Fit]:
    """Return what is adopted with the best name, or with one next to it if the shapes of others make it better."""
    if not shaped_beside(ranking, best.hypothesis, adopted):
        return [*adopted, best.hypothesis], best.fit
    tried = [retuned(ranking, s, adopted, current) for s in (best, *next_to(ranking, best, adopted, current))]
    most = max(score for score, _, _ in tried)
    _, both, fit = max((one for one in tried if one[0] > most - SAME), key=lambda one: plainness(one[1][-1]))
    return both, fit


def shaped_beside(ranking: Ranking, one: Hypothesis, adopted: Sequence[Hypothesis]) -> bool:
    """Whether names of the same sensor have shapes that hang on all of a record."""
    mine = ranking.channels(one)
    return any(OF_ALL & set(h.shape) and ranking.channels(h) & mine for h in adopted if h.kind is Kind.NAMED)


def next_to(ranking: Ranking, one: Scored, adopted: Sequence[Hypothesis], current: Fit) -> list[Scored]:
    """Return the names of one's sensor that promise most where the shapes of those adopted are left open."""
    channels = ranking.channels(one.hypothesis)
    other = [ranking.shapes.other(h) for h in adopted if ranking.channels(h) & channels]
    loose = ranking.fit_of([*adopted, *(h for h in other if h is not None)], current)
    look = [Look(ranking.evidence, loose, one.fit.noise)]
    taken = {one.hypothesis.name, *(h.name for h in adopted)}
    pool = [h for h in ranking.unlike(taken) if ranking.channels(h) == channels]
    best: dict[tuple[str, str], Hypothesis] = {}
    for h in sorted(pool, key=lambda h: -ranking.promise(h, look) - SAME * plainness(h)):
        best.setdefault(h.name, h)
    scored = [ranking.score(h, current, adopted) for h in list(best.values())[:_TRIED]]
    return [s for s in scored if s is not None]


def retuned(
    ranking: Ranking, one: Scored, adopted: Sequence[Hypothesis], current: Fit
) -> tuple[float, list[Hypothesis], Fit]:
    """Return the score of a name with the shapes of those adopted refined beside it; all of them; their fit."""
    both, fit = ranking.polish([*adopted, one.hypothesis], one.fit)
    h = both[-1]
    return bayes_factor(fit.value - current.value, h.freedom, ranking.places(h)), both, fit
