"""``inertrim serve``: the running service."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.commands.options import EpochOption


def serve(
    config: Annotated[Path | None, typer.Option("--config", metavar="FILE", help="Settings (TOML).")] = None,
    link: Annotated[
        str | None, typer.Option("--link", metavar="URL", help="Serial line: /dev/ttyUSB0, socket://host:port …")
    ] = None,
    protocol: Annotated[str | None, typer.Option("--protocol", metavar="P", help="Frame layout, by name.")] = None,
    host: Annotated[str | None, typer.Option("--host", metavar="H", help="Address to listen on.")] = None,
    port: Annotated[
        int | None, typer.Option("--port", metavar="N", min=0, max=65535, help="Port to listen on.")
    ] = None,
    speed: Annotated[
        float | None, typer.Option("--speed", metavar="X", min=0.01, max=1000.0, help="Simulated s per real second.")
    ] = None,
    epoch: EpochOption = None,
) -> None:
    """Run the service: read the block, sequence the runs, answer the console over HTTP.

    Without configuration it starts OFFLINE on loopback with its store in ./inertrim.db.
    """
    from service.config import load_settings

    settings = load_settings(
        config,
        link={"url": link, "protocol": protocol},
        http={"host": host, "port": port},
        time={"speed": speed, "epoch_s": epoch},
    )
    from service.main import run_service  # takes seconds to load: settings that cannot be used are refused before

    run_service(settings)
