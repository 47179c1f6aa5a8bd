"""``inertrim noise``: what a block's sensors do by themselves."""

from __future__ import annotations

from service.commands.options import (
    EndOption,
    JsonOption,
    RecordingArgument,
    StartOption,
    check_span,
    check_targets,
    write_json,
)


def noise(
    recording: RecordingArgument, start: StartOption = None, end: EndOption = None, json: JsonOption = None
) -> None:
    """Identify quantisation, random walks, bias instability and ramp of all six sensors from a recording at rest."""
    check_span(start, end)
    check_targets(json)
    from drivers.recording import read_recording
    from service.noise import noise_of_recording
    from service.tables import show_noise

    facts = noise_of_recording(read_recording(recording), start, end)
    write_json(json, facts)
    if str(json) != "-":
        show_noise(facts)
