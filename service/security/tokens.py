"""Bearer tokens: made, hashed with argon2, and checked without paying for argon2 at every request."""

from __future__ import annotations

import hashlib
import secrets
import threading
import time
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Literal

import structlog
from argon2 import PasswordHasher
from argon2.exceptions import VerificationError
from sqlalchemy.exc import DatabaseError

from service.security.roles import Role
from service.store import Store, TokenRecord, utc_now

PREFIX = "inertrim"
RELOAD_S = 1.0
"""Real seconds between looks at the store, by which tokens that another process makes or revokes are known here."""
REMEMBER_S = 60.0
"""Real seconds for which a checked token is known by its SHA-256."""
REMEMBER_MAX = 1_000

log = structlog.get_logger()
_hasher = PasswordHasher()


@dataclass(frozen=True)
class Principal:
    """Who asks. ``how``: "local" where no token exists, else by "token" or by "session"."""

    name: str
    role: Role
    how: Literal["local", "token", "session"]
    token_id: str | None = None


LOCAL = Principal("local", Role.MAINTAINER, "local")


def make_token(name: str, role: Role, days: float | None = None) -> tuple[str, TokenRecord]:
    """Return a new token's text, which is told once, and its record."""
    token_id, secret = secrets.token_hex(4), secrets.token_urlsafe(32)
    ends = None if days is None else (datetime.now(UTC) + timedelta(days=days)).isoformat().replace("+00:00", "Z")
    record = TokenRecord(token_id, name, role.value, _hasher.hash(secret), utc_now(), ends)
    return f"{PREFIX}_{token_id}_{secret}", record


def active(record: TokenRecord) -> bool:
    """Whether a token is neither revoked nor past its end."""
    ended = record.expires_utc is not None and datetime.fromisoformat(record.expires_utc) <= datetime.now(UTC)
    return record.revoked_utc is None and not ended


class Tokens:
    """The tokens of one store. Safe to call from any thread.

    Once started, a thread of its own looks at the store, so that no request ever waits for it; a store that fails
    meanwhile leaves what was known last.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._lock = threading.Lock()
        self._active: dict[str, TokenRecord] | None = None
        self._known: dict[bytes, tuple[str, float]] = {}
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._look, name="tokens", daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._load()
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(10.0)

    def exist(self) -> bool:
        """Whether any token is valid now."""
        return bool(self._records())

    def holds(self, token_id: str | None) -> bool:
        """Whether the token of that id is valid now."""
        return token_id in self._records()

    def remembered(self, text: str) -> Principal | None:
        """Return whose token this is if it was checked a short while ago; costs microseconds."""
        digest = hashlib.sha256(text.encode()).digest()
        found = self._known.get(digest)
        if found is None or found[1] < time.monotonic():
            return None
        record = self._records().get(found[0])
        return None if record is None else _principal(record)

    def verify(self, text: str) -> Principal | None:
        """Return whose token this is, None for a wrong one; takes as long as argon2 takes, by intent."""
        parts = text.split("_", 2)
        record = self._records().get(parts[1]) if len(parts) == 3 and parts[0] == PREFIX else None
        if record is None:
            return None
        try:
            _hasher.verify(record.secret_hash, parts[2])
        except VerificationError:
            return None
        with self._lock:
            if len(self._known) >= REMEMBER_MAX:
                self._known.clear()
            self._known[hashlib.sha256(text.encode()).digest()] = (record.id, time.monotonic() + REMEMBER_S)
        return _principal(record)

    def _records(self) -> dict[str, TokenRecord]:
        known = self._active
        return self._load() if known is None else known

    def _load(self) -> dict[str, TokenRecord]:
        self._active = found = {record.id: record for record in self._store.tokens() if active(record)}
        return found

    def _look(self) -> None:
        while not self._stopping.wait(RELOAD_S):
            try:
                self._load()
            except DatabaseError as error:
                log.error("tokens", error=str(error.orig))


def _principal(record: TokenRecord) -> Principal:
    return Principal(record.name, Role(record.role), "token", record.id)
