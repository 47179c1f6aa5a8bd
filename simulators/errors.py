"""The one error of this room, so that whoever calls it has one to catch."""

from __future__ import annotations


class ScenarioError(ValueError):
    """What was asked for cannot be simulated; the text says which part, why, and what to do."""
