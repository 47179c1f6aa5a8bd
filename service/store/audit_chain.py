"""The audit log's chain: every entry's hash covers the entry and the hash before it (docs/security.md)."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

GENESIS = "0" * 64
"""Stands before the first entry."""
COVERED = ("launcher", "utc", "who", "command", "run_id", "outcome", "detail")


@dataclass(frozen=True)
class Head:
    """Where a chain ends: how many entries, and the last one's hash."""

    entries: int
    sha256: str


@dataclass(frozen=True)
class Verification:
    """What checking one launcher's chain found; ``witnessed``: entries that a file or person outside vouches for."""

    launcher: str
    head: Head
    witnessed: int
    faults: tuple[str, ...]


def link(previous: str, number: int, entry: Mapping[str, Any]) -> str:
    """Return the hash of the entry that follows ``previous``."""
    covered = [previous, number, *(entry[name] for name in COVERED)]
    return hashlib.sha256(json.dumps(covered, ensure_ascii=False, separators=(",", ":")).encode()).hexdigest()


def verify(
    launcher: str, entries: Iterable[Mapping[str, Any]], head: Head | None, witnesses: Mapping[int, str]
) -> Verification:
    """Check one launcher's entries, in the order of their numbers.

    Parameters
    ----------
    launcher
        Whose log it is.
    entries
        Rows of the log.
    head
        What the store says the chain ends with.
    witnesses
        Hashes by entry number that were noted outside the store.

    Notes
    -----
    An edit breaks the entry's own hash, a deletion or insertion the numbers. A tail that is cut off shows against the
    head; one that is cut off together with the head, or a chain made anew from some entry on, shows against witnesses
    alone.
    """
    faults: list[str] = []
    seen: dict[int, str] = {}
    previous, number = GENESIS, 0
    for row in entries:
        number += 1
        if row["number"] != number:
            faults.append(f"entry {number} is missing: entry {row['number']} follows entry {number - 1}")
            number = row["number"]
        elif link(previous, number, row) != row["sha256"]:
            faults.append(f"entry {number} ({row['utc']}, {row['command']} by {row['who']}) is not what was written")
        previous = seen[number] = row["sha256"]
    if head is not None and head != Head(number, previous):
        faults.append(f"the log ends with entry {number}, where entry {head.entries} was the last one written")
    elif head is None and number:
        faults.append("the store does not say where the log ends")
    for noted, digest in sorted(witnesses.items()):
        if seen.get(noted) != digest:
            faults.append(f"entry {noted} {'is gone' if noted not in seen else 'differs'} from what was noted outside")
    return Verification(launcher, Head(number, previous), len(witnesses), tuple(faults))
