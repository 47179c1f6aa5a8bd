"""``inertrim capture``: raw bytes of a line into a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.commands.options import (
    BitRateOption,
    EpochOption,
    OptionOption,
    ProtocolOption,
    SpeedOption,
    check_targets,
    protocol_of,
)


def capture(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Capture to append to.")],
    link: Annotated[str, typer.Option("--link", metavar="URL", help="Line: /dev/ttyUSB0, socket://host:port …")],
    protocol: ProtocolOption = "native",
    option: OptionOption = None,
    bit_rate: BitRateOption = 921_600,
    duration: Annotated[
        float | None, typer.Option("--duration", metavar="S", min=0.1, help="Stop after this long; else at Ctrl-C.")
    ] = None,
    part_mb: Annotated[
        float, typer.Option("--part-mb", metavar="M", min=0.001, help="Go on in another part at this size [MB].")
    ] = 64.0,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="At the end, convert it as `inertrim convert` does.")
    ] = None,
    speed: SpeedOption = 1.0,
    epoch: EpochOption = None,
) -> None:
    """Store what a line says as it comes, with time stamps, before anything is decoded.

    Parts are compressed once they are closed. Exit code 0: the block was heard; 1: not one sample came.
    """
    import contextlib

    from drivers.capture import CaptureWriter
    from drivers.link import SerialLink
    from drivers.timebase import Timebase

    check_targets(out)
    spoken = protocol_of(protocol, option)
    timebase = Timebase(speed, epoch)
    writer = CaptureWriter(file, protocol=spoken, bit_rate=bit_rate, part_bytes=int(part_mb * 1e6), packed=True)
    line = SerialLink(link, spoken, bit_rate=bit_rate, timebase=timebase, capture=writer)
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
    if out is not None and line.counters.samples:
        from service.replay import read_replay, write_replay

        typer.echo(f"{write_replay(read_replay(file, spoken, bit_rate=bit_rate), out)}: written")
    raise typer.Exit(0 if line.counters.samples else 1)
