"""``/calibrations`` and ``/models``: the documents that runs and simulators can name."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Response
from fastapi import Path as PathParameter

from inertial.documents import BlockModel, Calibration, DocumentError, parse_document
from service.api.common import ControllerHere
from service.api.models import Library, LibraryEntry
from service.api.problems import ProblemError, responses

router = APIRouter(tags=["library"])
FileName = Annotated[str, PathParameter(description="File name as listed, without .json.", max_length=200)]
Kind = type[Calibration] | type[BlockModel]


@router.get("/calibrations")
def list_calibrations(controller: ControllerHere) -> Library:
    """List the calibrations that the service knows."""
    settings = controller.settings
    return _library(Calibration, settings.library.calibrations, settings.block.calibration)


@router.get("/calibrations/{name}", responses={200: {"content": {"application/json": {}}}, **responses(404, 422)})
def read_calibration(name: FileName, controller: ControllerHere) -> Response:
    """Give one calibration document."""
    settings = controller.settings
    return _document(name, _files(settings.library.calibrations, settings.block.calibration), "calibration")


@router.get("/models")
def list_models(controller: ControllerHere) -> Library:
    """List the block models that the service knows."""
    settings = controller.settings
    return _library(BlockModel, settings.library.models, settings.block.model)


@router.get("/models/{name}", responses={200: {"content": {"application/json": {}}}, **responses(404, 422)})
def read_model(name: FileName, controller: ControllerHere) -> Response:
    """Give one block model."""
    settings = controller.settings
    return _document(name, _files(settings.library.models, settings.block.model), "model")


def _files(folder: Path | None, configured: Path | None) -> dict[str, Path]:
    """Return the documents by name: those in the folder, and the one that runs use."""
    found = sorted(folder.glob("*.json")) if folder is not None else []
    files = {path.stem: path for path in found if path.is_file()}
    if configured is not None and configured.is_file():
        files[configured.stem] = configured
    return files


def _library(kind: Kind, folder: Path | None, configured: Path | None) -> Library:
    return Library(entries=[_entry(kind, name, path) for name, path in _files(folder, configured).items()])


def _entry(kind: Kind, name: str, path: Path) -> LibraryEntry:
    try:
        document: Calibration | BlockModel = parse_document(kind, path.read_bytes(), path.name)
    except (DocumentError, OSError) as error:
        return LibraryEntry(name=name, error=str(error))
    return LibraryEntry(name=name, sha256=document.sha256(), document=document.schema_, block=document.block)


def _document(name: str, files: dict[str, Path], what: str) -> Response:
    """Give a file that was listed; a name from a request is only ever compared, never made into a path."""
    if name not in files:
        raise ProblemError(404, f"unknown-{what}", f"There is no {what} {name!r}. GET /api/v1/{what}s lists them.")
    return Response(files[name].read_bytes(), media_type="application/json")
