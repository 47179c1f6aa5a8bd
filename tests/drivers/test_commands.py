"""Commands: answered, repeated, refused, given up; by number, so that a repeat is not done twice."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from drivers.commands import CommandChannel, CommandError
from drivers.framing import Splitter
from drivers.link import LinkError
from drivers.messages import (
    Acknowledgement,
    Compensation,
    Message,
    Outcome,
    ReadCompensation,
    Received,
    SetRate,
    Start,
    WriteCompensation,
    terms_crc,
)
from drivers.protocols import get_protocol
from drivers.protocols.base import Protocol
from drivers.timebase import Timebase

F, G = (1e-3, -2e-3, 3e-3), (1e-6, 2e-6, -3e-6)
DONE = Acknowledgement("Start", Outcome.DONE)


class ScriptedBlock:
    """Stands for link and block: answers each try with what the script says."""

    url = "scripted"

    def __init__(self, *script: Message | LinkError | None, offset: int = 0) -> None:
        self.protocol: Protocol = get_protocol("native")
        self.timebase = Timebase(1000.0)
        self.on_message: list[Callable[[Received], None]] = []
        self.script = list(script)
        self.heard: list[Received] = []
        self.offset = offset

    def send(self, data: bytes) -> None:
        frames = Splitter(self.protocol).feed(data, 0.0)
        (received,) = self.protocol.decoder().decode(frames).messages
        self.heard.append(received)
        answer = self.script.pop(0) if self.script else None
        if isinstance(answer, LinkError):
            raise answer
        if answer is not None:
            for listener in self.on_message:
                listener(Received(answer, received.sequence + self.offset, 0.0, 0.0))


def test_an_acknowledged_command_is_sent_once() -> None:
    block = ScriptedBlock(DONE)
    assert CommandChannel(block).execute(Start()) == DONE
    assert [received.message for received in block.heard] == [Start()]


def test_a_request_is_answered_by_what_it_asks_for() -> None:
    kept = Compensation(F, G, 3, terms_crc(F, G))
    assert CommandChannel(ScriptedBlock(kept)).execute(ReadCompensation()) == kept


def test_a_lost_answer_is_asked_for_again_under_the_same_number() -> None:
    block = ScriptedBlock(None, DONE)
    CommandChannel(block).execute(WriteCompensation(F, G))
    assert len(block.heard) == 2
    assert len({received.sequence for received in block.heard}) == 1
    assert block.heard[0].message == WriteCompensation(F, G)


def test_another_commands_answer_is_not_taken_for_this_ones() -> None:
    block = ScriptedBlock(DONE, DONE, DONE, offset=-1)
    with pytest.raises(CommandError, match="no answer in 3 tries"):
        CommandChannel(block).execute(Start())


def test_silence_is_given_up_after_the_stated_tries() -> None:
    block = ScriptedBlock()
    with pytest.raises(CommandError, match=r"Start to scripted: no answer in 2 tries.*powered") as caught:
        CommandChannel(block).execute(Start(), tries=2)
    assert len(block.heard) == 2
    assert (caught.value.what, caught.value.where) == ("Start", "scripted")


@pytest.mark.parametrize("outcome", [outcome for outcome in Outcome if outcome is not Outcome.DONE])
def test_a_refusal_is_reported_with_its_reason_and_not_repeated(outcome: Outcome) -> None:
    block = ScriptedBlock(Acknowledgement("SetRate", outcome))
    with pytest.raises(CommandError, match=outcome.name.lower().replace("_", " ")):
        CommandChannel(block).execute(SetRate(1.0))
    assert len(block.heard) == 1


def test_a_refused_request_is_a_refusal_too() -> None:
    block = ScriptedBlock(Acknowledgement("ReadCompensation", Outcome.NOT_NOW))
    with pytest.raises(CommandError, match="not now"):
        CommandChannel(block).execute(ReadCompensation())


def test_a_line_that_comes_back_between_tries_is_used() -> None:
    block = ScriptedBlock(LinkError("scripted: cannot send."), DONE)
    assert CommandChannel(block).execute(Start()) == DONE


def test_a_line_that_stays_down_is_named() -> None:
    block = ScriptedBlock(*[LinkError("scripted: cannot send.")] * 3)
    with pytest.raises(CommandError, match="cannot send in 3 tries"):
        CommandChannel(block).execute(Start())


def test_what_does_not_fit_the_protocol_is_never_sent() -> None:
    block = ScriptedBlock()
    with pytest.raises(CommandError, match="does not fit"):
        CommandChannel(block).execute(SetRate(-5.0))
    assert block.heard == []


def test_numbers_differ_from_command_to_command_and_skip_zero() -> None:
    block = ScriptedBlock(DONE, DONE, DONE)
    channel = CommandChannel(block, first_number=2**32 - 2)
    for _ in range(3):
        channel.execute(Start())
    assert [received.sequence for received in block.heard] == [2**32 - 1, 1, 2]


def test_a_pump_reads_the_line_while_waiting_and_a_closed_channel_listens_no_more() -> None:
    block = ScriptedBlock()
    channel = CommandChannel(
        block, pump=lambda _: [put(Received(DONE, block.heard[-1].sequence, 0, 0)) for put in block.on_message]
    )
    assert channel.execute(Start()) == DONE
    channel.close()
    assert block.on_message == []
