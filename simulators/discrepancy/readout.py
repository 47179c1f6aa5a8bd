"""A readout in finer steps than the model states, or in none: its sensor has so much less noise, and nothing else."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from inertial.documents import CHANNELS
from simulators.discrepancy.candidates import Slot
from simulators.discrepancy.evidence import Evidence, Fit
from simulators.discrepancy.noise_likelihood import log_likelihood, most_likely
from simulators.discrepancy.resolution import AS_STATED, coarser
from simulators.discrepancy.whitening import PENALTY, WHITE

Array = NDArray[np.float64]


def as_read(evidence: Evidence, fit: Fit, slot: Slot) -> Array:
    """Return the stated power (b,) of a slot, with less of its rounding where the readout is finer.

    The increments tell its step, if they lie on any.
    """
    stated, scene = evidence.stated[slot], evidence.library.scenes[slot[0]]
    assert stated is not None
    noise = getattr(scene.model.noise, CHANNELS[slot[1]])
    times = coarser(scene, slot[1])
    if not noise.quantisation or (times is not None and times > 1.0 - AS_STATED):
        return stated
    less = _less_rounding(evidence, fit, slot, stated)
    if times is None:
        return less
    finer = evidence.read_with(slot, noise.model_copy(update={"quantisation": times * noise.quantisation}))
    return max(less, finer, key=lambda power: log_likelihood(evidence, fit, {slot: power}))


def _less_rounding(evidence: Evidence, fit: Fit, slot: Slot, stated: Array) -> Array:
    """Return the stated power (b,) with as little of its rounding as the spectrum shows, in white noise of any size."""
    noise = getattr(evidence.library.scenes[slot[0]].model.noise, CHANNELS[slot[1]])
    smooth = evidence.read_with(slot, noise.model_copy(update={"quantisation": 0.0}))
    slow, rounding = evidence.floor[slot], np.maximum(stated - smooth, 0.0)
    white = np.maximum(smooth - slow, 0.0)[:, None]
    whole, least = {slot: slow + rounding}, {slot: slow}
    both = np.column_stack([white, rounding])
    size = most_likely(evidence, fit, whole, {slot: white}, np.ones(1))
    sizes = most_likely(evidence, fit, least, {slot: both}, np.ones(2))
    gain = log_likelihood(evidence, fit, {slot: slow + both @ sizes})
    gain -= log_likelihood(evidence, fit, {slot: whole[slot] + white @ size})
    finer = sizes[1] < 1.0 and gain > PENALTY[WHITE] * evidence.scatter(slot)
    return np.asarray(smooth + sizes[1] * rounding) if finer else stated
