"""Go / no-go: named conditions with persistence, severity, cause and remedy (docs/api.md)."""

from __future__ import annotations

from service.conditions.board import Board, CannotAcknowledge, UnknownCondition
from service.conditions.facts import Facts

__all__ = ["Board", "CannotAcknowledge", "Facts", "UnknownCondition"]
