"""The ``inertrim`` command: one place that turns every failure into one clear line and an exit code.

Exit codes: 0 done, 1 done with a negative verdict, 2 input refused, 70 a fault of the program itself, 130 interrupted.
"""

from __future__ import annotations

import sys
import traceback
from pathlib import Path
from typing import Annotated

import typer

from service.commands import audit, bundle, console, model, store, token
from service.commands.ageing import ageing
from service.commands.align import align
from service.commands.backup import backup, restore
from service.commands.budget import budget
from service.commands.calibrate import calibrate
from service.commands.campaign import campaign
from service.commands.capture import capture
from service.commands.compensate import compensate
from service.commands.convert import convert
from service.commands.demo import demo
from service.commands.detect import detect
from service.commands.discrepancy import discrepancy
from service.commands.experiments import experiments
from service.commands.navigate import navigate
from service.commands.noise import noise
from service.commands.replay import replay
from service.commands.report import report
from service.commands.serve import serve
from service.commands.simulate import simulate

FAILED = 1
REFUSED = 2
PROGRAM_FAULT = 70
USER_ERRORS = (
    ("drivers.recording_meta", "RecordingError"),
    ("drivers.capture", "CaptureError"),
    ("drivers.commands", "CommandError"),
    ("drivers.link", "LinkError"),
    ("drivers.mcap_log", "McapError"),
    ("drivers.protocols.base", "ProtocolError"),
    ("inertial.documents", "DocumentError"),
    ("simulators.errors", "ScenarioError"),
    ("service.config", "ConfigError"),
    ("service.errors", "RefusedInput"),
    ("service.store.errors", "StoreError"),
)
"""What a user's input can raise, by module and name, so that nothing is imported for it."""
FAILURES = (
    ("service.demo", "DemoFailed"),
    ("service.processes", "ProcessFailed"),
    ("service.campaign.engine", "CampaignFailed"),
    ("service.console.client", "ConsoleError"),
)

app = typer.Typer(
    name="inertrim",
    help="Trim a strapdown inertial navigation block on its launcher by gravity and Earth rate, and prove it.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
COMMANDS = (
    *(demo, serve, simulate, capture, replay, convert, detect, discrepancy),
    *(compensate, navigate, budget, align, noise, calibrate, experiments, report),
    *(backup, restore),
    *(ageing, campaign),
)
for command in COMMANDS:
    app.command()(command)
GROUPS = {"model": model, "token": token, "audit": audit, "console": console, "bundle": bundle, "store": store}
for name, group in GROUPS.items():
    app.add_typer(group.app, name=name)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"inertrim {version('inertrim')}")
        raise typer.Exit


@app.callback()
def options(
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an unexpected error.")] = False,
    version: Annotated[
        bool, typer.Option("--version", help="Show the version.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Take what holds for every command."""
    del version
    _wanted["traceback"] = debug


_wanted = {"traceback": False}


def main() -> None:
    """Run the command line; the console script ``inertrim``."""
    try:
        app(prog_name="inertrim")
    except Exception as error:
        sys.exit(explain(error))


def explain(error: Exception) -> int:
    """Print one line about a failure to standard error and return the exit code."""
    if _wanted["traceback"]:
        traceback.print_exception(error)
    if _is(error, USER_ERRORS):
        return _say(str(error), REFUSED)
    if isinstance(error, OSError) and error.filename is not None:
        path = error.filename2 or error.filename
        return _say(f"{path}: {error.strerror}. Check the path and its permissions.", REFUSED)
    if _is(error, FAILURES):
        return _say(str(error), FAILED)
    frame = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{Path(frame.filename).name}:{frame.lineno}"
    return _say(
        f"internal error at {place}: {type(error).__name__}: {error} (run `inertrim --debug …` for the traceback)",
        PROGRAM_FAULT,
    )


def _say(text: str, code: int) -> int:
    print(f"inertrim: {' '.join(text.split())}", file=sys.stderr)
    return code


def _is(error: Exception, kinds: tuple[tuple[str, str], ...]) -> bool:
    """Tell an error's kind by name; a class whose module was never loaded cannot have been raised."""
    loaded = [getattr(sys.modules.get(module), name, None) for module, name in kinds]
    return isinstance(error, tuple(kind for kind in loaded if kind is not None))


if __name__ == "__main__":
    main()
