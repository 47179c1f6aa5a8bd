"""What a line once said, decoded: its samples in stretches between restarts of the block, and what the line lost."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.clock import ClockFit, HostClock
from drivers.continuity import Gap
from drivers.counters import Counters
from drivers.mcap_log import write_mcap
from drivers.messages import Received
from drivers.protocols.base import Protocol
from drivers.recording import RecordingMeta, write_recording
from drivers.recording_meta import BlockMeta, SiteMeta
from drivers.samples import SampleArray, Status
from drivers.sources import SourceKind, read_source, source_kind
from drivers.stream import NO_CONDITION, Batch
from service.errors import RefusedInput


@dataclass
class Stretch:
    """Samples between two restarts of the block; ``pieces``, if kept, are (samples, host times [s])."""

    count: int = 0
    first_s: float = 0.0
    last_s: float = 0.0
    pieces: list[tuple[SampleArray, NDArray[np.float64]]] = field(default_factory=list)
    gaps: list[Gap] = field(default_factory=list)

    def add(self, samples: SampleArray, host_time_s: NDArray[np.float64], gaps: list[Gap], keep: bool) -> None:
        """Append the next samples; gaps index those."""
        if not len(samples):
            return
        if not self.count:
            self.first_s = float(samples["time"][0])
        self.gaps += [Gap(gap.index + self.count, gap.frames, gap.duration_s) for gap in gaps]
        self.count, self.last_s = self.count + len(samples), float(samples["time"][-1])
        if keep:
            self.pieces.append((samples, host_time_s))

    @property
    def samples(self) -> SampleArray:
        """Return all samples in one array."""
        return np.concatenate([samples for samples, _ in self.pieces])

    @property
    def host_time_s(self) -> NDArray[np.float64]:
        """Return when each came [s]."""
        return np.concatenate([host_time_s for _, host_time_s in self.pieces])


@dataclass
class Replay:
    """What a file holds: ``stretches`` of samples, one a power-up of the block, and the ``counters`` of its line."""

    name: str
    kind: SourceKind
    stretches: list[Stretch] = field(default_factory=list)
    messages: list[Received] = field(default_factory=list)
    counters: Counters = field(default_factory=Counters)
    conditions: Status = NO_CONDITION
    clock: ClockFit | None = None

    @property
    def longest(self) -> Stretch | None:
        """Return the stretch with the most samples."""
        return max(self.stretches, key=lambda stretch: stretch.count, default=None)

    def facts(self) -> dict[str, Any]:
        """Return all this as plain data."""
        longest, clock = self.longest, self.clock
        found: dict[str, Any] = {
            "source": self.kind.value,
            "samples": sum(stretch.count for stretch in self.stretches),
            "stretches": len(self.stretches),
            "longest_span_s": None if longest is None else [longest.first_s, longest.last_s],
            "messages": len(self.messages),
            "conditions": [str(flag.name) for flag in Status if flag & self.conditions],
        }
        if clock is not None:
            found["clock_skew_ppm"] = [clock.skew * 1e6, clock.skew_sigma * 1e6]
            found["clock_offset_s"] = [clock.offset_s, clock.sigma_s]
        return {**found, **asdict(self.counters)}


def read_replay(path: Path, protocol: Protocol, *, bit_rate: float = 921600, keep: bool = True) -> Replay:
    """Decode a file; without ``keep`` the samples are counted and let go, whatever their number.

    Raises
    ------
    CaptureError
        The file cannot be read.
    RefusedInput
        It is no capture, and nothing in its bytes is a frame of this protocol.
    """
    found = Replay(str(path), source_kind(path), [Stretch()])
    clock = HostClock()
    for batch in read_source(path, protocol, bit_rate=bit_rate, counters=found.counters):
        _add(found, batch, keep)
        if found.kind is SourceKind.CAPTURE:
            batch.follow_clock(clock)
    found.stretches = [stretch for stretch in found.stretches if stretch.count]
    if found.kind is not SourceKind.CAPTURE and not found.counters.frames:
        raise RefusedInput(
            found.name,
            f"no whole record of a capture, no frame of protocol {protocol.name} in {found.counters.bytes_in} bytes.",
            "Check the file, --protocol and --option.",
        )
    found.clock = clock.fit()
    return found


def _add(found: Replay, batch: Batch, keep: bool) -> None:
    """Append a batch, beginning a new stretch where the block restarted."""
    cuts = [0, *batch.restarts, len(batch.samples)]
    for number, (low, high) in enumerate(pairwise(cuts)):
        if number:
            found.stretches.append(Stretch())
        gaps = [Gap(gap.index - low, gap.frames, gap.duration_s) for gap in batch.gaps if low <= gap.index < high]
        found.stretches[-1].add(batch.samples[low:high], batch.host_time_s[low:high], gaps, keep)
    found.messages += batch.messages
    found.conditions |= batch.conditions


def write_replay(found: Replay, out: Path) -> Path:
    """Write the longest stretch as a recording, whose site is for the user to add, or as MCAP; the suffix says which.

    The same file gives the same bytes.

    Raises
    ------
    RefusedInput
        There are no samples to write.
    RecordingError, McapError, OSError
        They cannot be written.
    """
    stretch = found.longest
    if stretch is None or stretch.count < 2:
        raise RefusedInput(found.name, "it holds no samples to write.", "Check the protocol, or capture again.")
    if out.suffix == ".mcap":
        part = out.with_name(f".{out.name}.part")
        try:
            write_mcap(part, stretch.samples, stretch.host_time_s, found.messages, stretch.gaps)
            return part.replace(out)
        finally:
            part.unlink(missing_ok=True)
    samples = stretch.samples
    # The rate of frames that follow each other, without the steps in which a device's clock counts.
    frames = int(np.uint32(samples["sequence"][-1] - samples["sequence"][0]))
    rate_hz = float(f"{frames / (stretch.last_s - stretch.first_s):.9g}")
    return write_recording(out, samples, RecordingMeta(site=SiteMeta(), block=BlockMeta(sample_rate_hz=rate_hz)))
