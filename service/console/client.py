"""The service as a console sees it: status, events, commands under a lease."""

from __future__ import annotations

import json
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx

SILENT_S = 1.0
"""Real seconds without a word of the service after which what it said is old."""
LEASE_S = 30.0
ENDED = ("READY", "FAULT", "ABORTED", "OFFLINE")

Show = Callable[[dict[str, Any], float], None]


class ConsoleError(RuntimeError):
    """The service does not answer, or refuses; the text says what it said and what to do."""


class ConsoleClient:
    """One console.

    Parameters
    ----------
    url
        Of the service, without ``/api/v1``.
    token
        Bearer token, where the service asks for one.
    ca
        PEM certificate that the service's own is trusted by; None: those of the system.
    """

    def __init__(self, url: str, token: str | None = None, ca: Path | None = None) -> None:
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        verify = ssl.create_default_context(cafile=ca) if ca is not None else True
        self._url = url.rstrip("/")
        self._http = httpx.Client(base_url=f"{self._url}/api/v1", headers=headers, timeout=5.0, verify=verify)
        self._lease: str | None = None

    def status(self) -> dict[str, Any]:
        """Return the status now."""
        return dict(self._ask("GET", "/status").json())

    def start(self, request: dict[str, Any]) -> str:
        """Start a run; return its id."""
        return str(self._ask("POST", "/runs", request).json()["run_id"])

    def abort(self, operator: str, reason: str) -> str:
        """Abort the run in hand; return its id."""
        run_id = self.status()["run_id"]
        if run_id is None:
            raise ConsoleError(f"{self._url}: there is no run in hand. `inertrim console follow` shows what there is.")
        self._ask("POST", f"/runs/{run_id}/abort", {"operator": operator, "reason": reason})
        return str(run_id)

    def follow(self, show: Show, every_s: float = 0.2) -> dict[str, Any]:
        """Show every status, with the seconds since the service last answered, until no run is under way.

        A service that does not answer is asked again; what it said last is shown as old meanwhile.
        """
        status, heard_s = self.status(), time.monotonic()
        while True:
            show(status, time.monotonic() - heard_s)
            if status["state"] in ENDED and time.monotonic() - heard_s < SILENT_S:
                return status
            time.sleep(every_s)
            with suppress(ConsoleError):
                status, heard_s = self.status(), time.monotonic()

    @contextmanager
    def commanding(self, holder: str, *, take_over: bool = False, reason: str | None = None) -> Iterator[None]:
        """Hold the lease meanwhile, renewing it from another thread."""
        asked = {"holder": holder, "lasts_s": LEASE_S, "take_over": take_over, "reason": reason}
        self._lease = str(self._ask("POST", "/lease", asked).json()["lease_id"])
        done = threading.Event()
        thread = threading.Thread(target=self._renew, args=(done,), name="lease", daemon=True)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()
            with suppress(ConsoleError):
                self._ask("DELETE", "/lease")
            self._lease = None

    def _renew(self, done: threading.Event) -> None:
        while not done.wait(LEASE_S / 3):
            with suppress(ConsoleError):
                self._ask("PUT", "/lease", {"lasts_s": LEASE_S})

    def _ask(self, method: str, path: str, document: dict[str, Any] | None = None) -> httpx.Response:
        headers = {"Lease-Id": self._lease} if self._lease is not None else {}
        try:
            answer = self._http.request(method, path, json=document, headers=headers)
        except (httpx.TransportError, httpx.InvalidURL) as error:
            raise ConsoleError(
                f"{self._url}: no answer ({error}). Check the address and that the service runs."
            ) from None
        if answer.is_success:
            return answer
        raise ConsoleError(f"{self._url}: {method} {path} was refused ({answer.status_code}): {_detail(answer)}")


def _detail(answer: httpx.Response) -> str:
    with suppress(json.JSONDecodeError, AttributeError):
        return str(answer.json().get("detail", answer.text))
    return answer.text or "nothing was said"
