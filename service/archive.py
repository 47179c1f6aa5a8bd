"""One file that carries others: a tar archive whose last members say what the others are, and who vouches for them.

``manifest.json`` holds the schema, facts about what is carried, and size and SHA-256 of each member;
``signature.json``, where there is one, an Ed25519 signature (RFC 8032) of the manifest's bytes. Both come last, so that
an archive is written in one go, and one that was cut short lacks them. Any tar program can look inside.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
import tarfile
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from service.errors import RefusedInput

MANIFEST, SIGNATURE = "manifest.json", "signature.json"
NAME = re.compile(r"(?!.*(^|/)\.)[\w .\-]+(/[\w .\-]+)*")
"""Names that may leave an archive: no path but downwards, no hidden file."""
PIECE = 2**20
ANOTHER_COPY = "Take another copy of it."
Sign = Callable[[bytes], dict[str, str]]
Check = Callable[[bytes, Mapping[str, str]], None]


@dataclass(frozen=True)
class Member:
    """A file to be carried; what is appended to it after it was opened stays behind."""

    name: str
    source: Path


def write_archive(
    path: Path, schema: str, about: Mapping[str, Any], members: Iterable[Member], sign: Sign | None = None
) -> dict[str, Any]:
    """Write an archive whole or not at all and return its manifest.

    Parameters
    ----------
    path
        The archive; one that is there already is replaced.
    schema
        What kind of archive it is, with its version.
    about
        Facts for the manifest.
    members
        What is carried; one whose file has gone when its turn comes is passed over.
    sign
        Given the manifest's bytes, returns ``signature.json``.

    Raises
    ------
    OSError
        The disk does not take it.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    files: dict[str, dict[str, Any]] = {}
    try:
        with part.open("wb") as file:
            with tarfile.open(fileobj=file, mode="w", format=tarfile.PAX_FORMAT) as tar:
                for member in members:
                    with suppress(FileNotFoundError):
                        files[member.name] = _add(tar, member)
                manifest = {"schema": schema, **about, "files": files}
                text = json.dumps(manifest, indent=1, sort_keys=True, ensure_ascii=False).encode() + b"\n"
                _add_text(tar, MANIFEST, text)
                if sign is not None:
                    _add_text(tar, SIGNATURE, json.dumps(sign(text), indent=1).encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return manifest


class Archive:
    """An archive that was found whole: every member is what the manifest says, and the signature, if asked for, holds.

    Parameters
    ----------
    path
        The archive.
    schema
        What it must be.
    check
        Given the manifest's bytes and ``signature.json``, raises :class:`RefusedInput` unless it vouches for them.

    Raises
    ------
    RefusedInput
        Cut, damaged, tampered with, newer, of another kind, or signed by nobody who is trusted.
    """

    def __init__(self, path: Path, schema: str, check: Check | None = None) -> None:
        self.path = path
        try:
            self._tar = tarfile.open(path)  # noqa: SIM115 - closed by close()
        except tarfile.TarError as error:
            raise RefusedInput(
                str(path), f"is no archive of inertrim's, or is damaged ({error}).", ANOTHER_COPY
            ) from None
        try:
            self._members = self._list()
            self.manifest, text = self._read_manifest(schema)
            self.manifest_sha256 = hashlib.sha256(text).hexdigest()
            self.signature: dict[str, str] = {}
            if check is not None:
                self.signature = self._signature()
                check(text, self.signature)
            self._compare()
        except (tarfile.TarError, EOFError) as error:
            self.close()
            raise RefusedInput(str(path), f"is damaged ({error}).", ANOTHER_COPY) from None
        except RefusedInput:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._tar.close()

    @property
    def names(self) -> list[str]:
        """Names of what is carried."""
        return list(self.manifest["files"])

    def read(self, name: str) -> bytes:
        """Return a member's bytes."""
        return self._open(name).read()

    def extract(self, name: str, target: Path) -> None:
        """Write a member to a file and have it on disk; folders are made."""
        target.parent.mkdir(parents=True, exist_ok=True)
        with target.open("wb") as file:
            source = self._open(name)
            while piece := source.read(PIECE):
                file.write(piece)
            file.flush()
            os.fsync(file.fileno())

    def _list(self) -> dict[str, tarfile.TarInfo]:
        members: dict[str, tarfile.TarInfo] = {}
        for info in self._tar:
            if not info.isreg() or not NAME.fullmatch(info.name) or info.name in members:
                raise RefusedInput(
                    str(self.path), f"holds {info.name!r}, which no archive of inertrim's does.", ANOTHER_COPY
                )
            members[info.name] = info
        return members

    def _read_manifest(self, schema: str) -> tuple[dict[str, Any], bytes]:
        if MANIFEST not in self._members:
            raise RefusedInput(str(self.path), f"has no {MANIFEST} at its end: it was cut short.", ANOTHER_COPY)
        text = self._open(MANIFEST).read()
        try:
            manifest: dict[str, Any] = json.loads(text)
            found, files = str(manifest["schema"]), manifest["files"]
            whole = all(isinstance(one["bytes"], int) and isinstance(one["sha256"], str) for one in files.values())
        except (ValueError, KeyError, TypeError, AttributeError):
            whole, found = False, ""
        if not whole:
            raise RefusedInput(str(self.path), f"its {MANIFEST} is damaged.", ANOTHER_COPY)
        if found != schema:
            remedy = "Update inertrim, or give the file that is meant."
            raise RefusedInput(str(self.path), f"is of schema {found}, not {schema}.", remedy)
        return manifest, text

    def _signature(self) -> dict[str, str]:
        if SIGNATURE not in self._members:
            raise RefusedInput(str(self.path), "is not signed.", "Have it exported with a key.")
        try:
            signature = json.loads(self._open(SIGNATURE).read())
            return {"key": str(signature["key"]), "signature": str(signature["signature"])}
        except (ValueError, KeyError, TypeError):
            raise RefusedInput(str(self.path), f"its {SIGNATURE} is damaged.", ANOTHER_COPY) from None

    def _compare(self) -> None:
        """Compare every member with the manifest."""
        stated = self.manifest["files"]
        carried = set(self._members) - {MANIFEST, SIGNATURE}
        if odd := sorted(carried ^ set(stated)):
            what = "was added" if odd[0] in carried else "is missing"
            raise RefusedInput(str(self.path), f"{odd[0]} {what} after it was written.", ANOTHER_COPY)
        for name, one in stated.items():
            found = hashlib.sha256()
            source = self._open(name)
            while piece := source.read(PIECE):
                found.update(piece)
            if self._members[name].size != one["bytes"] or found.hexdigest() != one["sha256"]:
                raise RefusedInput(str(self.path), f"{name} is not what was written (SHA-256 differs).", ANOTHER_COPY)

    def _open(self, name: str) -> IO[bytes]:
        file = self._tar.extractfile(self._members[name])
        assert file is not None  # only regular files were let in
        return file


class _Hashing(io.RawIOBase):
    """Reads a file's first bytes and hashes them."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self._file, self._left = file, size
        self.sha256 = hashlib.sha256()

    def read(self, size: int = -1) -> bytes:
        """Return the next bytes."""
        piece = self._file.read(self._left if size < 0 else min(size, self._left))
        self._left -= len(piece)
        self.sha256.update(piece)
        return piece


def _add(tar: tarfile.TarFile, member: Member) -> dict[str, Any]:
    with member.source.open("rb") as file:
        found = os.fstat(file.fileno())
        info = tarfile.TarInfo(member.name)
        info.size, info.mtime = found.st_size, int(found.st_mtime)
        hashing = _Hashing(file, info.size)
        tar.addfile(info, hashing)
        return {"bytes": info.size, "sha256": hashing.sha256.hexdigest()}


def _add_text(tar: tarfile.TarFile, name: str, text: bytes) -> None:
    info = tarfile.TarInfo(name)
    info.size = len(text)
    tar.addfile(info, io.BytesIO(text))
