"""Compile a hot loop to machine code, typed as the plain function it was."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

Parameters = ParamSpec("Parameters")
Returned = TypeVar("Returned")


def compiled(function: Callable[Parameters, Returned]) -> Callable[Parameters, Returned]:
    """Return ``function`` compiled on first use, kept on disk, without the interpreter lock."""
    return cast("Callable[Parameters, Returned]", numba.njit(cache=True, nogil=True)(function))


def compiled_part(function: Callable[Parameters, Returned]) -> Callable[Parameters, Returned]:
    """Return ``function`` compiled as a part of whichever compiled functions call it."""
    return cast("Callable[Parameters, Returned]", numba.njit(nogil=True)(function))


def compiled_inline(function: Callable[Parameters, Returned]) -> Callable[Parameters, Returned]:
    """Return ``function`` compiled into every place that calls it.

    A call costs some nanoseconds, as much as all the work on a field of a frame.
    """
    return cast("Callable[Parameters, Returned]", numba.njit(nogil=True, forceinline=True)(function))
