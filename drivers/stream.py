"""One stream of bytes to batches of samples: the same path for a live line and for a replayed capture."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.clock import HostClock
from drivers.continuity import Continuity, Gap
from drivers.counters import Counters
from drivers.framing import Splitter
from drivers.messages import Received
from drivers.protocols.base import Frame, FrameRun, Protocol, ProtocolError
from drivers.rate_check import RateCheck
from drivers.samples import SampleArray, Status, empty_samples

NO_CONDITION = Status(0)
STRETCH_BYTES = 2048
"""Fewer bytes than this are split sooner by plain code than compiled code is set on them."""


@dataclass(slots=True)
class Batch:
    """What the line said since the last batch.

    ``host_time_s[i]`` [simulated s] is when the last byte of ``samples[i]`` came. ``gaps`` name the rows before which
    frames are missing, ``restarts`` the rows at which the block began to count anew (its device time too), ``reopened``
    the rows that came first after the line was opened again. ``conditions`` are those that the host finds rather than
    the block: a wrong rate.
    """

    samples: SampleArray
    host_time_s: NDArray[np.float64]
    messages: list[Received] = field(default_factory=list)
    gaps: list[Gap] = field(default_factory=list)
    restarts: list[int] = field(default_factory=list)
    reopened: list[int] = field(default_factory=list)
    duplicates: int = 0
    conditions: Status = NO_CONDITION

    def __bool__(self) -> bool:
        """Whether it says anything."""
        return bool(len(self.samples) or self.messages or self.duplicates)

    def follow_clock(self, clock: HostClock) -> None:
        """Set the block's clock against the host's; where the block restarted it is another clock."""
        first = 0
        if self.restarts:
            clock.restart()
            first = self.restarts[-1]
        clock.follow(self.samples["time"][first:], self.host_time_s[first:])


class StreamDecoder:
    """Splitter, decoder and continuity of one stream."""

    def __init__(
        self, protocol: Protocol, bit_rate: float = 921600, latency_s: float = 0.1, counters: Counters | None = None
    ) -> None:
        self.counters = counters if counters is not None else Counters()
        self._protocol = protocol
        self._splitter = Splitter(protocol, bit_rate, latency_s, self.counters)
        self._decoder = protocol.decoder()
        self._decoder.host_latency_s = latency_s
        self.rate_check = RateCheck(latency_s, self._decoder.stated_rate_hz)
        self._continuity = Continuity(delay_tolerance_s=latency_s + 0.5)
        self._begun = False
        self._pieces: list[Sequence[Frame]] = []
        self._reopened_at: list[int] = []  # frames ahead of which the line was opened again

    def opened(self, host_time_s: float) -> None:
        """Note that the line was opened: what was half received before will not be completed."""
        self._pieces.append(self._splitter.restart(host_time_s))
        if self._begun:
            self._reopened_at.append(sum(map(len, self._pieces)))
        self._begun = True

    def feed(self, data: bytes, host_time_s: float) -> None:
        """Take the next bytes, whose last one came at ``host_time_s`` [simulated s]."""
        self._begun = True
        self._pieces.append(self._splitter.feed(data, host_time_s))

    def feed_chunks(self, chunks: Sequence[tuple[float, bytes]]) -> None:
        """Take the next chunks, each with the time that its last byte came [simulated s], as one by one.

        Many bytes at once, as behind a stall of the host, are split by compiled code where it is ready.
        """
        size = sum(len(data) for _, data in chunks)
        if size < STRETCH_BYTES or not self._splitter.is_compiled:
            for host_time_s, data in chunks:
                self.feed(data, host_time_s)
            return
        # Of a bytearray: an array that may not be written to is another type, for which all would be compiled anew.
        joined = np.frombuffer(bytearray().join([data for _, data in chunks]), np.uint8)
        ends = np.cumsum([len(data) for _, data in chunks])
        self.feed_stretch(joined, ends, np.array([host_time_s for host_time_s, _ in chunks]))

    def prepare(self) -> None:
        """Make compiled code ready for what comes; where it never was compiled this takes seconds."""
        self._splitter.prepare()
        samples = empty_samples(3, self._protocol.temperatures)
        samples["sequence"] = np.arange(3)
        samples["time"] = samples["sequence"] / 2000
        with suppress(ProtocolError):  # it cannot send, and so gives no samples either
            data = np.frombuffer(self._protocol.encode_samples(samples), np.uint8)
            for kind in (data, data.copy()):  # read-only bytes and others are two types to the compiler
                trial = StreamDecoder(self._protocol)
                trial.feed_stretch(kind, np.array([len(kind)]), np.zeros(1))
                trial.take()

    def feed_stretch(self, data: NDArray[np.uint8], ends: NDArray[np.int64], times_s: NDArray[np.float64]) -> None:
        """Take many chunks at once, which end at ``ends`` in ``data`` and came at ``times_s`` [simulated s]."""
        self._begun = True
        self._pieces.append(self._splitter.feed_stretch(data, ends, times_s))

    def finish(self) -> None:
        """Note that nothing more will come: whole frames behind an unfinished one are found, the rest is discarded."""
        self._pieces.append(self._splitter.restart(float("-inf")))

    def take(self, now_s: float | None = None) -> Batch:
        """Decode what has come; with ``now_s``, frames behind a header whose time is up as well."""
        if now_s is not None:
            self._pieces.append(self._splitter.expire(now_s))
        frames = self._take_frames()
        decoded = self._decoder.decode(frames)
        samples, host_time_s = decoded.samples, arrivals_s(frames)
        if not np.array_equal(decoded.frame_of_sample, np.arange(len(frames))):  # else copies are spared
            host_time_s = host_time_s[decoded.frame_of_sample]
        self.rate_check.follow(samples, host_time_s)
        reopened = self._rows_after_reopening(decoded.frame_of_sample)
        marks = self._continuity.follow(samples, host_time_s, reopened)
        if marks.duplicates:
            samples, host_time_s = samples[marks.keep], host_time_s[marks.keep]
        self._count(len(samples), decoded.rejects, marks.duplicates, marks.gaps, marks.restarts)
        return Batch(
            samples,
            host_time_s,
            decoded.messages,
            marks.gaps,
            marks.restarts,
            [int(np.searchsorted(marks.keep, row)) for row in reopened],
            marks.duplicates,
            self.rate_check.condition,
        )

    def _take_frames(self) -> Sequence[Frame]:
        """Return what has been split since the last call, as it stands where it is of one piece."""
        pieces, self._pieces = [piece for piece in self._pieces if len(piece)], []
        if len(pieces) == 1:
            return pieces[0]
        return [frame for piece in pieces for frame in piece]

    def _rows_after_reopening(self, frame_of_sample: NDArray[np.intp]) -> list[int]:
        """Return the first row behind each re-opening; one with none yet waits for the next batch."""
        rows = {int(np.searchsorted(frame_of_sample, frame)) for frame in self._reopened_at}
        self._reopened_at = [0] if len(frame_of_sample) in rows else []
        return sorted(rows - {len(frame_of_sample)})

    def _count(self, samples: int, rejects: int, duplicates: int, gaps: list[Gap], restarts: list[int]) -> None:
        """Add what one batch brought."""
        self.counters.samples += samples
        self.counters.decode_rejects += rejects
        self.counters.duplicates += duplicates
        self.counters.gaps += len(gaps)
        self.counters.frames_lost += sum(gap.frames for gap in gaps)
        self.counters.restarts += len(restarts)


def arrivals_s(frames: Sequence[Frame]) -> NDArray[np.float64]:
    """Return when the last byte of each frame came [simulated s]."""
    if isinstance(frames, FrameRun):
        return frames.host_time_s
    return np.array([frame.host_time_s for frame in frames], np.float64)
