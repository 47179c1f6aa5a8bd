"""Memory of native code is given back, so that a service that runs for months stays as large as in its first hour.

The C library raises the size from which it asks the kernel for memory by itself, whenever such a piece is freed, up to
32 MiB: arrays then share the heap with what lives long, which they leave full of holes. With the size fixed, an array's
memory goes back to the kernel with the array. Arrow's own allocator keeps what it once had.

What is smaller still shares the heap, and the C library by itself gives back only the heap's end: one thing up there
that lives on keeps all the free pages below it resident. :func:`trim` gives those back.
"""

from __future__ import annotations

import ctypes

import pyarrow as pa

MMAP_THRESHOLD_BYTES = 64 * 1024
TRIM_THRESHOLD_BYTES = 128 * 1024
ARENAS = 1
"""Heaps that threads share, sixteen else on two processors, each of which keeps what its threads once needed at most.
Whoever needs memory holds the interpreter's lock nearly always, and so waits for nobody at one heap."""
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8  # mallopt(3)


def give_back() -> bool:
    """Have freed arrays go back to the kernel. Return whether the C library can be told (glibc can)."""
    pa.set_memory_pool(pa.system_memory_pool())
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    wanted = {
        _M_MMAP_THRESHOLD: MMAP_THRESHOLD_BYTES,
        _M_TRIM_THRESHOLD: TRIM_THRESHOLD_BYTES,
        _M_ARENA_MAX: ARENAS,
    }
    return all(mallopt(option, value) for option, value in wanted.items())


def trim() -> None:
    """Give free pages inside the heap back to the kernel, where the C library can (glibc since 2.8).

    It holds up whoever needs memory of the same part of the heap for some milliseconds: call it when nothing is
    measured, from a thread that may be late.
    """
    malloc_trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if malloc_trim is not None:
        malloc_trim(0)
