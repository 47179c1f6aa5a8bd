"""Structure that noise of a wide family has swallowed: a few steps and lines in quiet noise may explain it better.

Noise of any colour takes whatever is there into its spectrum, a jump as well as a wave. But it spends evidence on every
coefficient, and a structure that is simple spends it on a few: so what is left is described over again, in the noise
in which nothing slow is random, by steps and lines taken one by one, by one line that sweeps or by one wave that
repeats, each charged for the places it could have been, and held against noise with a name as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from simulators.discrepancy.atoms import best_comb, best_line, best_sweep, levels, score_of
from simulators.discrepancy.candidates import Slot, to_cosine
from simulators.discrepancy.evidence import Evidence, Fit
from simulators.discrepancy.noise_names import larger_noise
from simulators.discrepancy.whitening import Basis, NoiseFit

Array = NDArray[np.float64]

MARGIN = 9.0
"""By how much [nats] the simpler description must be the better one."""
_MOST = 60
_PATIENCE = 12  # steps and lines that have brought nothing
_ROUNDS = 3  # of levels and the noise about them
_STEP_COST, _LINE_COST = 2.0, 4.0  # of amplitudes, beyond ln of the number of places


@dataclass(frozen=True)
class Sparse:
    """Steps before these samples as analysed, and lines [Hz], that explain a slot better than noise, by ``nats``.

    ``sweep_hz``: where a line that sweeps evenly begins and ends; ``repeats_hz``: of which lines are the harmonics.
    """

    slot: Slot
    steps: tuple[int, ...]
    lines_hz: tuple[float, ...]
    nats: float
    sweep_hz: tuple[float, ...] = ()
    repeats_hz: float = 0.0


def find_sparse(evidence: Evidence, fit: Fit) -> list[Sparse]:
    """Return the slots whose noise, of a colour that nothing tells, is better taken for a few steps and lines."""
    slots = [slot for slot in evidence.slots if not evidence.is_told(slot, fit)]
    found = [evidence.once(fit, ("sparse", slot), partial(_of_slot, evidence, fit, slot)) for slot in slots]
    return [one for one in found if one.nats > MARGIN and (one.steps or one.lines_hz or one.sweep_hz)]


def _of_slot(evidence: Evidence, fit: Fit, slot: Slot) -> Sparse:
    trial = _Trial(evidence, fit, slot)
    return max((_one_by_one(trial), _levels(trial), _sweeping(trial), _repeating(trial)), key=lambda found: found.nats)


class _Trial:
    """What a slot's fit leaves, and what any set of steps and lines would make of it."""

    def __init__(self, evidence: Evidence, fit: Fit, slot: Slot) -> None:
        self.evidence, self.slot, self.basis = evidence, slot, evidence.basis[slot]
        self.spread = evidence.library.spread[slot]
        self.whole = evidence.library.left(slot, fit.ids, fit.amplitude)
        self._noise_alone = evidence.slot_value(slot, fit)
        if evidence.stated[slot] is not None:
            self._noise_alone = max(self._noise_alone, larger_noise(evidence, fit, slot).value)
        self._time_s = np.asarray((np.arange(self.basis.n) + 0.5) * self.basis.interval_s)
        self.line_cost = math.log(self.basis.n) + _LINE_COST

    def step(self, first: int) -> Array:
        """Return the column (n, 1) of a step."""
        return to_cosine((np.arange(self.basis.n) >= first) / self.spread)[:, None]

    def line(self, hertz: float) -> Array:
        """Return the columns (n, 2) of a line."""
        return self._wave(hertz * self._time_s)

    def sweep(self, first_hz: float, last_hz: float) -> Array:
        """Return the columns (n, 2) of a line that sweeps evenly."""
        length_s = self.basis.n * self.basis.interval_s
        hertz: Array = first_hz + 0.5 * (last_hz - first_hz) * self._time_s / length_s
        return self._wave(hertz * self._time_s)

    def _wave(self, cycles: Array) -> Array:
        phase = 2.0 * math.pi * cycles
        return np.column_stack([to_cosine(np.cos(phase) / self.spread), to_cosine(np.sin(phase) / self.spread)])

    def quiet(self, left: Array) -> NoiseFit:
        """Return the noise of what is left if nothing slow is random."""
        return self.evidence.quiet(self.slot, np.add.reduceat(left**2, self.basis.bounds[:-1]))

    def step_cost(self, count: int, jump: float, quiet: NoiseFit) -> float:
        """Return what one of ``count`` steps of such a size [y] costs [nats].

        That is its amplitude and its place: any ``count`` of the samples, as far as they can be told apart.
        """
        noise = float(np.median(quiet.power))
        alike = max(1.0, 4.0 * noise / max(jump**2, 1e-300))
        return math.log(max(self.basis.n / (count * alike), 1.0)) + 1.0 + _STEP_COST

    def found(
        self, left: Array, quiet: NoiseFit, steps: Sequence[int], jumps: Sequence[float], lines: Sequence[float]
    ) -> Sparse:
        """Return what is described, and by how much better than by noise alone."""
        cost = sum(self.step_cost(len(steps), jump, quiet) for jump in jumps) + len(lines) * self.line_cost
        return Sparse(self.slot, tuple(steps), tuple(lines), self.gained(left, quiet, cost))

    def gained(self, left: Array, quiet: NoiseFit, cost: float) -> float:
        """Return by how much a description that costs so many nats is better than noise alone."""
        return self.evidence.noise_value(self.slot, quiet, left) - cost - self._noise_alone


def _one_by_one(trial: _Trial) -> Sparse:
    """Take the step or line that explains most, then the next."""
    places = trial.evidence.steps(trial.slot)
    columns = np.empty((trial.basis.n, 0))
    left, quiet = trial.whole, trial.quiet(trial.whole)
    steps: list[int] = []
    lines: list[float] = []
    best = trial.found(left, quiet, steps, [], lines)
    while columns.shape[1] < _MOST and len(steps) + len(lines) - len(best.steps) - len(best.lines_hz) < _PATIENCE:
        score = score_of(left, quiet.power, trial.basis, trial.spread)
        first, step_gain, _ = places.best(score, quiet.power)
        hertz, line_gain = best_line(score, quiet.power, trial.basis)
        gained = step_gain - trial.step_cost(1, math.inf, quiet), line_gain - trial.line_cost
        if max(gained) < 0.0:
            break
        if gained[0] > gained[1]:
            steps.append(first)
            added = trial.step(first)
        else:
            lines.append(hertz)
            added = trial.line(hertz)
        columns = np.column_stack([columns, added])
        left, _ = _without(trial.whole, columns, quiet, trial.basis)
        quiet = trial.quiet(left)
        certain = [math.inf] * len(steps)
        best = max(best, trial.found(left, quiet, steps, certain, lines), key=lambda one: one.nats)
    return best


def _sweeping(trial: _Trial) -> Sparse:
    """Take what is left for one line that sweeps."""
    left, quiet = trial.whole, trial.quiet(trial.whole)
    first_hz, last_hz, tried = best_sweep(score_of(left, quiet.power, trial.basis, trial.spread), trial.basis)
    left, _ = _without(trial.whole, trial.sweep(first_hz, last_hz), quiet, trial.basis)
    nats = trial.gained(left, trial.quiet(left), trial.line_cost + math.log(tried))
    return Sparse(trial.slot, (), (), nats, sweep_hz=(first_hz, last_hz))


def _repeating(trial: _Trial) -> Sparse:
    """Take what is left for one wave that repeats, of any form."""
    left, quiet = trial.whole, trial.quiet(trial.whole)
    hertz, count, tried = best_comb(score_of(left, quiet.power, trial.basis, trial.spread), quiet.power, trial.basis)
    lines = [harmonic * hertz for harmonic in range(1, count + 1)]
    columns = np.column_stack([trial.line(line) for line in lines])
    left, _ = _without(trial.whole, columns, quiet, trial.basis)
    nats = trial.gained(left, trial.quiet(left), math.log(tried) + count * _LINE_COST)
    return Sparse(trial.slot, (), tuple(lines), nats, repeats_hz=hertz)


def _levels(trial: _Trial) -> Sparse:
    """Take what is left for constant levels."""
    left, quiet = trial.whole, trial.quiet(trial.whole)
    cost = trial.step_cost(1, math.inf, quiet)
    steps: list[int] = []
    jumps: list[float] = []
    for _ in range(_ROUNDS):
        steps = levels(trial.whole, quiet.power, trial.basis, trial.spread, cost)[:_MOST]
        columns = np.column_stack([trial.step(first) for first in (*steps, 0)])
        left, sizes = _without(trial.whole, columns, quiet, trial.basis)
        jumps = sizes[: len(steps)].tolist()
        quiet = trial.quiet(left)
        cost = max((trial.step_cost(len(steps), jump, quiet) for jump in jumps), default=cost)
    return trial.found(left, quiet, steps, jumps, [])


def _without(whole: Array, columns: Array, noise: NoiseFit, basis: Basis) -> tuple[Array, Array]:
    """Return what columns leave, by least squares weighted by the noise, and their amplitudes."""
    weight = basis.each(1.0 / noise.power)
    gram = columns.T @ (columns * weight[:, None])
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    right = columns.T @ (weight * whole) / scale
    sizes = np.linalg.lstsq(gram / np.outer(scale, scale), right, rcond=1e-10)[0] / scale
    return np.asarray(whole - columns @ sizes), np.asarray(sizes)
