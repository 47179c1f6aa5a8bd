"""What an operator can ask of the discrepancy workflow in the running service: start it on what is known, adopt."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from inertial.documents import DocumentError
from service.config import Settings
from service.discrepancies import Discrepancies, DiscrepancyKeyReused, Job, TooManyDiscrepancies
from service.events import EventHub
from service.model_choice import ModelChoice
from service.run_folder import RunFolder
from service.store import Store
from simulators.model_store import ideal_model, load_model, save_model


class UnknownInput(Exception):
    """A recording or model that was asked for is not known here; the text says which and what is."""


class RunInHand(Exception):
    """A model cannot change under a run."""


class DiscrepancyDesk:
    """Commands on discrepancies and models, each in the audit log.

    Parameters
    ----------
    settings, store, hub, models
        As the service has them.
    folder_of
        Gives the folder of a run that the store knows, or raises.
    busy
        Tells whether a run is in hand.
    """

    def __init__(
        self,
        settings: Settings,
        store: Store,
        hub: EventHub,
        models: ModelChoice,
        folder_of: Callable[[str], RunFolder],
        busy: Callable[[], bool],
    ) -> None:
        self._settings, self._store, self.models = settings, store, models
        self._folder_of, self._busy = folder_of, busy
        self._beside = settings.store.path
        self.jobs = Discrepancies(self._beside.with_name(self._beside.stem + "-discrepancies"), hub)

    def start(self, request: Mapping[str, Any], who: str, key: str | None = None) -> tuple[Job, bool]:
        """Queue the workflow on recordings and a model that are known here, and tell whether the job is new.

        Raises
        ------
        UnknownInput, DocumentError, DiscrepancyKeyReused, TooManyDiscrepancies, UnknownRun
            Recorded in the audit as refused.
        """
        try:
            recordings = [self._recording(one) for one in request["recordings"]]
            model = self._model(request["model"])
            digest = load_model(model).sha256()
            job, new = self.jobs.start(dict(request), recordings, model, digest, who, key)
        except Exception as error:
            self._store.audit(who, "discrepancy", None, "refused", str(error))
            raise
        self._store.audit(who, "discrepancy", job.id, "accepted", "" if new else "the same key again: no new job")
        return job, new

    def adopt(self, digest: str, who: str, why: str) -> None:
        """Believe in another model from now on.

        Raises
        ------
        UnknownInput, DocumentError, RunInHand
            Recorded in the audit as refused.
        """
        try:
            if self._busy():
                raise RunInHand("a run is in hand; its model does not change under it")
            self.models.adopt(self._model(digest), who)
        except (UnknownInput, DocumentError, RunInHand) as error:
            self._store.audit(who, "adopt", None, "refused", f"{digest}: {error}")
            raise
        self._store.audit(who, "adopt", None, "accepted", f"{digest}: {why}" if why else digest)

    def recordings(self) -> list[str]:
        """Return the names of the recordings in the configured folder."""
        return sorted(self._named())

    def _recording(self, asked: Mapping[str, str | None]) -> Path:
        run_id, name = asked.get("run_id"), asked.get("name")
        if run_id is not None:
            path = self._folder_of(run_id).recording
            if not path.is_file():
                raise UnknownInput(f"run {run_id} has left no recording")
            return path
        named = self._named()
        if name not in named:
            raise UnknownInput(f"there is no recording {name!r} in the folder [library] recordings")
        return named[name]

    def _named(self) -> dict[str, Path]:
        """Return the configured folder's recordings; a name from a request is compared, never made into a path."""
        folder = self._settings.library.recordings
        if folder is None:
            return {}
        data = [path for kind in ("parquet", "csv") for path in sorted(folder.glob(f"*.{kind}"))]
        return {path.stem: path for path in data if path.with_suffix(".toml").is_file()}

    def _model(self, digest: str | None) -> Path:
        if digest is None:
            return self.models.path() or self._ideal()
        library = self._settings.library.models
        files = [] if library is None else sorted(library.glob("*.json"))
        chosen = self.models.path()
        files += self.models.adopted() + ([] if chosen is None else [chosen])
        for path in files:
            try:
                if load_model(path).sha256() == digest:
                    return path
            except DocumentError:
                continue
        found = self.jobs.models()
        if digest not in found:
            raise UnknownInput(f"there is no model {digest}; GET /api/v1/models lists them")
        return found[digest]

    def _ideal(self) -> Path:
        model = ideal_model(self._settings.block.gyro_kind)
        return save_model(model, self._beside.with_name(self._beside.stem + "-models") / f"{model.sha256()}.json")


REFUSALS = (UnknownInput, RunInHand, DocumentError, DiscrepancyKeyReused, TooManyDiscrepancies)
