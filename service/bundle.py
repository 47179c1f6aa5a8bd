"""One run as one signed file, for sites without a network: exported, carried, imported, identical.

A bundle is an archive (``archive.py``) with ``run.json`` (what the store holds: the run, its changes of state, its
result, its audit entries) and the files of the run's folder. What was imported can be exported again, signed anew.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator
from contextlib import closing
from importlib.metadata import version
from pathlib import Path
from typing import Any

from service.archive import Archive, Member, write_archive
from service.backup import run_members
from service.config import StoreSettings
from service.errors import RefusedInput
from service.run_folder import write_whole
from service.signing import Signer, Trust
from service.store import Carried, Store, utc_now

SCHEMA = "inertrim/bundle/1"
RUN, FILES = "run.json", "files"


def export_run(settings: StoreSettings, run_id: str, out: Path, key: Path) -> dict[str, Any]:
    """Write a run's bundle and return its manifest.

    Parameters
    ----------
    settings
        Of the store.
    run_id
        The run; one that is still under way is refused.
    out
        The bundle.
    key
        Private key that signs it.

    Raises
    ------
    RefusedInput
        There is no such run, it is under way, or the key is none.
    """
    signer = Signer(key)
    with closing(_open(settings)) as store:
        run = store.carry_out(run_id)
    if run is None:
        raise RefusedInput(f"run {run_id}", f"is not in {settings.path}.", "GET /api/v1/runs lists the runs.")
    if run.run["ended_utc"] is None and run.result is None:
        raise RefusedInput(f"run {run_id}", f"is under way ({run.run['state']}).", "Wait for its end, or abort it.")
    about = {
        "created_utc": utc_now(),
        "software": version("inertrim"),
        "run": run_id,
        "launcher": run.run["launcher"],
        "state": run.run["state"],
        "verdict": run.run["verdict"],
    }
    with tempfile.TemporaryDirectory(prefix=".inertrim-bundle-", dir=out.parent) as folder:
        text = Path(folder) / RUN
        write_whole(text, run.to_json())
        return write_archive(out, SCHEMA, about, _members(text, settings.runs / run_id), signer)


def verify_bundle(path: Path, trusted: list[Path]) -> dict[str, Any]:
    """Check a bundle against the keys that are trusted and return its manifest.

    Raises
    ------
    RefusedInput
        It is damaged, was changed, or is signed by nobody who is trusted.
    """
    with _trusted(path, trusted) as archive:
        _run_of(archive)
        return archive.manifest


def import_bundle(settings: StoreSettings, path: Path, trusted: list[Path], who: str) -> dict[str, Any]:
    """Add a bundle's run to a store, which a service may be using meanwhile, and return its manifest.

    Raises
    ------
    RefusedInput
        As :func:`verify_bundle`; or the run is in the store already. Nothing is changed then.
    """
    with _trusted(path, trusted) as archive, closing(_open(settings)) as store:
        run = _run_of(archive)
        run_id = run.run["id"]
        target = settings.runs / run_id
        here = f"run {run_id} is in the store already."
        if target.exists():
            raise RefusedInput(str(path), here, f"Nothing was changed; its files are in {target}.")
        settings.runs.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".inertrim-import-", dir=settings.runs.parent) as folder:
            made = Path(folder) / run_id
            made.mkdir()
            for name in archive.names:
                if name != RUN:
                    archive.extract(name, made / name.removeprefix(f"{FILES}/"))
            signer = archive.signature["key"]
            try:
                store.carry_in(run, signer, archive.manifest_sha256, lambda: made.rename(target))
            except KeyError:
                raise RefusedInput(str(path), here, "Nothing was changed.") from None
        store.audit(who, "import", run_id, "accepted", f"{path.name}, signed by {signer}")
        return archive.manifest


def _trusted(path: Path, trusted: list[Path]) -> Archive:
    if not trusted:
        raise RefusedInput(str(path), "nobody is trusted.", "Give the sender's public key with --trust FILE.pub.")
    trust = Trust(trusted)
    return Archive(path, SCHEMA, lambda text, signature: trust.check(str(path), text, signature))


def _run_of(archive: Archive) -> Carried:
    """Return the run, after making sure that the parts of the bundle speak of the same one."""
    try:
        run = Carried.from_json(archive.read(RUN))
        known = set(archive.names) - {RUN}
        result = archive.manifest["files"].get(f"{FILES}/result.json")
        same = result is None or run.result is None or result["sha256"] == _sha256(run.result)
        whole = (
            archive.manifest["run"] == run.run["id"] and all(name.startswith(f"{FILES}/") for name in known) and same
        )
    except (KeyError, ValueError):
        whole = False
    if not whole:
        raise RefusedInput(
            str(archive.path), "does not hold one whole run.", "Have it exported anew, by the same version."
        )
    return run


def _members(text: Path, folder: Path) -> Iterator[Member]:
    yield Member(RUN, text)
    yield from run_members(folder, FILES)


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _open(settings: StoreSettings) -> Store:
    if settings.database_url is None and not settings.path.is_file():
        raise RefusedInput(str(settings.path), "there is no store.", "Give the settings of the service with --config.")
    return Store(settings.database, settings.launcher)
