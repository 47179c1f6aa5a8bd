"""Compiles and imports all that estimation needs, so that no run waits for it."""

from __future__ import annotations

import tempfile
from pathlib import Path

from drivers.recording import Recording, write_recording
from drivers.recording_meta import BlockMeta, RecordingMeta, ReferenceMeta, SiteMeta, WindowMeta
from service.compensate import compensate
from service.made_up_rest import RATE_HZ, made_up_rest
from service.report import render

SPANS_S = {"align": 10.0, "stage_1": 20.0, "stage_2": 20.0, "stage_3": 20.0, "verify": 20.0}


def warm_up() -> None:
    """Take a made-up block through estimation and report; what comes out is thrown away."""
    windows, end_s = [], 1.0
    for kind, length_s in SPANS_S.items():
        windows.append(WindowMeta.model_validate({"kind": kind, "start_s": end_s, "end_s": end_s + length_s}))
        end_s += length_s
    samples = made_up_rest(end_s + 1.0)
    meta = RecordingMeta(
        site=SiteMeta(latitude_deg=45.0),
        reference=ReferenceMeta(azimuth_deg=0.0),
        block=BlockMeta(sample_rate_hz=RATE_HZ),
        window=windows,
    )
    with tempfile.TemporaryDirectory(prefix="inertrim-") as folder:
        path = write_recording(Path(folder) / "warm-up", samples, meta)
        render(compensate(Recording(samples, meta, path, path.with_suffix(".toml"))))
