"""Shapes of hypotheses: refined to the best nearby, and trials at others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from inertial.documents import CHANNELS
from simulators.discrepancy.candidates import FITTED_PLACES, STEP_PLACES, USUAL, Hypothesis, Kind, Slot, is_usual
from simulators.discrepancy.compare import Scene
from simulators.discrepancy.dead_band_width import HalfWidth, half_width
from simulators.discrepancy.evidence import Evidence, Fit
from simulators.discrepancy.look import Look
from simulators.discrepancy.margins import MARGIN

Array = NDArray[np.float64]

OF_ALL = frozenset({"time_constant", "half_width", "limit", "reference", "nominal"})
"""Shapes that hang on all of a record."""
_WIDTH = {"time_constant": 0.5, "half_width": 0.3, "limit": 0.05, "reference": 4.0, "nominal": 1.0}
_LOOSER = 1.3  # times a shape, beside which it may be of any between
_NEARBY = 10.0  # samples that a step may be off at first
_NEAR_LINE = 0.1  # of the frequency that turns once in twice the record, by which a line may be off
_SETTLED = 0.02  # share of its size by which the amplitude of a chord may be off
_SAME_BAND = 0.1  # of ln of where a band is looked for, within which it is found alike
_CLOSER = 0.55  # width of the next look over that of the last
_ROUGHLY, _FAR_OFF = frozenset({"half_width", "limit", "time"}), 100.0  # shapes that may be so many widths off at first
_ZOOMS = {"time_constant": 7, "half_width": 18, "limit": 20, "reference": 6, "nominal": 5, "time": 9, "frequency": 8}


def line_places(cycles: float, most: int) -> float:
    """Return one over the prior probability of a line of so many cycles in a record, of ``most`` that it can have.

    Half that of a frequency of unknown scale, alike in each octave (Jaynes 1968), and half that of a line above half
    the sampling rate, which comes down anywhere.
    """
    of_unknown_scale = 1.0 / (max(cycles, 1.0) * (math.log(most) + np.euler_gamma))
    return float(2.0 / (1.0 / most + of_unknown_scale))


class Shapes:
    """Of the hypotheses of one library."""

    def __init__(self, evidence: Evidence) -> None:
        self.evidence, self.library = evidence, evidence.library
        self._bands: dict[str, tuple[Sequence[Scene], float, HalfWidth | None]] = {}

    def refine(self, hypothesis: Hypothesis, current: Fit, look: Look, whole: Fit | None = None) -> Hypothesis:
        """Return the hypothesis at its best shape nearby, beside a fit; ``whole`` is one with it, if there is one."""
        if hypothesis.kind is not Kind.NAMED:
            return hypothesis
        if hypothesis.chord:
            return self._chord(hypothesis, current, look, whole)
        names = [name for name in hypothesis.shape if name in _ZOOMS]
        if len(names) != 1 or len(hypothesis.shape) != 1:
            return hypothesis
        finer = self._zoomed(hypothesis, look)
        return self._as_samples_say(finer, look) if hypothesis.effect == "dead_band" else self._as_likely(finer, look)

    def is_settled(self, hypothesis: Hypothesis, fit: Fit) -> bool:
        """Whether it is a chord to the amplitudes that a fit with it finds, so that there is nothing to refine."""
        found = fit.amplitude[[fit.ids.index(i) for i in hypothesis.columns]]
        return bool(hypothesis.chord) and _is_near(found, hypothesis)

    def other(self, one: Hypothesis) -> Hypothesis | None:
        """Return a name at another shape, beside which it may be of any between; none if it has no such shape."""
        name = next((name for name in one.shape if name in OF_ALL), None)
        if name is None or one.unit_amplitude or one.kind is not Kind.NAMED:
            return None
        value = one.shape[name]
        shape = {**one.shape, name: value + _WIDTH[name] if name in ("reference", "nominal") else _LOOSER * value}
        return self.library.trial(one.effect, one.channel, shape, one.places)

    def step(self, slot: Slot, first: int, alike: float = 1.0 / STEP_PLACES) -> Hypothesis | None:
        """Return a step before an analysed sample, which would do as well at such a share of a record."""
        scene = self.library.scenes[slot[0]]
        shape = {"time": float(scene.data.edges_s[first * scene.group])}
        places = 1.0 / max(alike, 1.0 / STEP_PLACES)
        return self.library.trial("bias_step", CHANNELS[slot[1]], shape, places)

    def line(self, slot: Slot, hertz: float) -> Hypothesis | None:
        """Return a line."""
        basis = self.evidence.basis[slot]
        places = line_places(hertz * basis.n * basis.interval_s, basis.n // 2)
        return self.library.trial("sinusoid", CHANNELS[slot[1]], {"frequency": hertz}, places)

    def _as_likely(self, hypothesis: Hypothesis, look: Look) -> Hypothesis:
        """Return a hypothesis as one of fewer places where others of its grid do as well.

        The marginal likelihood of a shape of which nothing is known is the mean over all of them.
        """
        (name,) = hypothesis.shape
        if name not in ("time_constant", *USUAL) or (name in USUAL and not is_usual(hypothesis.shape)):
            return hypothesis
        grid = [h for h in self.library.hypotheses if h.name == hypothesis.name and is_usual(h.shape)]
        gains = look.gains(grid)
        alike = float(np.sum(np.exp(gains - gains.max())))
        return replace(hypothesis, places=max(len(grid) / alike, 1.0))

    def _read_off(self, channel: str, about: float) -> HalfWidth | None:
        """Return the half-width that samples show, which hangs little on where it is looked for."""
        scenes, at, read = self._bands.get(channel, ((), math.inf, None))
        if scenes is not self.library.scenes or abs(math.log(at / about)) > _SAME_BAND:
            read = half_width(self.library.scenes, channel, about)
            self._bands[channel] = self.library.scenes, about, read
        return read

    def _as_samples_say(self, hypothesis: Hypothesis, look: Look) -> Hypothesis:
        """Return a dead band in the noise that its own samples show, where that explains more of the means."""
        gain = look.gain(hypothesis)
        if gain < MARGIN or hypothesis.channel in self.library.met:
            return hypothesis
        read = self._read_off(hypothesis.channel, hypothesis.shape["half_width"])
        if read is None:
            return hypothesis
        self.library.met[hypothesis.channel] = read.noise
        shape = {"half_width": read.value}
        trial = self.library.trial(hypothesis.effect, hypothesis.channel, shape, hypothesis.places)
        finer = None if trial is None else self._zoomed(trial, look)
        if finer is not None and look.gain(finer) > gain:
            return finer
        del self.library.met[hypothesis.channel]
        return hypothesis

    def _zoomed(self, hypothesis: Hypothesis, look: Look) -> Hypothesis:
        """Return the hypothesis at the best value nearby of the one number that its shape has."""
        (name,) = hypothesis.shape
        middle = hypothesis.shape[name]
        relative = name in ("time_constant", "half_width", "limit")
        width = self._width(name)
        finest, widest = width * _CLOSER ** _ZOOMS[name], width * (_FAR_OFF if name in _ROUGHLY else 1.0)
        best, value = hypothesis, look.gain(hypothesis)
        places = hypothesis.places
        if name in USUAL and is_usual(hypothesis.shape):
            value += math.log(FITTED_PLACES / places)
            places = FITTED_PLACES
        while width > finest:
            before = best
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
            if best is not before and width < widest:
                width *= 2.0
            else:
                widest, width = 0.0, width * _CLOSER
        return best

    def _width(self, name: str) -> float:
        """Return how far off a shape may be at first: a time constant's or a limit's logarithm, any other itself."""
        if name == "time":
            return _NEARBY * self.library.scenes[0].interval_s
        if name == "frequency":  # that of a spectrum is good for a line of some ten σ
            return _NEAR_LINE / self.library.longest_s
        return _WIDTH[name]

    def _chord(self, hypothesis: Hypothesis, current: Fit, look: Look, whole: Fit | None) -> Hypothesis:
        """Take the columns as chords to the amplitudes they are found to have."""
        largest = {"clock_scale": 0.2, "latency": 1.0}.get(hypothesis.effect, 0.5)
        for _ in range(3):
            fit = whole or self.evidence.fit([*current.ids, *hypothesis.columns], current)
            found = fit.amplitude[[fit.ids.index(i) for i in hypothesis.columns]]
            sizes = np.where(np.abs(found) < 1e-9, 1e-9, np.clip(found, -largest, largest))
            if _is_near(sizes, hypothesis) or np.max(np.abs(found)) < 1e-9:
                break
            at = tuple(sizes.tolist())
            trial = self.library.setup_trial(hypothesis.effect, hypothesis.channel, at, hypothesis.shape)
            if trial is None or look.gain(trial) < look.gain(hypothesis) - 1.0:
                break
            hypothesis, whole = trial, None
        return hypothesis


def _is_near(sizes: Array, chord: Hypothesis) -> bool:
    """Whether sizes are those that a chord was taken at."""
    known = np.array(chord.chord)
    return bool(np.max(np.abs(sizes - known)) < _SETTLED * np.max(np.abs(known)))
