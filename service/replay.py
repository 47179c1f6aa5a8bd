"""A raw capture decoded: its samples in stretches between restarts of the block, and what the line lost."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from drivers.capture import replay
from drivers.counters import Counters
from drivers.protocols import get_protocol
from drivers.recording import RecordingMeta, write_recording
from drivers.recording_meta import BlockMeta, SiteMeta
from drivers.samples import SampleArray
from service.errors import RefusedInput


@dataclass(frozen=True)
class Replay:
    """What a capture holds: ``stretches`` of samples, one a power-up of the block, and the ``counters`` of its line."""

    name: str
    stretches: list[SampleArray]
    messages: list[str]
    counters: Counters

    @property
    def longest(self) -> SampleArray | None:
        """Return the stretch with the most samples."""
        return max(self.stretches, key=len, default=None)

    def facts(self) -> dict[str, Any]:
        """Return all this as plain data."""
        longest = self.longest
        span = None if longest is None else [float(longest["time"][0]), float(longest["time"][-1])]
        return {
            "samples": sum(len(stretch) for stretch in self.stretches),
            "stretches": len(self.stretches),
            "longest_span_s": span,
            "messages": len(self.messages),
            **asdict(self.counters),
        }


def read_replay(path: Path, protocol: str) -> Replay:
    """Decode a capture.

    Raises
    ------
    CaptureError, ProtocolError
        The file is no capture, or the protocol is not known.
    """
    counters = Counters()
    pieces: list[list[SampleArray]] = [[]]
    messages: list[str] = []
    for batch in replay(path, get_protocol(protocol), counters=counters):
        cuts = [0, *batch.restarts, len(batch.samples)]
        for number, (low, high) in enumerate(pairwise(cuts)):
            if number:
                pieces.append([])
            if high > low:
                pieces[-1].append(batch.samples[low:high])
        messages += [type(received.message).__name__ for received in batch.messages]
    stretches = [np.concatenate(parts) for parts in pieces if parts]
    return Replay(str(path), stretches, messages, counters)


def write_replay(found: Replay, out: Path) -> Path:
    """Write the longest stretch as a recording; its site is for the user to add."""
    samples = found.longest
    if samples is None or len(samples) < 2:
        raise RefusedInput(found.name, "it holds no samples to write.", "Check the protocol, or capture again.")
    rate_hz = float(1.0 / np.median(np.diff(samples["time"])))
    return write_recording(out, samples, RecordingMeta(site=SiteMeta(), block=BlockMeta(sample_rate_hz=rate_hz)))
