"""When will a block leave its limit: paths of the drift model beyond its last check, drawn from the posterior.

For each draw of the population (:func:`inertial.ageing.fit_population`) the block's own offset, rate and walk are drawn
given its checks, the walk goes on, and so does the law, off by what it may stray where no block was checked. A path
leaves when it is outside ±limit at a node, or between two nodes with the probability that a Brownian bridge from one to
the other touches the limit, exp(−2·d₁·d₂/(walk²·Δt)): what pulls the walk back changes that by the square of
Δt/relaxation only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from inertial.ageing import Array, PopulationFit, TermHistories
from inertial.ageing_filter import last_beliefs, pulled
from inertial.compiled import compiled

HORIZON_MONTHS = 240.0
NODES_MONTHS = np.concatenate([np.arange(0.0, 24.0, 0.5), np.arange(24.0, 60.0), np.arange(60.0, 241.0, 2.0)])
"""Where paths are looked at, from the last check on: closer at first."""
PATHS = 12
"""Paths of a block for each draw of the population."""
NEVER = -35.0
"""Of the logarithm of a probability: what is below it does not happen in as many paths as are drawn."""
PROBABILITY = 0.9
BAND_MONTHS = 36
"""How far the band of a term is given, a row a month."""
SEED = 2903


@dataclass(frozen=True)
class Leaving:
    """When a block leaves its limit, months from its last check; None: beyond ``HORIZON_MONTHS``.

    ``low`` to ``high`` holds 90 %: equal tails, but where more than 5 % lie beyond the horizon all of the 10 % are
    below ``low``, and where more than 5 % say that it is outside already all of them are above ``high``.
    """

    median: float | None
    low: float | None
    high: float | None
    outside_now: float
    beyond_horizon: float


def leaving_months(histories: TermHistories, fit: PopulationFit, limit: float, seed: int) -> Array:
    """Return when paths leave ±limit (blocks, draws × paths), months from each block's last check; inf: never.

    Parameters
    ----------
    histories, fit
        One term, with its known steps.
    limit
        In SI.
    seed
        Of the paths, beside the module's own: another for each term.
    """
    rng = np.random.default_rng([SEED, seed])
    states, roots, months = _last_states(histories, fit)
    left = np.full((histories.blocks, len(fit.draws), PATHS), np.inf)
    for number, draw in enumerate(fit.draws):
        growth = draw.law.growth_beyond(months[:, None] + NODES_MONTHS, histories.known_months)
        walk = draw.walk, 1.0 / draw.relaxation_months
        _walk(states[number], roots[number], growth, NODES_MONTHS, walk, limit, rng, left[:, number])
    return left.reshape(histories.blocks, -1)


def bands(histories: TermHistories, fit: PopulationFit) -> tuple[Array, Array, Array]:
    """Return months since calibration, mean and 1σ [SI] of each block's term from its last check on, (blocks, n)."""
    states, roots, months = _last_states(histories, fit)
    later = np.arange(BAND_MONTHS + 1.0)
    ahead = months[:, None] + later
    means, variances = np.empty((2, len(fit.draws), *ahead.shape))
    for number, draw in enumerate(fit.draws):
        kept, came = np.array([pulled(elapsed, 1.0 / draw.relaxation_months) for elapsed in later]).T
        growth = draw.law.growth_beyond(ahead, histories.known_months)
        row = np.stack(np.broadcast_arrays(1.0, growth, kept), axis=-1)
        means[number] = np.einsum("bmk,bk->bm", row, states[number])
        seen = np.einsum("bmk,bkj->bmj", row, roots[number])
        variances[number] = np.sum(seen**2, axis=-1) + draw.walk**2 * came
    return ahead, means.mean(axis=0), np.sqrt(variances.mean(axis=0) + means.var(axis=0))


def leaving(samples: Array) -> Leaving:
    """Return the forecast that paths make of one block."""
    outside, beyond = float(np.mean(samples <= 0.0)), float(np.mean(np.isinf(samples)))
    tail = 0.5 * (1.0 - PROBABILITY)
    if beyond > tail:
        low, high = 2.0 * tail, 1.0
    elif outside > tail:
        low, high = 0.0, PROBABILITY
    else:
        low, high = tail, 1.0 - tail
    ends = np.quantile(samples, [low, 0.5, high], method="inverted_cdf")
    low_month, median, high_month = (float(end) if math.isfinite(end) else None for end in ends)
    return Leaving(median, low_month, None if beyond > tail else high_month, outside, beyond)


def _last_states(histories: TermHistories, fit: PopulationFit) -> tuple[Array, Array, Array]:
    """Return state (draws, blocks, 3) and root of its covariance (draws, blocks, 3, 3) at the last checks, and when."""
    rows = histories.offsets, histories.months
    seen = histories.value, histories.sigma**2, histories.jump
    beliefs = np.array([last_beliefs(*rows, draw.law.growth(histories.months), *seen, draw.row) for draw in fit.draws])
    aa, ss, ww, cross_as, aw, sw = np.moveaxis(beliefs[..., 3:], -1, 0)
    columns = np.stack([aa, cross_as, aw, cross_as, ss, sw, aw, sw, ww], axis=-1)
    values, vectors = np.linalg.eigh(columns.reshape(*beliefs.shape[:2], 3, 3))
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return beliefs[..., :3], roots, histories.months[histories.offsets[1:] - 1]


@compiled
def _walk(
    states: Array,
    roots: Array,
    growth: Array,
    nodes: Array,
    walk: tuple[float, float],
    limit: float,
    rng: np.random.Generator,
    left: Array,
) -> None:
    """Fill ``left`` (blocks, paths) with the months after which each path leaves ±limit.

    ``walk``: its size a √month, and the rate [1/month] at which it is pulled back.
    """
    size, rate = walk
    kept, kick = np.empty(len(nodes)), np.empty(len(nodes))
    for node in range(1, len(nodes)):
        kept[node], came = pulled(nodes[node] - nodes[node - 1], rate)
        kick[node] = size * np.sqrt(came)
    for block in range(left.shape[0]):
        for path in range(left.shape[1]):
            a, b, c = rng.standard_normal(), rng.standard_normal(), rng.standard_normal()
            state = states[block] + roots[block, :, 0] * a + roots[block, :, 1] * b + roots[block, :, 2] * c
            here = state[0] + growth[block, 0] * state[1] + state[2]
            if abs(here) >= limit:
                left[block, path] = 0.0
                continue
            for node in range(1, len(nodes)):
                elapsed = nodes[node] - nodes[node - 1]
                before = here
                state[2] = kept[node] * state[2] + kick[node] * rng.standard_normal()
                here = state[0] + growth[block, node] * state[1] + state[2]
                if abs(here) >= limit:
                    share = (limit - abs(before)) / (abs(here) - abs(before))
                    left[block, path] = nodes[node - 1] + share * elapsed
                    break
                scale = -2.0 / (size * size * elapsed)
                above = scale * (limit - before) * (limit - here)
                below = scale * (limit + before) * (limit + here)
                if max(above, below) > NEVER and rng.random() < np.exp(above) + np.exp(below):
                    left[block, path] = nodes[node - 1] + 0.5 * elapsed
                    break
