"""``inertrim align``: where a block points, by its own sensors."""

from __future__ import annotations

from typing import Annotated

import typer

from service.commands.options import (
    AlignmentOption,
    EndOption,
    JsonOption,
    RecordingArgument,
    StartOption,
    check_span,
    check_targets,
    write_json,
)


def align(
    recording: RecordingArgument,
    alignment: AlignmentOption = None,
    start: StartOption = None,
    end: EndOption = None,
    gyro_bias: Annotated[
        float, typer.Option("--gyro-bias", metavar="DEG_H", min=0.0, help="1σ believed of the gyros' bias [deg/h].")
    ] = 3.0,
    accel_bias: Annotated[
        float, typer.Option("--accel-bias", metavar="MG", min=0.0, help="1σ believed of the accelerometers' [mg].")
    ] = 1.0,
    json: JsonOption = None,
) -> None:
    """Level and find north from a recording, whatever azimuth and level it gives.

    Where no way is named: by averages if the block stands still in the span, else in an inertial frame.
    """
    check_span(start, end)
    check_targets(json)
    from drivers.recording import read_recording
    from service.align import DEG_H_RADPS, MG_MPS2, align_recording
    from service.tables import show_facts

    facts = align_recording(
        read_recording(recording),
        alignment=alignment and alignment.value,
        start_s=start,
        end_s=end,
        gyro_bias_sigma_radps=gyro_bias * DEG_H_RADPS,
        accel_bias_sigma_mps2=accel_bias * MG_MPS2,
    )
    write_json(json, facts)
    if str(json) != "-":
        show_facts("Attitude found from the sensors", facts)
