"""What is to be said of the recordings themselves, before anything is said of the block."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.recording import Recording
from simulators.discrepancy.repair import MOST_UNREAD
from simulators.discrepancy.steady_clock import stamp_scatter_s
from simulators.discrepancy.switched_on import since_switch_on, tell_switch_on


def remarks(recordings: Sequence[Recording]) -> list[str]:
    """Return a sentence for each thing that was made of recordings as they were read."""
    said = []
    if not tell_switch_on(recordings):
        at = ", ".join(f"{recording.samples['time'][0]:.2f} s" for recording in recordings)
        said.append(
            f"Time stamps, the first at {at}, cannot count from switch-on: all times are counted from the first sample."
        )
    for recording in since_switch_on(recordings):  # which puts back what stamps lost by rounding
        if scatter_s := stamp_scatter_s(recording.samples):
            said.append(
                f"The time stamps of {recording.path.name} scatter by {1e3 * scatter_s:.2g} ms about a steady clock, "
                "by which the readings do not: the clock stands for them."
            )
        said += _unread(recording, "temperature", recording.samples["temperature"][:, :1].ravel())
        said += _unread(recording, "supply voltage", recording.samples["supply"])
    return said


def _unread(recording: Recording, what: str, values: NDArray[np.floating]) -> list[str]:
    """Say what became of samples without a value; a column that holds none at all is no loss."""
    share = 1.0 - float(np.mean(np.isfinite(values))) if len(values) else 0.0
    if share in (0.0, 1.0):
        return []
    done = (
        "straight lines stand for it"
        if share <= MOST_UNREAD
        else f"too much to draw lines across: nothing that depends on the {what} was looked for"
    )
    return [f"The {what} is missing from {100.0 * share:.3g} % of the samples of {recording.path.name}; {done}."]
