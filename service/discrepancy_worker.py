"""Process of one job of :mod:`service.discrepancies`: ``python -m service.discrepancy_worker MODEL OUT RECORDING…``.

Tells each step as a line of JSON on standard output, at last the verdict and the new model's SHA-256, or the error.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from service.subordinate import subordinate

NICENESS = 10
"""It has hours: everything else goes before."""


def main(model: str, out: str, *recordings: str) -> int:
    """Run the workflow; return 0, or 2 where a recording or the model was refused."""
    subordinate(NICENESS)
    from drivers.recording import RecordingError
    from inertial.documents import DocumentError
    from simulators.discrepancy.compare import read_to_compare
    from simulators.discrepancy.report import discrepancy
    from simulators.effects.base import EffectError
    from simulators.errors import ScenarioError
    from simulators.model_store import load_model

    try:
        believed = load_model(Path(model))
        read = [read_to_compare(path) for path in recordings]
        report = discrepancy(read, believed, Path(out), lambda share, text: _tell(share=share, text=text))
    except (RecordingError, ScenarioError, EffectError, DocumentError, OSError) as error:
        _tell(error=str(error))
        return 2
    _tell(verdict=report.verdict, found=report.document["model"]["sha256"])
    return 0


def _tell(**facts: Any) -> None:
    print(json.dumps(facts), flush=True)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
