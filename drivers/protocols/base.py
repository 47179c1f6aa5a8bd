"""What a protocol is to the rest of the drivers: where frames begin and end, whether they are whole, what they say."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from drivers.layout import FrameLayout
from drivers.messages import Message, Received
from drivers.samples import SampleArray, empty_samples

NEED_MORE = 0
"""Answer of :meth:`Protocol.measure`: these bytes may begin a frame, more of them will tell."""
NOT_A_FRAME = -1
"""Answer of :meth:`Protocol.measure`: no frame begins here."""

Buffer = bytes | bytearray


class ProtocolError(ValueError):
    """A protocol is unknown, was given an option it does not have, or cannot say what was asked."""


class Frame(NamedTuple):
    """One whole frame whose checksum holds, and when its last byte reached the host [simulated s]."""

    data: bytes
    host_time_s: float


class FrameRun(Sequence[Frame]):
    """Frames that stand in one array of bytes: ``data[starts[i]:stops[i]]`` came at ``host_time_s[i]``.

    What a replay gives a decoder. It reads as any sequence of frames; a decoder that wants speed takes the arrays.
    """

    def __init__(
        self,
        data: NDArray[np.uint8],
        starts: NDArray[np.int64],
        stops: NDArray[np.int64],
        host_time_s: NDArray[np.float64],
    ) -> None:
        self.data, self.starts, self.stops, self.host_time_s = data, starts, stops, host_time_s

    def __len__(self) -> int:
        return len(self.starts)

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> FrameRun: ...
    def __getitem__(self, index: int | slice) -> Frame | FrameRun:
        if isinstance(index, slice):
            return FrameRun(self.data, self.starts[index], self.stops[index], self.host_time_s[index])
        return Frame(self.data[self.starts[index] : self.stops[index]].tobytes(), float(self.host_time_s[index]))


def no_indices() -> NDArray[np.intp]:
    """Return an empty index array."""
    return np.zeros(0, np.intp)


@dataclass(slots=True)
class Decoded:
    """What a run of frames says.

    ``frame_of_sample[i]`` is the index of the frame that gave ``samples[i]``; ``rejects`` counts frames that are
    whole but say nothing this protocol knows.
    """

    samples: SampleArray = field(default_factory=empty_samples)
    frame_of_sample: NDArray[np.intp] = field(default_factory=no_indices)
    messages: list[Received] = field(default_factory=list)
    rejects: int = 0


class Decoder(ABC):
    """Frames of one stream to samples and messages; keeps what the stream has said so far (settings, counters).

    ``host_latency_s`` is set by whoever feeds it: how late host times may be. ``stated_rate_hz`` is the rate that
    device or user states where the device sends no time of its own, to be checked against the host's clock.
    """

    host_latency_s: float = 0.1
    stated_rate_hz: float | None = None

    @abstractmethod
    def decode(self, frames: Sequence[Frame]) -> Decoded:
        """Decode the next frames of the stream, in the order received. Never raises on what a device may send."""


class Protocol(ABC):
    """Layout of one maker's frames. Immutable: what a stream says about itself is kept by its :class:`Decoder`.

    ``sync`` lists every byte pattern that a frame may begin with, ``longest`` is the greatest legal frame length
    [bytes], ``temperatures`` the number of temperature sensors in its samples, ``bit_rates`` what its devices are set
    to, the usual one first, ``checksum_bits`` how many bits prove a frame, and ``commands`` whether its devices are
    told when to speak; others speak from power-up. ``requests`` are bytes that make such a device say something of
    itself, each with the message that it answers with; they are sent whenever a line has been opened. ``rates_hz`` are
    the sample rates that its devices have, none where they have any.
    """

    name: ClassVar[str]
    bit_rates: ClassVar[tuple[int, ...]] = (921600,)
    checksum_bits: ClassVar[int] = 32
    commands: ClassVar[bool] = False
    requests: ClassVar[Mapping[bytes, type]] = {}
    sync: tuple[bytes, ...]
    longest: int
    temperatures: int = 1
    rates_hz: tuple[float, ...] = ()

    @abstractmethod
    def measure(self, data: Buffer, start: int, stop: int) -> int:
        """Return the length of the frame that begins at ``start``, where a sync pattern stands.

        Looks at no byte from ``stop`` on. Returns :data:`NEED_MORE` when more bytes must come first and
        :data:`NOT_A_FRAME` when the header is impossible. Everything that the header alone can show to be wrong is
        refused here, before anyone waits for a body.
        """

    @abstractmethod
    def check(self, data: Buffer, start: int, stop: int) -> bool:
        """Return whether the checksum of the frame in ``data[start:stop]`` holds."""

    @abstractmethod
    def decoder(self) -> Decoder:
        """Return a fresh decoder for one stream."""

    @abstractmethod
    def encode_samples(self, samples: SampleArray) -> bytes:
        """Return the frames of ``samples`` one after another, as the device would send them."""

    def layout(self) -> FrameLayout | None:
        """Return all frames as a table when one can say the same as ``measure`` and ``check``: replays are faster."""
        return None

    def encode_message(self, message: Message, sequence: int = 0, time_s: float = 0.0) -> bytes:
        """Return the frame of a message or command.

        Raises
        ------
        ProtocolError
            The protocol has no such message.
        """
        raise ProtocolError(
            f"protocol {self.name} has no frame for {type(message).__name__} (no. {sequence}, {time_s} s)"
        )
