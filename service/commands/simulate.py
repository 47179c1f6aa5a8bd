"""``inertrim simulate``: a simulated block on a pseudo-terminal, or a recording of one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.commands.options import (
    EpochOption,
    OptionOption,
    ProtocolOption,
    SpeedOption,
    check_targets,
    protocol_of,
)
from service.errors import RefusedInput

if TYPE_CHECKING:
    from drivers.protocols.base import Protocol
    from inertial.documents import BlockModel
    from simulators.scenarios import Scenario


def simulate(
    pty: Annotated[
        Path | None, typer.Option("--pty", metavar="PATH", help="Stream frames on a pty and link it to this path.")
    ] = None,
    tcp: Annotated[
        int | None,
        typer.Option("--tcp", metavar="PORT", min=1, max=65535, help="Stream frames to socket://127.0.0.1:PORT."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="NAME", help="Write a recording, NAME.parquet and NAME.toml.")
    ] = None,
    scenario: Annotated[
        Path | None,
        typer.Option("--scenario", metavar="FILE", help="Site, reference, motion, effects, faults (TOML)."),
    ] = None,
    model: Annotated[Path | None, typer.Option("--model", metavar="FILE", help="Block model (block.json).")] = None,
    protocol: ProtocolOption = "native",
    option: OptionOption = None,
    seed: Annotated[int | None, typer.Option("--seed", metavar="N", min=0, help="Seed of the noise.")] = None,
    speed: SpeedOption = 1.0,
    epoch: EpochOption = None,
    ledger: Annotated[
        Path | None, typer.Option("--ledger", metavar="FILE", help="Write what the line lost here at the end (JSON).")
    ] = None,
    control: Annotated[
        bool, typer.Option("--control", help="Read faults from standard input, one JSON object a line.")
    ] = False,
) -> None:
    """Simulate a block: stream its frames on a pseudo-terminal or a TCP port, or write a recording.

    Without a scenario it is the demo's, at a sample rate that the protocol's devices have; without a model the one that
    the scenario names, else an ideal block.
    """
    if sum(one is not None for one in (pty, tcp, out)) != 1:
        remedy = "--pty and --tcp stream frames, --out writes a recording."
        raise RefusedInput("simulate", "give one of --pty, --tcp and --out.", remedy)
    check_targets(out, pty, ledger)
    from simulators.errors import ScenarioError

    plan, block = _plan(scenario, model, seed)
    spoken = protocol_of(protocol, option)
    if scenario is None and spoken.rates_hz:
        rate_hz = min(spoken.rates_hz, key=lambda one: abs(one - plan.block.sample_rate_hz))
        plan = plan.model_copy(update={"block": plan.block.model_copy(update={"sample_rate_hz": rate_hz})})
    try:
        if out is not None:
            _write(plan, block, out)
        else:
            _stream(plan, block, pty, tcp, spoken, speed, epoch, ledger, control)
    except ScenarioError as error:
        place = " with ".join(str(path) for path in (scenario, model) if path is not None) or "simulate"
        raise RefusedInput(place, f"{error}.", "Correct the scenario or the model.") from None


def _plan(scenario: Path | None, model: Path | None, seed: int | None) -> tuple[Scenario, BlockModel]:
    from service.commands.demo import DEFAULT_SEED
    from simulators.model_store import ideal_model, load_model
    from simulators.scenarios import demo_model, demo_scenario, read_scenario

    if scenario is None:
        number = DEFAULT_SEED if seed is None else seed
        return demo_scenario(number), load_model(model) if model is not None else demo_model(number)
    plan = read_scenario(scenario)
    if seed is not None:
        plan = plan.with_seed(seed)
    if model is not None:
        return plan, load_model(model)
    if plan.block.model is not None:
        return plan, load_model(scenario.parent / plan.block.model)
    return plan, ideal_model(plan.block.gyro_kind or "dtg")


def _write(plan: Scenario, block: BlockModel, out: Path) -> None:
    from simulators.simulate import simulate_recording

    name = out.name.removesuffix(".parquet").removesuffix(".toml")
    # Each recording has its own calibration beside it: others in the folder keep theirs. A simulated recording stands
    # for a real one, so it does not name the model it was made with.
    about = plan.block.model_copy(update={"calibration": f"{name}-calibration.json", "model": None})
    path = simulate_recording(plan.model_copy(update={"block": about}), out.with_name(name), model=block)
    typer.echo(f"{path}: {plan.duration_s:g} s at {plan.block.sample_rate_hz:g} Hz")


def _stream(
    plan: Scenario,
    block: BlockModel,
    pty: Path | None,
    tcp: int | None,
    protocol: Protocol,
    speed: float,
    epoch: float | None,
    ledger: Path | None,
    control: bool,
) -> None:
    import json
    import signal
    import sys
    import threading

    from drivers.timebase import Timebase
    from simulators.simulate import run_on_line

    def report(event: dict[str, Any]) -> None:
        print(json.dumps(event), flush=True)

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    run_on_line(
        plan,
        block,
        path=pty,
        tcp_port=tcp,
        timebase=Timebase(speed, epoch),
        stop=stop,
        protocol=protocol,
        ledger=ledger,
        control=sys.stdin.fileno() if control else None,
        report=report,
    )
