"""What vouches for the audit log outside the store: a file beside it that only grows."""

from __future__ import annotations

from pathlib import Path

import structlog

log = structlog.get_logger()


class Witness:
    """Notes every entry's number and hash where a change of the store does not reach.

    Parameters
    ----------
    path
        One line an entry; None: there is none (a store that lies on another machine).
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path

    def note(self, launcher: str, number: int, sha256: str) -> None:
        """Note one entry; a disk that does not take it is told of and stops nothing."""
        if self._path is None:
            return
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(f"{number} {sha256} {launcher}\n")
        except OSError as error:
            log.error("audit witness", path=str(self._path), error=str(error))

    def read(self, launcher: str) -> dict[int, str]:
        """Return the hashes noted of one launcher by entry number; nothing where there is no file."""
        if self._path is None or not self._path.exists():
            return {}
        lines = (line.split(" ", 2) for line in self._path.read_text(encoding="utf-8").splitlines())
        whole = (parts for parts in lines if len(parts) == 3 and parts[0].isdigit())
        return {int(number): digest for number, digest, name in whole if name == launcher}
