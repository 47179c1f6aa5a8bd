"""What every process does that the service starts beside its own: it gives way, and does not outlive the service."""

from __future__ import annotations

import os
import signal
import threading
from contextlib import suppress
from pathlib import Path

OOM_SCORE = "500"
"""Of 1000: a kernel short of memory takes this process, which is started anew, before the one that reads the line."""


def subordinate(niceness: int) -> None:
    """Give way to the service that started this process, and end as soon as it is gone, however it went.

    Parameters
    ----------
    niceness
        Added to the service's own, so that the line is read first: 5 leaves a third of a processor that two ask for, 10
        a tenth.

    Notes
    -----
    Standard input must be a pipe that the service alone holds and never writes to: the system closes it with the
    service, also where that was killed and could tell nobody.
    """
    with suppress(OSError):  # where the host forbids it, the work is done all the same
        os.nice(niceness)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(OOM_SCORE)
    # Ctrl-C and a service manager mean the service, which ends what it started once it has finished its work.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with_service, name="subordinate", daemon=True).start()


def _end_with_service() -> None:
    while os.read(0, 1):
        pass
    os._exit(1)  # at once: nobody waits for what the other threads are at
