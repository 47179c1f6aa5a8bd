"""Block models on disk: immutable, named by their content, each child naming its parent."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from inertial.documents import BlockModel, DocumentError, Noise, parse_document

GyroKind = Literal["dtg", "laser", "fibre", "mems"]


def ideal_model(gyro_kind: GyroKind = "dtg", noise: Noise | None = None) -> BlockModel:
    """Return a model to start from: reading = truth; without ``noise``, its size is left free."""
    return BlockModel(block="ideal", gyro_kind=gyro_kind, noise=noise or Noise(free=True))


def load_model(path: Path) -> BlockModel:
    """Read a model; one whose name is a SHA-256 must have that content.

    Raises
    ------
    DocumentError
        Not readable, damaged, newer than this program, or not what its name says.
    """
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise DocumentError(f"{path}: cannot be read ({error}). Give a block model, for example block.json.") from None
    model = parse_document(BlockModel, text, str(path))
    if len(path.stem) == 64 and path.stem != model.sha256():
        raise DocumentError(f"{path}: its content is not what its name says. Restore the file from a copy.")
    return model


def save_model(model: BlockModel, path: Path) -> Path:
    """Write a model under a name of its own, whole or not at all. An existing file of other content is kept.

    Raises
    ------
    DocumentError
        Another model has that name already: models do not change, a changed one is a child.
    """
    if path.exists():
        if path.read_text() != model.canonical_json():
            raise DocumentError(f"{path}: another model has this name, and models do not change. Choose a new name.")
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".part")
    partial.write_text(model.canonical_json())
    os.replace(partial, path)
    return path


class ModelStore:
    """A folder of models, each in the file ``<SHA-256>.json``."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def add(self, model: BlockModel) -> str:
        """Keep a model; return its SHA-256."""
        digest = model.sha256()
        save_model(model, self.folder / f"{digest}.json")
        return digest

    def get(self, digest: str) -> BlockModel:
        """Return the model of a SHA-256 or of a beginning of one that is unique here.

        Raises
        ------
        DocumentError
            None or several, or the file is damaged.
        """
        found = sorted(self.folder.glob(f"{digest}*.json")) if digest.isalnum() else []
        if len(found) != 1:
            raise DocumentError(f"{self.folder}: {len(found)} models are named {digest!r}. Give more of the SHA-256.")
        return load_model(found[0])

    def lineage(self, digest: str) -> Iterator[tuple[str, BlockModel]]:
        """Yield a model and its ancestors, youngest first, with their SHA-256."""
        following: str | None = digest
        while following is not None:
            model = self.get(following)
            yield model.sha256(), model
            following = model.parent
