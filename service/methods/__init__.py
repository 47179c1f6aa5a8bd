"""The ways to estimate: each a small module that makes the same facts of the same material."""

from __future__ import annotations

from typing import Protocol

from inertial.error_model import Terms
from service.errors import RefusedInput
from service.methods import optimal, paper
from service.methods.material import Findings, Material

__all__ = ["DEFAULT_METHOD", "METHODS", "Findings", "Material", "Method", "method_named"]


class Method(Protocol):
    """One way to estimate."""

    def stages(self, material: Material) -> list[Terms]:
        """Return the terms after each stage there is so far."""

    def findings(self, material: Material) -> Findings:
        """Return all that the stages say."""


METHODS: dict[str, Method] = {"optimal": optimal.Pooled(), "paper": paper.Chained()}
DEFAULT_METHOD = "optimal"


def method_named(name: str) -> Method:
    """Return a method.

    Raises
    ------
    RefusedInput
        There is none of this name.
    """
    if name not in METHODS:
        raise RefusedInput("method", f"{name!r} is not known.", f"Known: {', '.join(METHODS)}.")
    return METHODS[name]
