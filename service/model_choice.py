"""Which block model the service believes in: the configured one, or a child of it that an operator adopted since."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from inertial.documents import BlockModel, DocumentError
from service.run_folder import write_whole
from service.store import utc_now
from simulators.model_store import load_model


class ModelChoice:
    """The model in use. An adoption holds over restarts, until another model is configured.

    Parameters
    ----------
    configured
        The settings' model; None: none.
    folder
        Where adopted models are kept, each in the file ``<SHA-256>.json``.
    """

    def __init__(self, configured: Path | None, folder: Path) -> None:
        self._configured, self._folder = configured, folder
        self._note = folder / "adopted.note"

    def path(self) -> Path | None:
        """Return the file of the model in use, or None."""
        try:
            note = json.loads(self._note.read_text())
        except (OSError, ValueError):
            return self._configured
        adopted = self._folder / f"{note['sha256']}.json"
        holds = note["instead_of"] == self._configured_sha256() and adopted.is_file()
        return adopted if holds else self._configured

    def sha256(self) -> str | None:
        """Return the SHA-256 of the model in use, None where there is none."""
        path = self.path()
        return None if path is None else load_model(path).sha256()

    def adopt(self, path: Path, who: str) -> BlockModel:
        """Use the model of a file from now on.

        Raises
        ------
        DocumentError
            It cannot be read, or is no descendant of the model in use.
        """
        model, believed = load_model(path), self.sha256()
        if believed is not None and believed not in (model.parent, model.sha256()):
            raise DocumentError(
                f"{model.sha256()}: its parent is not the model in use ({believed}). Run the workflow with that one."
            )
        self._folder.mkdir(parents=True, exist_ok=True)
        target = self._folder / f"{model.sha256()}.json"
        if path != target:
            shutil.copyfile(path, target)
        note = {"sha256": model.sha256(), "instead_of": self._configured_sha256(), "by": who, "utc": utc_now()}
        write_whole(self._note, json.dumps(note) + "\n")
        return model

    def adopted(self) -> list[Path]:
        """Return the files of all models that were ever adopted."""
        return sorted(self._folder.glob("*.json"))

    def _configured_sha256(self) -> str | None:
        return None if self._configured is None else load_model(self._configured).sha256()
