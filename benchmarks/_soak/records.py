"""What the service has confirmed, and must therefore still have: runs, changes of state, results, audit, recordings."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.capture_parts import parts
from drivers.recording import RecordingError, read_recording
from service.store import Store

Change = tuple[str, str, str, str]


@dataclass
class Records:
    """Everything that the service has told since the beginning, and what it was later found to have lost."""

    changes: dict[str, list[Change]] = field(default_factory=dict)
    results: dict[str, str] = field(default_factory=dict)
    commands: list[tuple[str, str]] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)

    def begun(self, run_id: str) -> None:
        """Note that a run was accepted."""
        self.changes.setdefault(run_id, [])

    def accepted(self, command: str, run_id: str) -> None:
        """Note that a command was accepted."""
        self.commands.append((command, run_id))

    def told(self, run_id: str, detail: dict[str, Any]) -> None:
        """Compare what is told of a run now with what was told before: it may only grow."""
        now = [(one["utc"], one["source"], one["target"], one["reason"]) for one in detail["transitions"]]
        before = self.changes.setdefault(run_id, [])
        if now[: len(before)] != before:
            self.lost.append(f"run {run_id}: {len(before)} changes of state were told, now {len(now)} others")
        self.changes[run_id] = now

    def result(self, run_id: str, document: bytes) -> None:
        """Note a result; one that was told before must be the same."""
        digest = hashlib.sha256(document).hexdigest()
        if self.results.setdefault(run_id, digest) != digest:
            self.lost.append(f"run {run_id}: its result changed")

    def check(self, store_path: Path, unwritable: set[str]) -> dict[str, int]:
        """Compare everything with the store and the run folders, after the service has ended.

        Parameters
        ----------
        store_path : file of the store.
        unwritable : runs during which the disk took nothing; they may lack files.

        Returns
        -------
        How many runs, changes, results, commands and recordings were found whole.
        """
        store = Store(store_path)
        try:
            found = self._check_store(store)
        finally:
            store.close()
        folder = store_path.with_name(store_path.stem + "-runs")
        found["recordings"] = sum(self._whole(folder / run_id, run_id, unwritable) for run_id in self.changes)
        return found

    def _check_store(self, store: Store) -> dict[str, int]:
        changes = 0
        for run_id, told in self.changes.items():
            run = store.run(run_id)
            if run is None:
                self.lost.append(f"run {run_id} is not in the store")
                continue
            kept = [(one["utc"], one["source"], one["target"], one["reason"]) for one in run.transitions]
            if kept[: len(told)] != told:
                self.lost.append(f"run {run_id}: changes of state that were told are not in the store")
            if run.ended_utc is None and run.state not in ("READY", "HOLD"):
                self.lost.append(f"run {run_id} stands open in {run.state}")
            changes += len(kept)
        for run_id, digest in self.results.items():
            document = store.result(run_id)
            if document is None or hashlib.sha256(document.encode()).hexdigest() != digest:
                self.lost.append(f"run {run_id}: its result is not in the store as it was told")
        entries = [
            (one["command"], one["run_id"]) for one in store.audit_log(1_000_000) if one["outcome"] == "accepted"
        ]
        for command in set(self.commands):
            if entries.count(command) < self.commands.count(command):
                self.lost.append(f"audit: {command[0]} of run {command[1]} is missing")
        return {
            "runs": len(self.changes),
            "changes": changes,
            "results": len(self.results),
            "commands": len(self.commands),
        }

    def _whole(self, folder: Path, run_id: str, unwritable: set[str]) -> bool:
        """Whether a run that had samples has a recording that can be read."""
        if not any(target == "SELF_TEST" for _, _, target, _ in self.changes[run_id]):
            return False  # it never had samples
        try:
            return len(read_recording(folder / "recording").samples) > 0
        except RecordingError as error:
            if run_id not in unwritable and parts(folder / "capture.raw"):
                self.lost.append(f"run {run_id}: {error}")
            return False
