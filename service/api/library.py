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
from service.controller import Controller

router = APIRouter(tags=["library"])
FileName = Annotated[str, PathParameter(description="File name as listed, without .json.", max_length=200)]
Kind = type[Calibration] | type[BlockModel]


@router.get("/calibrations")
def list_calibrations(controller: ControllerHere) -> Library:
    """List the calibrations that the service knows."""
    return _library(Calibration, _calibrations(controller), controller.settings.block.calibration)


@router.get("/calibrations/{name}", responses={200: {"content": {"application/json": {}}}, **responses(404, 422)})
def read_calibration(name: FileName, controller: ControllerHere) -> Response:
    """Give one calibration document."""
    return _document(name, _calibrations(controller), "calibration")


@router.get("/models")
def list_models(controller: ControllerHere) -> Library:
    """List the block models that the service knows, those that were adopted among them."""
    return _library(BlockModel, _models(controller), controller.models.path())


@router.get("/models/{name}", responses={200: {"content": {"application/json": {}}}, **responses(404, 422)})
def read_model(name: FileName, controller: ControllerHere) -> Response:
    """Give one block model."""
    return _document(name, _models(controller), "model")


def _calibrations(controller: Controller) -> dict[str, Path]:
    settings = controller.settings
    return _files(settings.library.calibrations, settings.block.calibration)


def _models(controller: Controller) -> dict[str, Path]:
    settings = controller.settings
    return _files(settings.library.models, *controller.models.adopted(), settings.block.model)


def _files(folder: Path | None, *others: Path | None) -> dict[str, Path]:
    """Return the documents by name: those in the folder, and others."""
    found = sorted(folder.glob("*.json")) if folder is not None else []
    return {path.stem: path for path in (*found, *others) if path is not None and path.is_file()}


def _library(kind: Kind, files: dict[str, Path], used: Path | None) -> Library:
    return Library(entries=[_entry(kind, name, path, path == used) for name, path in files.items()])


def _entry(kind: Kind, name: str, path: Path, in_use: bool) -> LibraryEntry:
    try:
        document: Calibration | BlockModel = parse_document(kind, path.read_bytes(), path.name)
    except (DocumentError, OSError) as error:
        return LibraryEntry(name=name, error=str(error), in_use=in_use)
    return LibraryEntry(
        name=name, sha256=document.sha256(), document=document.schema_, block=document.block, in_use=in_use
    )


def _document(name: str, files: dict[str, Path], what: str) -> Response:
    """Give a file that was listed; a name from a request is only ever compared, never made into a path."""
    if name not in files:
        raise ProblemError(404, f"unknown-{what}", f"There is no {what} {name!r}. GET /api/v1/{what}s lists them.")
    return Response(files[name].read_bytes(), media_type="application/json")
