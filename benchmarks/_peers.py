"""What others would do with the same files: PySINDy's STLSQ and forward-stepwise BIC over a textbook's regressors.

Both get the recording, the model's noise and a dictionary of closed-form columns per channel plus set-up errors, raw or
whitened by the model's noise in a DCT basis. Whitened, they are also given the
reference's σ. Neither knows ties or *unknown*.
"""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.fft import dct

from benchmarks._blind.dictionary import Label, columns, lines, setups
from benchmarks._blind.motion import Setup, Shake, Turn, normal_gravity
from benchmarks._blind.noise import Spectrum
from benchmarks._blind.oracle import nuisance, project
from benchmarks._blind.world import CHANNELS, World
from drivers.recording import read_recording

PEERS = ("stlsq raw", "stlsq whitened", "stepwise raw", "stepwise whitened")
_MOST = 12


def names(folder: Path) -> dict[str, list[Label]]:
    """Return what each peer names on the case in ``folder``."""
    world, residual, spectra, doubts = believed(folder)
    together = setups(world.setup)
    common = [world.inputs_of(replace(world.setup, **change)) - world.inputs for _, change in together]
    found = {}
    for kind in ("raw", "whitened"):
        labels, (own, rest), y = _compressed(world, residual, spectra, [*common, *doubts], kind == "whitened")
        theta = np.hstack([own, rest[:, : len(common)]])
        if kind == "whitened":  # the reference's σ as part of the covariance
            theta, y = _beyond(rest[:, len(common) :], theta, y)
        labels = [*labels, *[label for label, _ in together]]
        rows = 6 * world.count
        found[f"stlsq {kind}"] = _unique(labels, _stlsq(theta, y, rows))
        found[f"stepwise {kind}"] = _unique(labels, _stepwise(theta, y, rows))
    return found


def _beyond(doubts: np.ndarray, theta: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Regression with nuisance columns of unit prior eliminated."""
    return project(theta.T, doubts.T).T, project(y, doubts.T)


def believed(folder: Path) -> tuple[World, np.ndarray, list[Spectrum], list[np.ndarray]]:
    """World as the recording states it, residuals (n, 6) of the prediction (0 where frames are lost), the noise,
    and what one σ of each reference parameter does to the readings.
    """
    recording = read_recording(folder / "recording")
    model = json.loads((folder / "block.json").read_text())
    meta, samples = recording.meta, recording.samples
    latitude, height = np.radians(meta.site.latitude_deg), meta.site.height_m
    ref = meta.reference
    turns, shakes = [], []
    for motion in meta.motion:
        if motion.kind == "turn":
            rate, axis = np.radians(motion.rate_dps), tuple(motion.axis)
            sigma = np.radians(motion.angle_sigma_deg or 0.0)
            turns.append(Turn(motion.start_s, motion.end_s, rate, axis, motion.frame, sigma))
        elif motion.kind == "vibration":
            none = np.array([1.0]), np.array([0.0])
            shakes.append(
                Shake(motion.start_s, motion.end_s, tuple(motion.axis), motion.grms, tuple(motion.band_hz), *none)
            )
    gravity = meta.site.gravity_mps2 or normal_gravity(latitude, height)
    angles = [float(np.radians(a)) for a in (ref.azimuth_deg, ref.roll_deg, ref.pitch_deg, ref.heading_deg)]
    setup = Setup(latitude, gravity, *angles, tuple(turns))
    sequence = samples["sequence"].astype(int)
    count, dt = int(sequence[-1]) + 1, 1 / meta.block.sample_rate_hz
    grid = np.arange(count)
    temperature = np.interp(grid, sequence, samples["temperature"][:, 0])
    world = World(setup, count, dt, temperature, np.interp(grid, sequence, samples["supply"]))
    readings = np.hstack([samples["dv"], samples["dtheta"]]) / np.median(np.diff(samples["time"]))
    residual = np.zeros((count, 6))
    residual[sequence] = readings - _predicted(world, model)[sequence]
    shaken = World(replace(setup, shakes=tuple(shakes)), count, dt, temperature, world.supply)
    world.__dict__["vibration"] = shaken.vibration
    spectra = [Spectrum(**model["noise"][name]) for name in CHANNELS]
    sigma = {"azimuth": np.radians(ref.azimuth_sigma_deg), "level": np.radians(ref.level_sigma_deg)}
    priors = [(CHANNELS.index(e["channel"]), e["parameters"]["shift"]["sigma"]) for e in model["effects"]]
    return world, residual, spectra, nuisance(world, sigma, ref.level_frame == "body", priors)


def _predicted(world: World, model: dict) -> np.ndarray:
    """Readings (n, 6) that the model expects."""
    out = np.empty_like(world.inputs)
    for i, name in enumerate(CHANNELS):
        terms = model["calibration"][name]
        out[:, i] = (world.inputs[:, i] - terms["bias_mps2" if i < 3 else "bias_radps"]) / terms["scale_positive"]
    for effect in model["effects"]:
        out[:, CHANNELS.index(effect["channel"])] += effect["parameters"]["shift"]["value"]
    return out


def _compressed(
    world: World, residual: np.ndarray, spectra: list[Spectrum], common: list[np.ndarray], whitened: bool
) -> tuple[list[Label], list[np.ndarray], np.ndarray]:
    """Each channel's own columns, the common ones and the residual, pressed into as many rows as there are columns."""
    count, dt = world.count, world.dt
    frequency = np.arange(count) / (2 * count * dt)
    frequency[0] = 0.276 / (count * dt)
    labels, blocks = [], []
    for channel in range(6):
        own, table = columns(world, channel)
        level = spectra[channel].density(frequency, dt) / dt if whitened else residual[:, channel].var()
        weight = np.sqrt(level) * np.ones(count)
        peaks = lines(residual[:, channel], dct(residual[:, channel], norm="ortho") / weight, world)
        labels.append([*own, *[("sinusoid", CHANNELS[channel])] * peaks.shape[1]])
        parts = [table, peaks, *[c[:, channel, None] for c in common], residual[:, channel, None]]
        blocks.append(_press(dct(np.hstack(parts), axis=0, norm="ortho") / weight[:, None]))
    wide = [len(own) for own in labels]
    theta = np.zeros((sum(len(block) for block in blocks), sum(wide) + len(common) + 1))
    row = column = 0
    for block, own in zip(blocks, wide, strict=True):
        here = slice(row, row + len(block))
        theta[here, column : column + own] = block[:, :own]
        theta[here, sum(wide) :] = block[:, own:]
        row, column = row + len(block), column + own
    return [label for own in labels for label in own], [theta[:, : sum(wide)], theta[:, sum(wide) : -1]], theta[:, -1]


def _press(table: np.ndarray) -> np.ndarray:
    """Square matrix with the same inner products of columns."""
    length = np.linalg.norm(table, axis=0)
    length[length == 0] = 1.0
    values, vectors = np.linalg.eigh((table / length).T @ (table / length))
    return np.sqrt(np.maximum(values, 0))[:, None] * vectors.T * length


def _bic(residual_squares: float, parameters: int, rows: int) -> float:
    return rows * np.log(residual_squares / rows) + parameters * np.log(rows)


def _stlsq(theta: np.ndarray, y: np.ndarray, rows: int) -> list[int]:
    """PySINDy's optimiser on unit columns, its threshold chosen by BIC."""
    from pysindy import STLSQ

    length = np.linalg.norm(theta, axis=0)
    length[length == 0] = 1.0
    unit = theta / length
    best, chosen = _bic(float(y @ y), 0, rows), []
    for threshold in np.geomspace(2, 0.7 * np.linalg.norm(y), 8):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            weights = STLSQ(threshold=threshold, alpha=1e-3, max_iter=10).fit(unit, y).coef_[0]
        support = np.flatnonzero(weights)
        left = y - unit[:, support] @ np.linalg.lstsq(unit[:, support], y, rcond=None)[0] if len(support) else y
        score = _bic(float(left @ left), len(support), rows)
        if score < best:
            best, chosen = score, list(support)
    return chosen


def _stepwise(theta: np.ndarray, y: np.ndarray, rows: int) -> list[int]:
    """Add the column that lowers the sum of squares most, while BIC falls."""
    chosen: list[int] = []
    left, best = y.copy(), _bic(float(y @ y), 0, rows)
    basis = np.empty((len(y), 0))
    while len(chosen) < _MOST:
        free = theta - basis @ (basis.T @ theta)
        length = np.linalg.norm(free, axis=0)
        gain = np.where(length > 1e-6 * np.linalg.norm(theta, axis=0), free.T @ left / np.maximum(length, 1e-300), 0.0)
        pick = int(np.argmax(np.abs(gain)))
        after = left - free[:, pick] * gain[pick] / length[pick]
        score = _bic(float(after @ after), len(chosen) + 1, rows)
        if score >= best:
            break
        best, left = score, after
        basis = np.column_stack([basis, free[:, pick] / length[pick]])
        chosen.append(pick)
    return chosen


def _unique(labels: list[Label], chosen: list[int]) -> list[Label]:
    return sorted({labels[i] for i in chosen})
