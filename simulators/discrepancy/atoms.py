"""Where one step, or one line, would explain most of what is left of a channel: all places are looked at at once."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import fft, fftfreq, idct

from inertial.compiled import compiled
from simulators.discrepancy.candidates import to_cosine
from simulators.discrepancy.whitening import Basis

Array = NDArray[np.float64]

_TRIALS = 20  # places at which the power of a step is worked out; between them it is smooth
_EDGE = 0.01  # of the record at either end, where a step says nothing
_APART = 0.04  # of the record by which two steps are other ones
_FEWEST_CYCLES = 2.0
_HARMONICS, _REPEATS_HZ = 16, 1.0  # of a wave that repeats, and how often it may
_HARMONIC_NATS = 4.0  # that a harmonic must add
_SWEPT_HZ = 5.0  # within which lines that sweep are looked for
_RATE_STEP = 2.0  # cycles over a record by which two sweeps differ
_BLOCKS = 1000  # at most, among which levels are told apart


def score_of(left: Array, power: Array, basis: Basis, spread: Array) -> Array:
    """Return d ln L / d reading (n,): what any column's product with it says at once.

    ``left`` (n,): cosine coefficients of what is left; ``power`` (b,): the noise; ``spread`` (n,): of each sample.
    """
    return np.asarray(idct(basis.each(1.0 / power) * left, norm="ortho")) / spread


class Step(NamedTuple):
    """A step before sample ``first``: what it gains [nats], and the share of a record at which it would do as well."""

    first: int
    gain: float
    alike: float


class Steps:
    """Steps in one slot: the power of each in every bin, made once."""

    def __init__(self, basis: Basis, spread: Array) -> None:
        self._places = np.linspace(0.02, 0.98, _TRIALS) * basis.n
        powers = []
        for start in self._places:
            power = np.square(to_cosine((np.arange(basis.n) >= int(start)) / spread))
            powers.append(np.add.reduceat(power, basis.bounds[:-1]))
        self._powers = np.array(powers)

    def best(self, score: Array, power: Array) -> Step:
        """Return the step that explains most."""
        return self.several(score, power, 1)[0]

    def several(self, score: Array, power: Array, count: int) -> list[Step]:
        """Return so many steps, no two of them near each other, best first."""
        n = len(score)
        where = np.arange(n)
        sizes = np.interp(where, self._places, self._powers @ (1.0 / power))
        gain = 0.5 * np.cumsum(score[::-1])[::-1] ** 2 / sizes
        gain[(where < _EDGE * n) | (where > (1.0 - _EDGE) * n)] = 0.0
        found = []
        for _ in range(count):
            best = int(np.argmax(gain))
            found.append(Step(best, float(gain[best]), float(np.mean(np.exp(gain - gain[best])))))
            gain[np.abs(where - best) < _APART * n] = 0.0
        return found


def levels(left: Array, power: Array, basis: Basis, spread: Array, cost: float) -> list[int]:
    """Return where each level but the first begins when what is left is taken for constant levels, ``cost`` nats each.

    Optimal over all choices (optimal partitioning, Jackson et al. 2005), of block means whose noise is that at their
    own time scale.
    """
    size = -(-len(left) // _BLOCKS)
    count = len(left) // size
    values = np.asarray(idct(left, norm="ortho"))[: count * size] * spread[: count * size]
    means = values.reshape(count, size).mean(axis=1)
    bin_of_blocks = int(np.searchsorted(basis.bounds, basis.n / size, "right")) - 1
    variance = float(power[min(bin_of_blocks, len(power) - 1)]) / size
    starts = _segments(means, variance, cost)
    return [start * size for start in starts]


@compiled
def _segments(values: Array, variance: float, cost: float) -> list[int]:
    n = len(values)
    sums = np.zeros(n + 1)
    squares = np.zeros(n + 1)
    for i in range(n):
        sums[i + 1] = sums[i] + values[i]
        squares[i + 1] = squares[i] + values[i] * values[i]
    best = np.zeros(n + 1)
    begins = np.zeros(n + 1, dtype=np.int64)
    for end in range(1, n + 1):
        least, where = np.inf, 0
        for start in range(end):
            total = sums[end] - sums[start]
            spent = squares[end] - squares[start] - total * total / (end - start)
            value = best[start] + 0.5 * spent / variance + cost
            if value < least:
                least, where = value, start
        best[end], begins[end] = least, where
    found = []
    end = n
    while begins[end] > 0:
        end = begins[end]
        found.append(end)
    return found


def best_line(score: Array, power: Array, basis: Basis) -> tuple[float, float]:
    """Return the frequency [Hz] of the line that explains most, and what it gains [nats]."""
    n, interval_s = len(score), basis.interval_s
    spectrum = np.abs(np.fft.rfft(score, 2 * n)) ** 2
    frequency = np.fft.rfftfreq(2 * n, interval_s)
    place = np.clip((2.0 * frequency * n * interval_s).astype(np.int64), 0, n - 1)
    gain = spectrum * power[np.searchsorted(basis.bounds[1:-1], place, "right")] / n
    gain[frequency < _FEWEST_CYCLES / (0.5 * n * interval_s)] = 0.0
    best = int(np.argmax(gain))
    centre, step = float(frequency[best]), 0.25 / (n * interval_s)
    for _ in range(5):
        trials = [centre - step, centre, centre + step]
        centre = trials[int(np.argmax([_size_at(score, 2.0 * math.pi * f * interval_s) for f in trials]))]
        step *= 0.5
    return centre, float(gain[best])


def best_comb(score: Array, power: Array, basis: Basis) -> tuple[float, int, int]:
    """Return the frequency of the repetition [Hz] whose harmonics explain most, how many, and how many were tried."""
    n, interval_s = len(score), basis.interval_s
    length_s = n * interval_s
    spectrum = np.abs(np.fft.rfft(score, 4 * n)) ** 2
    frequency = np.fft.rfftfreq(4 * n, interval_s)
    place = np.clip((2.0 * frequency * length_s).astype(np.int64), 0, n - 1)
    gain = spectrum * power[np.searchsorted(basis.bounds[1:-1], place, "right")] / n
    step = 0.25 / (_HARMONICS * length_s)
    firsts = np.arange(_FEWEST_CYCLES / length_s, min(_REPEATS_HZ, 0.5 / interval_s / _HARMONICS), step)
    harmonics = firsts[:, None] * np.arange(1, _HARMONICS + 1)
    gains = gain[np.round(harmonics * 4.0 * length_s).astype(np.int64)]
    net = np.cumsum(gains - _HARMONIC_NATS, axis=1)
    first, count = np.unravel_index(int(np.argmax(net)), net.shape)
    return float(firsts[first]), int(count) + 1, len(firsts)


def best_sweep(score: Array, basis: Basis) -> tuple[float, float, int]:
    """Return where the line that sweeps evenly and explains most begins and ends [Hz], and how many rates were tried.

    Turned back by the phase that a rate of sweep adds, such a line stands still: then it is one of a spectrum.
    """
    length_s = basis.n * basis.interval_s
    size = max(1, int(0.25 / (_SWEPT_HZ * basis.interval_s)))
    count = len(score) // size
    sums = score[: count * size].reshape(count, size).sum(axis=1)
    time_s = (np.arange(count) + 0.5) * size * basis.interval_s
    highest_hz = min(_SWEPT_HZ, 0.25 / (size * basis.interval_s))
    rates = np.arange(0.0, highest_hz * length_s, _RATE_STEP) / length_s**2
    frequency_hz = fftfreq(2 * count, size * basis.interval_s)
    once = np.exp(-1j * math.pi * _RATE_STEP * (time_s / length_s) ** 2).astype(np.complex64)
    best, found = 0.0, (0.0, 0.0)
    for sign, back in ((1.0, once), (-1.0, once.conj())):
        turned = sums.astype(np.complex64)
        for rate in sign * rates:
            first, last = max(-rate * length_s, 0.0), highest_hz - max(rate * length_s, 0.0)
            low, high = np.searchsorted(frequency_hz[:count], (first + _FEWEST_CYCLES / length_s, last))
            if low < high:
                spectrum = np.abs(fft(turned, 2 * count)[low:high])
                place = int(np.argmax(spectrum))
                if spectrum[place] > best:
                    best, first_hz = float(spectrum[place]), float(frequency_hz[low + place])
                    found = first_hz, first_hz + float(rate) * length_s
            turned *= back
    return *found, 2 * len(rates)


@compiled
def _size_at(score: Array, omega: float) -> float:
    """Return the size of the Fourier transform at one angular frequency [rad per sample], the phase turned on."""
    turn_re, turn_im = math.cos(omega), math.sin(omega)
    re, im, total_re, total_im = 1.0, 0.0, 0.0, 0.0
    for value in score:
        total_re += value * re
        total_im += value * im
        re, im = re * turn_re - im * turn_im, re * turn_im + im * turn_re
    return math.hypot(total_re, total_im)
