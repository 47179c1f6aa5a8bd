"""The dashboard's files: a fixed table made at the start; a name from a request is only ever looked up in it."""

from __future__ import annotations

import gzip
import hashlib
import importlib.util
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Header, Response

from service.api.problems import ProblemError

router = APIRouter(include_in_schema=False)
FOLDER = Path(__file__).resolve().parents[1] / "dashboard"
KINDS = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
PLOTLY = "plotly.min.js"


@dataclass(frozen=True)
class File:
    """One file as it is sent."""

    body: bytes
    packed: bytes
    media_type: str
    etag: str


@cache
def files() -> dict[str, File]:
    """Return all files by name: the folder's, and plotly.js out of the installed wheel."""
    found = {path.name: path for path in sorted(FOLDER.iterdir()) if path.suffix in KINDS}
    plotly = importlib.util.find_spec("plotly")
    assert plotly is not None
    assert plotly.origin is not None
    return {name: _file(path) for name, path in {**found, PLOTLY: _plotly(Path(plotly.origin))}.items()}


def _plotly(origin: Path) -> Path:
    return origin.parent / "package_data" / PLOTLY


def _file(path: Path) -> File:
    body = path.read_bytes()
    etag = f'"{hashlib.blake2b(body, digest_size=12).hexdigest()}"'
    # Level 1: a fifth of the size for 50 ms at the first request.
    return File(body, gzip.compress(body, 1), f"{KINDS[path.suffix]}; charset=utf-8", etag)


@router.get("/")
def read_page(if_none_match: Annotated[str | None, Header()] = None) -> Response:
    """Give the dashboard."""
    return _answer("index.html", if_none_match, None)


@router.get("/dashboard/{name}")
def read_file(
    name: str,
    if_none_match: Annotated[str | None, Header()] = None,
    accept_encoding: Annotated[str | None, Header()] = None,
) -> Response:
    """Give one of the dashboard's files."""
    if name not in files():
        raise ProblemError(404, "unknown-file", f"The dashboard has no file {name!r}.")
    return _answer(name, if_none_match, accept_encoding)


def _answer(name: str, known: str | None, encodings: str | None) -> Response:
    file = files()[name]
    headers = {"ETag": file.etag, "Cache-Control": "no-cache", "Vary": "Accept-Encoding"}
    if known is not None and file.etag in known:
        return Response(status_code=304, headers=headers)
    if re.search(r"\bgzip\b", encodings or ""):
        return Response(file.packed, media_type=file.media_type, headers={**headers, "Content-Encoding": "gzip"})
    return Response(file.body, media_type=file.media_type, headers=headers)
