"""Sessions of the dashboard: a cookie that scripts cannot read, and a word that other sites cannot know."""

from __future__ import annotations

import secrets
import threading
import time
from dataclasses import dataclass, replace

from service.security.tokens import Principal

COOKIE = "inertrim_session"
LASTS_S = 12 * 3600.0
SESSIONS_MAX = 200


@dataclass(frozen=True)
class Session:
    """One sign-in; ``csrf`` must come back in a header with every command."""

    id: str
    csrf: str
    principal: Principal
    ends_s: float


class Sessions:
    """Sign-ins of this process; a restart ends them all. Safe to call from any thread."""

    def __init__(self) -> None:
        self._sessions: dict[str, Session] = {}
        self._lock = threading.Lock()

    def open(self, principal: Principal) -> Session:
        """Begin a session; the oldest ends where there are too many."""
        now_s = time.monotonic()
        who = replace(principal, how="session")
        session = Session(secrets.token_urlsafe(32), secrets.token_urlsafe(32), who, now_s + LASTS_S)
        with self._lock:
            self._sessions = {key: one for key, one in self._sessions.items() if one.ends_s > now_s}
            while len(self._sessions) >= SESSIONS_MAX:
                del self._sessions[next(iter(self._sessions))]
            self._sessions[session.id] = session
        return session

    def find(self, session_id: str) -> Session | None:
        """Return the session of a cookie while it lasts."""
        session = self._sessions.get(session_id)
        return session if session is not None and session.ends_s > time.monotonic() else None

    def close(self, session_id: str) -> None:
        """End a session."""
        with self._lock:
            self._sessions.pop(session_id, None)
