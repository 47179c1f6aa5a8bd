"""``inertrim calibrate``: the coefficients of (1), (2) from a turntable, or by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from service.commands.options import JsonOption, check_targets, write_json, write_text
from service.errors import RefusedInput


def calibrate(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING…", help="Table runs, or one recording turned by hand.")
    ],
    by_table: Annotated[
        bool | None,
        typer.Option("--turntable/--by-hand", help="How they were made; else as their [[motion]] tells."),
    ] = None,
    mounting: Annotated[
        list[str] | None,
        typer.Option(
            "--mounting",
            metavar="GYRO:ACCEL,…",
            help="g-sensitivity to find, e.g. gyro_x:accel_x,accel_y; else two DTGs where gyro_kind is dtg.",
        ),
    ] = None,
    plan: Annotated[
        bool, typer.Option("--plan", help="Propose a table run for RECORDING's TOML instead, with its conditioning.")
    ] = False,
    steps: Annotated[int, typer.Option("--steps", metavar="N", min=2, help="Of a plan: positions and turns.")] = 40,
    rest: Annotated[
        float, typer.Option("--rest", metavar="S", min=4.0, help="Of a plan: length of a rest [s].")
    ] = 30.0,
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="Write calibration.json here.")] = None,
    json: JsonOption = None,
) -> None:
    """Calibrate: on a two-axis turntable whose turns [[motion]] describes, or laid down by hand in many attitudes.

    Exit code 0: the residuals are what noise explains; 1: they are not; 2: the input was refused.
    """
    check_targets(out, json)
    answers = _mounting(mounting)
    if plan:
        _plan(recordings, steps, rest, answers, out, json)
        return
    from drivers.recording import read_recording
    from inertial.calibration import calibration_report
    from inertial.documents import Calibration
    from service.calibrate import Way, calibrate_recordings, calibration_facts

    asked: Way | None = None if by_table is None else "turntable" if by_table else "by hand"
    read = [read_recording(path) for path in recordings]
    result, way = calibrate_recordings(read, asked, answers)
    facts = calibration_facts(result, way, read)
    if out is not None:
        write_text(out, Calibration.model_validate(facts["calibration"]).canonical_json())
    write_json(json, facts)
    if str(json) != "-":
        typer.echo(calibration_report(result), nl=False)
        _show_raw(facts["raw"])
    raise typer.Exit(0 if result.chi_square_probability > 0.001 else 1)


def _plan(
    recordings: list[Path],
    steps: int,
    rest: float,
    mounting: dict[str, tuple[str, ...]] | None,
    out: Path | None,
    json: Path | None,
) -> None:
    """Write the turns proposed as the TOML of a recording to be made, and show what they will tell."""
    from drivers.recording_meta import RecordingMeta, meta_text, read_meta
    from service.calibrate import plan_facts, plan_for
    from service.tables import show_plan

    if len(recordings) != 1:
        raise RefusedInput("--plan", "one TOML tells site, reference and block.", "Name one.")
    meta = read_meta(recordings[0].with_suffix(".toml"))
    facts = plan_facts(plan_for(meta, steps, rest, mounting))
    if out is not None:
        planned = RecordingMeta.model_validate({**meta.model_dump(), "motion": facts["motion"], "window": []})
        write_text(out, meta_text(planned))
    write_json(json, facts)
    if str(json) != "-":
        show_plan(facts)


def _mounting(texts: list[str] | None) -> dict[str, tuple[str, ...]] | None:
    if not texts:
        return None
    found = {}
    for text in texts:
        gyro, colon, accels = text.partition(":")
        if not colon:
            raise RefusedInput("--mounting", f"{text!r} is no mounting.", "Give it as gyro_x:accel_x,accel_y.")
        found[gyro] = tuple(accel for accel in accels.split(",") if accel)
    return found


def _show_raw(raw: dict[str, Any] | None) -> None:
    for kind, found in (raw or {}).items():
        typer.echo(f"{kind} in counts of the log, {found['model']}:")
        for row, scale, bias in zip(found["T"], found["K"], found["b"], strict=True):
            typer.echo(f"  T {row[0]:+.7f} {row[1]:+.7f} {row[2]:+.7f}   K {scale:.9g}   b {bias:.2f}")
