"""Roles, and which one a request needs."""

from __future__ import annotations

from enum import StrEnum


class Role(StrEnum):
    """What the bearer of a token may do; each may what the ones before it may."""

    VIEWER = "viewer"
    OPERATOR = "operator"
    MAINTAINER = "maintainer"

    def may(self, needed: Role) -> bool:
        """Whether this role is enough."""
        ranks = list(Role)
        return ranks.index(self) >= ranks.index(needed)


OPEN = {"/healthz", "/readyz", "/api/v1/healthz", "/api/v1/readyz", "/api/v1/session", "/"}
"""Answered to anybody: whether the service lives, and the page on which one signs in."""
OPEN_PREFIX = "/dashboard/"
MAINTENANCE = ("/api/v1/models/",)
"""What changes how later runs are judged, beyond the run in hand."""
READING = ("GET", "HEAD", "OPTIONS")


def needed(method: str, path: str) -> Role | None:
    """Return the role a request needs; None: none at all."""
    if path in OPEN or path.startswith(OPEN_PREFIX):
        return None
    if method in READING:
        return Role.VIEWER
    return Role.MAINTAINER if path.startswith(MAINTENANCE) else Role.OPERATOR
