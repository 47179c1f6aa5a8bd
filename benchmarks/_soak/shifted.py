"""``inertrim`` whose wall clock is off by what a file says: the host's own clock is not ours to set.

``python -m benchmarks._soak.shifted CLOCK serve …``. Only what tells the time of day is off; nothing else is touched.
"""

from __future__ import annotations

import datetime
import faulthandler
import signal
import sys
import time
from pathlib import Path
from typing import Self

LOOK_EVERY_S = 0.2


class _Offset:
    def __init__(self, path: Path) -> None:
        self._path, self._read_s, self._offset_s = path, 0.0, 0.0

    def now_s(self) -> float:
        if time.monotonic() - self._read_s > LOOK_EVERY_S:
            self._read_s, self._offset_s = time.monotonic(), float(self._path.read_text() or 0.0)
        return self._offset_s


def shift(path: Path) -> None:
    """Have ``time.time``, and ``datetime.now`` as the service's modules call it, be off from now on."""
    offset, true_time_s = _Offset(path), time.time

    class Shifted(datetime.datetime):
        @classmethod
        def now(cls, tz: datetime.tzinfo | None = None) -> Self:
            return cls.fromtimestamp(true_time_s() + offset.now_s(), tz)

    time.time = lambda: true_time_s() + offset.now_s()
    for name, module in list(sys.modules.items()):
        # Compiled modules know the layout of the true class: theirs stays.
        if name.partition(".")[0] == "service" and getattr(module, "datetime", None) is datetime.datetime:
            module.datetime = Shifted  # type: ignore[attr-defined]


if __name__ == "__main__":
    import service.main
    from service.cli import main

    del service
    faulthandler.register(signal.SIGUSR1)  # a service that seems stuck is asked where its threads are
    shift(Path(sys.argv.pop(1)))
    main()
