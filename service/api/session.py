"""``/session``: a browser changes a token for a cookie that scripts cannot read."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from service.api.gate import Access
from service.api.models import SessionState, SignIn
from service.api.problems import ProblemError, responses
from service.security.sessions import COOKIE, LASTS_S

router = APIRouter(prefix="/session", tags=["session"])


def _access(request: Request) -> Access:
    access: Access = request.app.state.access()
    return access


@router.get("")
def read_session(request: Request) -> SessionState:
    """Tell whether a token is needed, and who the service takes the asker for."""
    access = _access(request)
    session = access.sessions.find(request.cookies.get(COOKIE, ""))
    who = request.state.principal
    return SessionState(
        needed=not access.open_house(),
        name=who.name if who is not None else None,
        role=who.role.value if who is not None else None,
        csrf=session.csrf if session is not None and who is not None and who.how == "session" else None,
    )


@router.post("", responses=responses(400, 401, 413, 422, 429))
async def sign_in(body: SignIn, request: Request, response: Response) -> SessionState:
    """Begin a session with a token."""
    address = request.client.host if request.client is not None else "unknown"
    access = _access(request)
    found = await access.check(body.token.strip(), address)
    if isinstance(found, Response):
        kind = 429 if found.status_code == 429 else 401
        raise ProblemError(kind, "token", "This token is unknown, revoked or past its end, or too many were wrong.")
    session = access.sessions.open(found)
    secure = request.url.scheme == "https"
    response.set_cookie(COOKIE, session.id, max_age=int(LASTS_S), httponly=True, samesite="strict", secure=secure)
    return SessionState(needed=True, name=found.name, role=found.role.value, csrf=session.csrf)


@router.delete("", status_code=204, response_class=Response)
def sign_out(request: Request) -> Response:
    """End the session."""
    _access(request).sessions.close(request.cookies.get(COOKIE, ""))
    ended = Response(status_code=204)
    ended.delete_cookie(COOKIE, httponly=True, samesite="strict")
    return ended
