"""Headers that keep browsers from doing what nobody meant."""

from __future__ import annotations

from starlette.types import ASGIApp, Message, Receive, Scope, Send

# Styles may stand in the page: plotly.js sets some as it draws. Scripts may not, wherever they come from but here.
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self'; font-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'self'"
)
DOCUMENT_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; sandbox; frame-ancestors 'self'"
"""Reports are pages by themselves, with no scripts."""
ALWAYS = [
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"SAMEORIGIN"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
]
OF_PAGES = [*ALWAYS, (b"content-security-policy", POLICY.encode())]
OF_DOCUMENTS = [*ALWAYS, (b"content-security-policy", DOCUMENT_POLICY.encode())]
NO_STORE = (b"cache-control", b"no-store")
"""Where a route says nothing of its own."""
ONE_YEAR_S = 31_536_000
SECURE = (b"strict-transport-security", f"max-age={ONE_YEAR_S}".encode())


class SecurityHeaders:
    """ASGI middleware that sets them on every answer."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on, with the headers on what comes back."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def sending(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = message["headers"] = [*message.get("headers", ()), *_added(scope)]
                if not any(name == NO_STORE[0] for name, _ in headers):
                    headers.append(NO_STORE)
            await send(message)

        await self._app(scope, receive, sending)


def _added(scope: Scope) -> list[tuple[bytes, bytes]]:
    headers = OF_DOCUMENTS if scope["path"].endswith("/report") else OF_PAGES
    return [*headers, SECURE] if scope["scheme"] == "https" else headers
