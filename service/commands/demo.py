"""``inertrim demo``: the whole chain on simulated time, for a newcomer to watch."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.commands.options import JsonOption, check_targets, write_json

DEFAULT_SEED = 4
DEFAULT_SPEED = 22.0
"""Simulated seconds per real second: a pty then holds 0.15 s of the frames, for which a busy machine may be away."""


def demo(
    json: JsonOption = None,
    seed: Annotated[
        int, typer.Option("--seed", metavar="N", min=0, help="Draws shifts, reference errors and noise.")
    ] = DEFAULT_SEED,
    realtime: Annotated[bool, typer.Option("--realtime", help="Run at speed 1 (about nine minutes).")] = False,
    speed: Annotated[
        float, typer.Option("--speed", metavar="X", min=0.1, max=100.0, help="Simulated seconds per real second.")
    ] = DEFAULT_SPEED,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for what the demo leaves.")] = Path(
        "demo-out"
    ),
) -> None:
    """Run the main job end to end: simulated block, real line, real service, driven over HTTP.

    Exit code 0: READY; 1: any other end.
    """
    from service.demo import run_demo
    from service.demo_view import DemoView

    out.mkdir(parents=True, exist_ok=True)
    check_targets(json)
    with DemoView() as view:
        facts = run_demo(out, seed, 1.0 if realtime else speed, view.show)
    write_json(json, facts)
    view.conclude(facts)
    raise typer.Exit(0 if facts["state"] == "READY" else 1)
