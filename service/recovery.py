"""What a killed service left: the raw capture of the interrupted run becomes its recording."""

from __future__ import annotations

import numpy as np
import structlog

from drivers.capture import CaptureError, replay
from drivers.capture_parts import parts
from drivers.protocols import get_protocol
from drivers.recording import RecordingError
from drivers.samples import SampleArray
from service.config import BlockSettings, LinkSettings, ReferenceSettings, SiteSettings
from service.run_folder import RunFolder, recording_meta

log = structlog.get_logger()


def recover(
    folder: RunFolder,
    link: LinkSettings,
    site: SiteSettings | None,
    block: BlockSettings,
    reference: ReferenceSettings,
) -> None:
    """Write the recording of an interrupted run from its capture; a recording that is there already stays."""
    if folder.recording.is_file() and folder.recording.with_suffix(".toml").is_file():
        return
    if not parts(folder.capture):
        return
    try:
        samples = samples_of_capture(folder, link)
        if samples is None or len(samples) < 2:
            log.warning("recovery", run_id=folder.path.name, error="the capture holds no samples")
            return
        folder.write_recording(samples, recording_meta(site, block, reference, samples))
        log.info("recovery", run_id=folder.path.name, samples=len(samples))
    except (CaptureError, RecordingError, OSError, ValueError) as error:
        log.error("recovery", run_id=folder.path.name, error=str(error))


def samples_of_capture(folder: RunFolder, link: LinkSettings) -> SampleArray | None:
    """Return the samples since the block's last restart in a capture, None where there are none."""
    parts: list[SampleArray] = []
    for batch in replay(folder.capture, get_protocol(link.protocol, **link.options), bit_rate=link.bit_rate):
        if batch.restarts:
            parts = []
        parts.append(batch.samples[batch.restarts[-1] if batch.restarts else 0 :])
    parts = [part for part in parts if len(part)]
    return np.concatenate(parts) if parts else None
