"""What one run leaves on disk: raw capture, recording, result and report, each whole or not at all."""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drivers.recording import Recording, RecordingMeta, write_recording
from drivers.recording_meta import BlockMeta, ReferenceMeta, SiteMeta, TurnMeta, WindowMeta
from drivers.samples import SampleArray
from inertial.documents import WindowRecord
from service.config import BlockSettings, ReferenceSettings, SiteSettings
from service.orders import MeasuredTurn


class RunFolder:
    """Folder of one run under the store's folder of runs."""

    def __init__(self, runs: Path, run_id: str) -> None:
        self.path = runs / run_id

    @property
    def run_id(self) -> str:
        """The run whose folder it is."""
        return self.path.name

    @property
    def capture(self) -> Path:
        """Raw bytes off the line with their arrival times."""
        return self.path / "capture.raw"

    @property
    def recording(self) -> Path:
        """Samples of the run, with ``recording.toml`` beside it."""
        return self.path / "recording.parquet"

    @property
    def result(self) -> Path:
        """The result document."""
        return self.path / "result.json"

    @property
    def report(self) -> Path:
        """The report page."""
        return self.path / "report.html"

    def make(self, block: BlockSettings) -> None:
        """Make the folder and put beside the data what the block was configured with."""
        self.path.mkdir(parents=True, exist_ok=True)
        for source, name in ((block.calibration, "calibration.json"), (block.model, "block.json")):
            if source is not None:
                shutil.copyfile(source, self.path / name)

    def write_recording(self, samples: SampleArray, meta: RecordingMeta) -> Recording:
        """Write the recording and return it as it stands in memory, equal to what reading it gives."""
        path = write_recording(self.recording, samples, meta)
        return Recording(samples=samples, meta=meta, path=path, meta_path=path.with_suffix(".toml"))


def write_whole(path: Path, text: str) -> None:
    """Write a file whole or not at all, and have it on disk before returning."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    with part.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)


def recording_meta(
    site: SiteSettings | None,
    block: BlockSettings,
    reference: ReferenceSettings,
    samples: SampleArray,
    windows: Sequence[WindowRecord] = (),
    turns: Sequence[MeasuredTurn] = (),
) -> RecordingMeta:
    """Return what is known of a run's samples, in the recording's own terms."""
    return RecordingMeta(
        site=_site(site),
        reference=ReferenceMeta(**reference.model_dump(exclude_none=True)),
        block=BlockMeta(
            sample_rate_hz=block.sample_rate_hz or measured_rate_hz(samples),
            model="block.json" if block.model is not None else None,
            calibration="calibration.json" if block.calibration is not None else None,
            gyro_kind=block.gyro_kind,
        ),
        motion=[_turn(turn) for turn in turns],
        window=[WindowMeta(kind=one.kind, start_s=one.start_s, end_s=one.end_s) for one in windows],
    )


def measured_rate_hz(samples: SampleArray) -> float:
    """Rate by the block's own clock, the median so that gaps do not count."""
    return float(1 / np.median(np.diff(samples["time"])))


def _turn(turn: MeasuredTurn) -> TurnMeta:
    """Return a measured turn as a recording describes one: about one body axis at an even rate."""
    angle_rad = float(np.linalg.norm(turn.rotation_rad))
    return TurnMeta(
        kind="turn",
        start_s=turn.start_s,
        end_s=turn.end_s,
        rate_dps=math.degrees(angle_rad) / (turn.end_s - turn.start_s),
        axis=(turn.rotation_rad / angle_rad).tolist(),
        frame="body",
    )


def _site(site: SiteSettings | None) -> SiteMeta:
    return SiteMeta() if site is None else SiteMeta(**site.model_dump())
