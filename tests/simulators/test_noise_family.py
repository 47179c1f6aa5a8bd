"""The noise family of the discrepancy workflow has the spectra of processes simulated apart."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.fft import dct
from scipy.signal import lfilter
from scipy.stats import chi2

from simulators.discrepancy.whitening import SWAY, cosine_basis

COUNT, INTERVAL_S, RECORDS = 4096, 0.01, 60


@pytest.mark.parametrize("tilted", [False, True])
def test_a_mount_that_sways_acts_on_accelerometers_by_its_angle_and_on_gyros_by_its_rate(tilted: bool) -> None:
    """Per bin the mean of RECORDS periodograms, 99.9 % of all bins.

    The angle that a record's ends are apart by is most of a rate's power below the correlation time. The mean alone is
    left out there: the family does not use it.
    """
    basis, rng = cosine_basis(COUNT, INTERVAL_S, tilted=tilted), np.random.default_rng(3)
    place = next(k for k in basis.terms(SWAY) if basis.names[k].startswith("sway 0.245"))
    decay = math.exp(-1.0 / 24.5)
    power = np.zeros(len(basis.counts))
    for _ in range(RECORDS):
        angle = lfilter([1.0], [1.0, -2.0 * decay, decay**2], rng.standard_normal(COUNT + 1001))[1000:]
        seen = angle[1:] if tilted else np.diff(angle)
        power += np.add.reduceat(dct(seen, norm="ortho") ** 2, basis.bounds[:-1])
    low = slice(0 if tilted else 1, int(np.searchsorted(basis.frequency_hz, 2.0)))  # above it leaks, too
    counted = RECORDS * basis.counts[low]
    ratio = power[low] / counted / basis.power[low, place]
    ratio /= np.average(ratio, weights=counted)
    bounds = np.array(chi2.interval(1.0 - 1e-3 / len(counted), counted)) / counted
    assert np.all((bounds[0] < ratio) & (ratio < bounds[1])), ratio
