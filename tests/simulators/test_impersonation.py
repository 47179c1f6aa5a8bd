"""The simulated block speaks other makers' protocols: a host that reads them gets the samples that were made."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.messages import Configuration, Identity
from drivers.protocols import get_protocol, protocol_names
from drivers.protocols.base import ProtocolError
from drivers.samples import SampleArray, Status, intervals_s
from drivers.stream import Batch, StreamDecoder
from simulators.device import Device, DeviceError, TermMemory
from simulators.scenarios import Scenario, demo_model, demo_scenario, make_block

RATES_HZ = {"stim300": 500.0, "hg4930": 100.0, "kvh1750": 500.0}
RANGE_G = 10


def scenario_at(rate_hz: float) -> Scenario:
    """Return the demo's scenario at another rate."""
    scenario = demo_scenario(1)
    return scenario.model_copy(
        update={"block": scenario.block.model_copy(update={"sample_rate_hz": rate_hz}), "fault": []}
    )


def heard(name: str, rate_hz: float, seconds: float = 4.0, **options: object) -> Batch:
    """Return what a host decodes of the first seconds after power-up."""
    protocol = get_protocol(name, **options)
    device = Device(scenario_at(rate_hz), demo_model(1), protocol, bit_rate=1_000_000, memory=TermMemory(), now_s=0.0)
    decoder = StreamDecoder(get_protocol(name, **options), 1e9)
    for turn in range(round(seconds * 200)):
        now_s = turn / 200
        for outgoing in device.advance(now_s):
            decoder.feed(outgoing.data, now_s)
    decoder.finish()
    return decoder.take()


def made(rate_hz: float, seconds: float) -> SampleArray:
    """Return the samples of the same block, apart from any frame."""
    return make_block(scenario_at(rate_hz), demo_model(1), power_cycle=0).generate(round(seconds * rate_hz))


@pytest.mark.parametrize("name", [name for name in protocol_names() if name not in ("native", "novatel")])
def test_a_block_without_commands_streams_from_power_up_what_it_senses(name: str) -> None:
    rate_hz = RATES_HZ.get(name, 100.0)
    batch = heard(name, rate_hz)
    truth = made(rate_hz, 4.0)
    samples = batch.samples[1:]
    same = truth[samples["sequence"] - batch.samples["sequence"][0]]
    assert len(samples) == pytest.approx(3.7 * rate_hz, abs=6)
    assert (batch.gaps, batch.restarts) == ([], [])
    assert np.abs(intervals_s(samples) * rate_hz - 1).max() < 2e-3
    ready = (same["status"] & Status.START_UP) == 0
    assert np.abs(samples["dv"] - same["dv"])[ready].max() < 2e-3 * 9.8 / rate_hz + 1e-5
    assert np.abs(samples["dtheta"] - same["dtheta"])[ready].max() < 2e-6


def test_a_simulated_stim300_says_how_it_is_set_before_it_streams() -> None:
    batch = heard("stim300", 500.0, 1.5, accel_range_g=RANGE_G)
    identity, configuration = [received.message for received in batch.messages]
    assert isinstance(identity, Identity)
    assert isinstance(configuration, Configuration)
    assert configuration.sample_rate_hz == 500.0
    assert configuration.accel_range_mps2 == pytest.approx(RANGE_G * 9.80665)
    starting = (batch.samples["status"] & Status.START_UP) != 0
    assert starting[0]
    assert starting.sum() == pytest.approx(0.7 * 500, abs=2)


def test_a_simulated_stim300_answers_in_the_place_of_a_datagram() -> None:
    """Asked 2 s into its stream, in two pieces, by a host that opens the line late and believes in another range."""
    sender, reader = get_protocol("stim300", accel_range_g=RANGE_G), get_protocol("stim300", accel_range_g=80)
    device = Device(scenario_at(500.0), demo_model(1), sender, bit_rate=921_600, memory=TermMemory(), now_s=0.0)
    decoder = StreamDecoder(reader, 1e9)
    for turn in range(800):
        now_s = turn / 200
        outgoing = device.advance(now_s)
        if now_s == 2.0:
            device.receive(b"C\rI", now_s)
            device.receive(b"\rSERVICEMODE", now_s)
        for one in outgoing if now_s > 1.9 else []:
            decoder.feed(one.data, now_s)
    decoder.finish()
    batch = decoder.take()
    configuration, identity = [received.message for received in batch.messages]
    assert isinstance(configuration, Configuration)
    assert isinstance(identity, Identity)
    assert sum(gap.frames for gap in batch.gaps) == 2
    at_rest = np.linalg.norm(batch.samples["dv"][-100:].mean(axis=0)) * 500.0
    assert at_rest == pytest.approx(9.8, abs=0.1)


def test_what_cannot_be_impersonated_is_refused_before_anything_is_sent() -> None:
    protocol = get_protocol("stim300")
    with pytest.raises(DeviceError, match="do not fit"):
        Device(scenario_at(2000.0), demo_model(1), protocol, bit_rate=115200, memory=TermMemory(), now_s=0.0)
    with pytest.raises(ProtocolError, match="not at 200 Hz"):
        Device(scenario_at(200.0), demo_model(1), protocol, bit_rate=921600, memory=TermMemory(), now_s=0.0)
