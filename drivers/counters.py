"""Every way that a byte or a frame can be lost, each with its own count."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(slots=True)
class Counters:
    """Counts of one link since it was made; none is ever reset.

    ``bytes_in`` reached the splitter and are in a frame, discarded or still waiting; ``bytes_dropped`` were read
    off the line and never reached it, the queue being full.
    """

    bytes_in: int = 0
    bytes_discarded: int = 0
    """Bytes that belong to no whole frame."""
    frames: int = 0
    """Whole frames whose checksum holds."""
    crc_failures: int = 0
    """Places where a header was right and the checksum was not."""
    resyncs: int = 0
    """Frames found after bytes had to be discarded."""
    timeouts: int = 0
    """Headers whose frame did not come in time."""
    decode_rejects: int = 0
    """Whole frames that say nothing the protocol knows."""
    samples: int = 0
    gaps: int = 0
    """Places where the frame counter stepped too far."""
    frames_lost: int = 0
    """Frames that those steps passed over."""
    duplicates: int = 0
    """Samples that came twice; the second was dropped."""
    restarts: int = 0
    """Times that the block began to count anew."""
    queue_drops: int = 0
    """Chunks dropped, oldest first, because nobody read them in time."""
    bytes_dropped: int = 0
    openings: int = 0
    """Times that the port was opened, the first included."""
    open_failures: int = 0
    disconnections: int = 0
    """Times that an open port was lost."""
    capture_failures: int = 0
    """Times that the raw capture could not be written and was given up."""

    def as_dict(self) -> dict[str, int]:
        """Return the counts by name."""
        return asdict(self)
