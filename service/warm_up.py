"""Compiles and imports all that a run needs, so that nothing stalls the reading of the line later."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from drivers.recording import Recording, write_recording
from drivers.recording_meta import BlockMeta, RecordingMeta, ReferenceMeta, SiteMeta, WindowMeta
from drivers.samples import empty_samples
from service.compensate import compensate
from service.motion_watch import MotionWatch
from service.report import render

RATE_HZ = 20.0
SPANS_S = {"align": 10.0, "stage_1": 20.0, "stage_2": 20.0, "stage_3": 20.0, "verify": 20.0}


@cache
def warm_up() -> None:
    """Take a made-up block through estimation, report and stillness, once a process; what comes out is thrown away."""
    windows, end_s = [], 1.0
    for kind, length_s in SPANS_S.items():
        windows.append(WindowMeta.model_validate({"kind": kind, "start_s": end_s, "end_s": end_s + length_s}))
        end_s += length_s
    samples = empty_samples(int((end_s + 1.0) * RATE_HZ))
    samples["sequence"] = np.arange(1, len(samples) + 1)
    samples["time"] = samples["sequence"] / RATE_HZ
    random = np.random.default_rng(0)
    samples["dv"] = np.array([0.0, 0.0, 9.8]) / RATE_HZ + random.normal(0.0, 1e-5, (len(samples), 3))
    samples["dtheta"] = random.normal(0.0, 1e-7, (len(samples), 3))
    MotionWatch().feed(samples)
    meta = RecordingMeta(
        site=SiteMeta(latitude_deg=45.0),
        reference=ReferenceMeta(azimuth_deg=0.0),
        block=BlockMeta(sample_rate_hz=RATE_HZ),
        window=windows,
    )
    with tempfile.TemporaryDirectory(prefix="inertrim-") as folder:
        path = write_recording(Path(folder) / "warm-up", samples, meta)
        recording = Recording(samples, meta, path, path.with_suffix(".toml"))
        render(compensate(recording))
