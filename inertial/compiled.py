"""Compile a hot loop to machine code, typed as the plain function it was."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

Parameters = ParamSpec("Parameters")
Returned = TypeVar("Returned")


def compiled(function: Callable[Parameters, Returned]) -> Callable[Parameters, Returned]:
    """Return ``function`` compiled on first use, kept on disk, without the interpreter lock; strict IEEE arithmetic.

    No fast-math: a live run and its replay must agree bit for bit, and so must two machines.
    """
    return cast("Callable[Parameters, Returned]", numba.njit(cache=True, nogil=True)(function))
