"""Samples that did not come are no evidence: what stands for them has no noise of its own."""

from __future__ import annotations

import math
from dataclasses import replace

import closed_form
import numpy as np
import pytest
from scipy.fft import dct
from scipy.stats import chi2, f

from drivers.recording import Recording, RecordingMeta
from inertial.documents import BlockModel
from simulators.discrepancy.candidates import Library
from simulators.discrepancy.compare import Scene, compare
from simulators.discrepancy.evidence import Evidence
from simulators.discrepancy.unsteady import level_spread

SEEDS = 15
EARTH_UP_RADPS = closed_form.EARTH_RADPS * math.sin(math.radians(closed_form.LATITUDE_DEG))
LINES_HZ = {"slow": np.linspace(0.06, 0.75, 12), "fast": np.linspace(1.1, 9.3, 12)}


def lost(kind: str, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return which of so many samples are missing: about half of them in a few long gaps, or in short ones."""
    missing = np.zeros(count, dtype=np.bool_)
    length, number = {"long": (count // 6, 3), "short": (4, count // 8)}[kind]
    for place in np.linspace(0.03, 0.8, number):
        first = int(place * count) + int(rng.integers(0, 3))
        missing[first : first + length] = True
    return missing


def shaken(seed: int, *, free: bool) -> Scene:
    """Return a block that is shaken along z for two fifths of the time, of which only the mean is compared."""
    case = closed_form.recording(None, 200 + seed, moving=False)
    span = {"kind": "vibration", "start_s": 60.0, "end_s": 156.0, "grms": 0.5, "band_hz": [3.0, 9.0]}
    meta = case.meta.model_dump(exclude_none=True)
    meta["motion"] = [{**span, "axis": [0.0, 0.0, 1.0]}]
    samples = case.samples.copy()
    rows = (samples["time"] > 60.0) & (samples["time"] <= 156.0)
    course = np.random.default_rng(seed).standard_normal(int(rows.sum()))
    samples["dv"][rows, 2] += 5.0 / closed_form.RATE_HZ * (course - course.mean())
    stated = Recording(samples, RecordingMeta.model_validate(meta), case.path, case.meta_path)
    return compare(stated, closed_form.model(free=free))


def after_turns(seed: int) -> Scene:
    """Return a block that is shaken along z after turns, whose scale is 1 % off: 490 σ between attitudes."""

    def off(_: closed_form.Truth, readings: np.ndarray) -> None:
        readings[:, 2] *= 1.01

    case = closed_form.recording(off, 300 + seed)
    span = {"kind": "vibration", "start_s": 205.0, "end_s": 235.0, "grms": 0.5, "band_hz": [3.0, 9.0]}
    meta = case.meta.model_dump(exclude_none=True)
    meta["motion"] = [*meta["motion"], {**span, "axis": [0.0, 0.0, 1.0]}]
    stated = Recording(case.samples, RecordingMeta.model_validate(meta), case.path, case.meta_path)
    return compare(stated, closed_form.model())


def power_over_stated(scene: Scene, channel: int, band_hz: tuple[float, float]) -> tuple[float, int]:
    """Return the power of a channel over that stated, summed over a band, and of how many coefficients."""
    evidence, slot = Evidence(Library([scene], only=(), plain=True)), (0, channel)
    stated, fit, basis = evidence.stated[slot], evidence.fit([]), evidence.basis[slot]
    assert stated is not None
    band = (basis.frequency_hz > band_hz[0]) & (basis.frequency_hz < band_hz[1])
    return float(np.sum(fit.rss[slot][band] / stated[band])), int(basis.counts[band].sum())


def with_lost(seed: int, kind: str, *, free: bool) -> Scene:
    """Return a block at rest with about half the samples of accel_z missing."""
    whole = compare(closed_form.recording(None, 200 + seed, moving=False), closed_form.model(free=free))
    missing = whole.data.missing.copy()
    missing[:, 2] |= lost(kind, len(missing), np.random.default_rng(seed))
    assert 0.4 < missing[:, 2].mean() < 0.6
    return replace(whole, data=replace(whole.data, missing=missing))


@pytest.mark.parametrize("free", [True, False])
@pytest.mark.parametrize("kind", ["long", "short", "shaken"])
@pytest.mark.parametrize("lines", LINES_HZ)
def test_lines_that_are_not_there_gain_as_much_where_half_the_noise_is_missing(
    lines: str, kind: str, *, free: bool
) -> None:
    """Twice the gain of two amplitudes is χ² of two, whatever was lost, or had its noise put back for a shaking."""
    total = 0.0
    for seed in range(SEEDS):
        scene = shaken(seed, free=free) if kind == "shaken" else with_lost(seed, kind, free=free)
        library = Library([scene], only=(), plain=True)
        shapes = [{"frequency": float(hertz)} for hertz in LINES_HZ[lines]]
        trials = [library.trial("sinusoid", "accel_z", shape, 1.0) for shape in shapes]
        evidence = Evidence(library)
        bare = evidence.fit([])
        for line in trials:
            assert line is not None
            total += 2.0 * (evidence.fit(line.columns, bare).value - bare.value)
    low, high = chi2.ppf([1e-4, 1.0 - 1e-4], 2 * SEEDS * LINES_HZ[lines].size)
    assert low < total < high


@pytest.mark.parametrize("band_hz", [(0.02, 1.0), (1.0, 5.0), (5.0, 10.0)])
@pytest.mark.parametrize("steps_each", [0.31, 0.5])
def test_rounding_errors_beside_gaps_are_as_large_as_those_of_a_simulated_readout(
    steps_each: float, band_hz: tuple[float, float]
) -> None:
    """In each band the power over the noise is χ², whether successive errors are nearly alike or opposite."""
    step = EARTH_UP_RADPS / closed_form.RATE_HZ / steps_each
    ideal = closed_form.model().noise
    noise = ideal.model_copy(update={"gyro_z": ideal.gyro_z.model_copy(update={"quantisation": step})})
    total, count = 0.0, 0
    for seed in range(SEEDS):
        random = np.random.default_rng(seed)
        case = closed_form.recording(None, 400 + seed, moving=False)
        samples = case.samples.copy()
        integral = np.cumsum(samples["dtheta"][:, 2]) + step * random.random()
        samples["dtheta"][:, 2] = np.diff(np.rint(integral / step), prepend=0.0) * step
        came = random.random(len(samples)) > 0.03
        came[[0, -1]] = True
        scene = compare(replace(case, samples=samples[came]), BlockModel(noise=noise))
        found, of = power_over_stated(scene, 5, band_hz)
        total, count = total + found, count + of
    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], count)
    assert low < total < high


@pytest.mark.parametrize(("share", "long"), [(0.1, 1), (0.1, 5), (0.3, 1)])
def test_noise_of_which_many_samples_are_missing_is_neither_larger_nor_less(share: float, long: int) -> None:
    """At all frequencies the power over the noise is χ², less what values that repeat others have to say."""
    power: dict[str, list[float]] = {"slow": [], "fast": []}
    for seed in range(SEEDS):
        scene = compare(closed_form.recording(None, 500 + seed, moving=False), closed_form.model())
        missing = np.zeros(scene.data.missing.shape, dtype=np.bool_)
        first = np.random.default_rng(seed).choice(
            len(missing) - long, round(share * len(missing) / long), replace=False
        )
        missing[(first[:, None] + np.arange(long)).ravel()] = True
        scene = replace(scene, data=replace(scene.data, missing=missing))
        evidence = Evidence(Library([scene], only=(), plain=True))
        fit = evidence.fit([])
        for slot, stated in evidence.stated.items():
            assert stated is not None
            hertz, counts = evidence.basis[slot].frequency_hz, evidence.basis[slot].counts
            for name, band in (("slow", (hertz > 0.02) & (hertz < 1.0)), ("fast", hertz > 4.0)):
                power[name].append(float(np.sum(fit.rss[slot][band] / stated[band]) / counts[band].sum()))
    for ratios in power.values():
        off = (np.mean(ratios) - 1.0) / (np.std(ratios, ddof=1) / math.sqrt(len(ratios)))
        assert abs(off) < 3.3


def test_noise_put_back_under_a_vibration_is_none_of_what_attitudes_differ_by() -> None:
    """Its power from 1 to 9 Hz over the noise is F: of its coefficients, and of those at rest that say how much it is.

    These are faded and trimmed, and count for a quarter of the samples.
    """
    total, count, at_rest = 0.0, 0, 0
    for seed in range(SEEDS):
        scene = after_turns(seed)
        residual, _ = level_spread(scene, 2)
        rows = (scene.time_s > 205.5) & (scene.time_s < 234.5)
        power = np.square(dct(residual[rows] / scene.noise_sigma[2], norm="ortho"))
        hertz = np.arange(power.size) / power.size * 0.5 * closed_form.RATE_HZ
        band = (hertz > 1.0) & (hertz < 9.0)
        total += float(power[band].sum())
        count += int(band.sum())
        turning = sum(end_s - start_s for start_s, end_s, _, _ in closed_form.TURNS)
        at_rest += round((closed_form.DURATION_S - turning - 30.0) * closed_form.RATE_HZ)
    low, high = f.ppf([1e-4, 1.0 - 1e-4], count, 0.25 * at_rest)
    assert low < total / count < high
