"""The gate before every route: who asks, whether he may, how often, and from which page."""

from __future__ import annotations

import asyncio
import ipaddress
import math
from collections.abc import Callable
from functools import lru_cache
from http.cookies import CookieError, SimpleCookie
from urllib.parse import urlsplit

from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from service.api.problems import answer
from service.config import HttpSettings
from service.security.rate import RateLimit
from service.security.roles import READING, needed
from service.security.sessions import COOKIE, Sessions
from service.security.tokens import LOCAL, Principal, Tokens

FAILURES_PER_S, FAILURES_BURST_S = 0.5, 20.0
"""Wrong tokens that one address may offer; argon2 is slow enough that more would cost others their answers."""
CSRF_HEADER = b"x-csrf-token"


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches an address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class Access:
    """What decides on requests: tokens, sessions and limits.

    Without any token, on a loopback address, everybody on this machine is the maintainer; anywhere else, or as soon as
    there is a token, every request needs one.
    """

    def __init__(self, tokens: Tokens, http: HttpSettings) -> None:
        self.tokens, self.sessions = tokens, Sessions()
        self._http = http
        self._open_house = is_loopback(http.host)
        self._requests = RateLimit(http.requests_per_s)
        self._commands = RateLimit(http.commands_per_s)
        self._failures = RateLimit(FAILURES_PER_S, FAILURES_BURST_S)
        self._checking = asyncio.Lock()

    def open_house(self) -> bool:
        """Whether no token is needed."""
        return self._open_house and not self.tokens.exist()

    async def admit(self, scope: Scope) -> Principal | Response | None:
        """Return who asks, None for a stranger at what is open to all, or the refusal."""
        method, path = scope["method"], scope["path"]
        headers = dict(scope["headers"])
        address = scope["client"][0] if scope.get("client") else "unknown"
        role = needed(method, path)
        if (wait_s := self._too_often(method, address)) > 0:
            return _later(wait_s, "This client asks too often.")
        if (strange := self._strange(method, headers)) is not None:
            return answer(403, strange, "urn:inertrim:problem:cross-site")
        if self.open_house():
            return LOCAL
        found = await self.identify(headers, method, address)
        if isinstance(found, Response):
            return found if role is not None else None
        if role is None or (found is not None and found.role.may(role)):
            return found
        if found is None:
            return _who("A token is needed: send Authorization: Bearer TOKEN. `inertrim token create` makes one.")
        detail = f"{found.name} is {found.role}; this needs the role {role}."
        return answer(403, detail, "urn:inertrim:problem:role")

    async def identify(self, headers: dict[bytes, bytes], method: str, address: str) -> Principal | Response | None:
        """Return whose token or session it is, None without one, a refusal for a wrong one."""
        kind, _, text = headers.get(b"authorization", b"").decode("latin-1").partition(" ")
        if kind.lower() == "bearer":
            return await self.check(text.strip(), address)
        session = self.sessions.find(_cookie(headers))
        if session is None or not self.tokens.holds(session.principal.token_id):
            return None
        if method not in READING and headers.get(CSRF_HEADER, b"").decode("latin-1") != session.csrf:
            return answer(
                403, "The page's X-CSRF-Token is missing or old. Load the page again.", "urn:inertrim:problem:csrf"
            )
        return session.principal

    async def check(self, text: str, address: str) -> Principal | Response:
        """Return whose token it is, or the refusal; wrong ones are counted against the address."""
        found = self.tokens.remembered(text)
        if found is not None:
            return found
        if (wait_s := self._failures.wait_s(address)) > 0:
            return _later(wait_s, "Too many wrong tokens came from this address.")
        async with self._checking:  # one at a time: argon2 takes memory and a core
            found = await asyncio.to_thread(self.tokens.verify, text)
        if found is None:
            self._failures.take(address)
            return _who("This token is unknown, revoked or past its end. `inertrim token create` makes one.")
        return found

    def _too_often(self, method: str, address: str) -> float:
        wait_s = self._requests.take(address)
        return wait_s if wait_s > 0 or method in READING else self._commands.take(address)

    def _strange(self, method: str, headers: dict[bytes, bytes]) -> str | None:
        """Return why a request seems to come from another site's page; None where it does not."""
        host = headers.get(b"host", b"").decode("latin-1")
        if self._open_house and not self._is_ours(host):
            return f"{host!r} is not an address of this service, which listens on {self._http.host} alone."
        if method in READING:
            return None
        origin = headers.get(b"origin", b"").decode("latin-1")
        if origin and urlsplit(origin).netloc != host:
            return f"A page of {origin} may not command this service."
        if headers.get(b"sec-fetch-site", b"same-origin") not in (b"same-origin", b"none"):
            return "A page of another site may not command this service."
        return None

    def _is_ours(self, host: str) -> bool:
        """Whether a ``Host`` header names this service, which listens for this machine alone."""
        name, loopback = _name_in(host)
        return loopback or name == self._http.host.strip("[]")


@lru_cache(maxsize=256)
def _name_in(host: str) -> tuple[str, bool]:
    """Return the name in a ``Host`` header, and whether it is this machine's own."""
    name = urlsplit(f"//{host}").hostname or ""
    return name, is_loopback(name)


class Gate:
    """ASGI middleware that lets in what :class:`Access` admits and notes who it is in ``request.state.principal``."""

    def __init__(self, app: ASGIApp, access: Callable[[], Access]) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on, or refuse."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        found = await self._access().admit(scope)
        if isinstance(found, Response):
            await found(scope, receive, send)
            return
        scope.setdefault("state", {})["principal"] = found
        await self._app(scope, receive, send)


def _cookie(headers: dict[bytes, bytes]) -> str:
    try:
        morsel = SimpleCookie(headers.get(b"cookie", b"").decode("latin-1")).get(COOKIE)
    except CookieError:
        return ""
    return morsel.value if morsel is not None else ""


def _who(detail: str) -> Response:
    return answer(401, detail, "urn:inertrim:problem:token", {"WWW-Authenticate": "Bearer"})


def _later(wait_s: float, detail: str) -> Response:
    wait = str(math.ceil(wait_s))
    return answer(429, f"{detail} Try again in {wait} s.", "urn:inertrim:problem:too-many", {"Retry-After": wait})
