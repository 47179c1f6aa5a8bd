"""``inertrim capture``: raw bytes of a line into a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.commands.options import EpochOption, ProtocolOption, SpeedOption


def capture(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Capture to append to.")],
    link: Annotated[str, typer.Option("--link", metavar="URL", help="Line: /dev/ttyUSB0, socket://host:port …")],
    protocol: ProtocolOption = "native",
    bit_rate: Annotated[int, typer.Option("--bit-rate", metavar="B", min=300, help="Of the line [bit/s].")] = 921_600,
    duration: Annotated[
        float | None, typer.Option("--duration", metavar="S", min=0.1, help="Stop after this long; else at Ctrl-C.")
    ] = None,
    speed: SpeedOption = 1.0,
    epoch: EpochOption = None,
) -> None:
    """Store what a line says as it comes, with time stamps, before anything is decoded.

    Exit code 0: the block was heard; 1: not one sample came.
    """
    import contextlib

    from drivers.capture import CaptureWriter
    from drivers.link import SerialLink
    from drivers.protocols import get_protocol
    from drivers.timebase import Timebase

    timebase = Timebase(speed, epoch)
    writer = CaptureWriter(file)
    line = SerialLink(link, get_protocol(protocol), bit_rate=bit_rate, timebase=timebase, capture=writer)
    end_s = float("inf") if duration is None else timebase.now_s() + duration
    state = ""
    try:
        with line, contextlib.suppress(KeyboardInterrupt):
            while timebase.now_s() < end_s:
                line.read(0.1)
                if line.state != state:
                    state = line.state
                    typer.echo(f"{timebase.now_s():10.2f} s  {state}: {line.reason}")
    finally:
        writer.close()
    typer.echo(f"{file}: {line.counters.samples} samples heard")
    raise typer.Exit(0 if line.counters.samples else 1)
