"""What is to be said of the recordings themselves, before anything is said of the block."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.recording import Recording
from simulators.discrepancy.switched_on import tell_switch_on


def remarks(recordings: Sequence[Recording]) -> list[str]:
    """Return a sentence for each thing that was made of recordings as they were read."""
    said = []
    if not tell_switch_on(recordings):
        at = ", ".join(f"{recording.samples['time'][0]:.2f} s" for recording in recordings)
        said.append(
            f"Time stamps, the first at {at}, cannot count from switch-on: all times are counted from the first sample."
        )
    return said
