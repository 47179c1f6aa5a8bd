"""Commands to a block: sent, answered or sent again, and given up after a bounded number of tries."""

from __future__ import annotations

import queue
import secrets
import time
from collections.abc import Callable
from typing import Protocol as Interface

from drivers.link import LinkError
from drivers.messages import (
    Acknowledgement,
    Command,
    Compensation,
    Configuration,
    Identity,
    Message,
    Outcome,
    ReadCompensation,
    ReadConfiguration,
    ReadIdentity,
    Received,
)
from drivers.protocols.base import Protocol, ProtocolError
from drivers.timebase import Timebase

HOST_LATENCY_S = 0.25
"""No time-out is shorter than this [real s], however fast simulated time runs: the answer passes two processes."""

_ANSWERS: dict[type, type] = {
    ReadCompensation: Compensation,
    ReadConfiguration: Configuration,
    ReadIdentity: Identity,
}


class CommandError(RuntimeError):
    """A command failed: ``what`` was commanded, ``where``, and the ``remedy``."""

    def __init__(self, what: str, where: str, reason: str, remedy: str) -> None:
        self.what, self.where, self.reason, self.remedy = what, where, reason, remedy
        super().__init__(f"{what} to {where}: {reason}. {remedy}.")


class Line(Interface):
    """What a channel needs of a link."""

    url: str
    protocol: Protocol
    timebase: Timebase
    on_message: list[Callable[[Received], None]]

    def send(self, data: bytes) -> None:
        """Send bytes to the block."""


class CommandChannel:
    """Commands over one link, one at a time.

    Parameters
    ----------
    link : the line; another thread must be calling its ``read``, which brings the answers, unless there is a ``pump``.
    pump : called again and again with a number of real seconds while an answer is waited for; it reads the link.
    first_number : of the first command; by default drawn, so that a new host is not taken for the old one's repeat.

    Notes
    -----
    A command that is sent again keeps its number, and the block answers a number that it has just carried out without
    doing it twice: a write whose acknowledgement was lost counts once.
    """

    def __init__(
        self, link: Line, pump: Callable[[float], object] | None = None, first_number: int | None = None
    ) -> None:
        self._link, self._pump = link, pump
        self._number = secrets.randbelow(2**31) if first_number is None else first_number
        self._answers: queue.SimpleQueue[Received] = queue.SimpleQueue()
        link.on_message.append(self._answers.put)

    def close(self) -> None:
        """Listen no more."""
        self._link.on_message.remove(self._answers.put)

    def execute(self, command: Command, timeout_s: float = 0.5, tries: int = 3) -> Message:
        """Send a command and return its answer: the message asked for, or the acknowledgement.

        ``timeout_s`` [simulated s] is how long each of ``tries`` waits.

        Raises
        ------
        CommandError
            No answer, a refusal, a line that is down, or a protocol that has no such command.
        """
        what = type(command).__name__
        self._number = (self._number + 1) % 2**32 or 1
        try:
            frame = self._link.protocol.encode_message(command, self._number)
        except ProtocolError as error:
            raise CommandError(what, self._link.url, str(error), "Use what this block understands") from None
        problem = "no answer"
        for _ in range(tries):
            try:
                self._link.send(frame)
            except LinkError as error:
                problem = str(error).rstrip(".")
            answer = self._await(command, max(self._link.timebase.real_s(timeout_s), HOST_LATENCY_S))
            if answer is not None:
                return self._accept(what, answer)
        reason = f"{problem} in {tries} tries of {timeout_s:g} s"
        raise CommandError(
            what, self._link.url, reason, "Check that the block is powered and its receive line connected"
        )

    def _await(self, command: Command, real_s: float) -> Message | None:
        """Return the answer to the current command if it comes in time."""
        wanted = _ANSWERS.get(type(command), Acknowledgement)
        deadline = time.monotonic() + real_s
        while (remaining := deadline - time.monotonic()) > 0:
            try:
                if self._pump is None:
                    received = self._answers.get(timeout=remaining)
                else:
                    self._pump(min(remaining, 0.01))
                    received = self._answers.get_nowait()
            except queue.Empty:
                continue
            answer = received.message
            refused = isinstance(answer, Acknowledgement) and answer.outcome is not Outcome.DONE
            if received.sequence == self._number and (refused or isinstance(answer, wanted)):
                return answer
        return None

    def _accept(self, what: str, answer: Message) -> Message:
        """Return the answer, unless it is a refusal."""
        if isinstance(answer, Acknowledgement) and answer.outcome is not Outcome.DONE:
            reason = f"refused: {answer.outcome.name.lower().replace('_', ' ')}"
            raise CommandError(what, self._link.url, reason, _REMEDIES[answer.outcome])
        return answer


_REMEDIES = {
    Outcome.UNKNOWN_COMMAND: "This block does not know the command: check its firmware and the protocol chosen",
    Outcome.BAD_ARGUMENT: "Give a value within the block's range; its configuration says which",
    Outcome.NOT_NOW: "Wait until its self-test is over and try again",
    Outcome.STORAGE_FAULT: "The block could not keep the terms: try once more, then have it serviced",
}
