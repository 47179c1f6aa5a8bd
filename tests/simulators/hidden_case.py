"""One case of the blind generator: its truth, and the recording and model that the workflow is given of it.

Imported, it puts the benchmarks on the path.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.recording import Recording, read_recording
from inertial.documents import BlockModel, parse_document

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # benchmarks are no installed package
from benchmarks._blind.__main__ import write
from benchmarks._blind.cases import make


@dataclass(frozen=True)
class HiddenCase:
    """What was hidden, and where."""

    truth: dict[str, Any]
    recording: Recording
    model: BlockModel


def hidden_case(seed: int, number: int, folder: Path) -> HiddenCase:
    """Make a case and read it back from the files that the workflow gets."""
    case = make(seed, number)
    write(case, folder)
    model = parse_document(BlockModel, (folder / "block.json").read_text(), "block.json")
    return HiddenCase(case.truth, read_recording(folder / "recording"), model)
