"""Memory of native code is given back, so that a service that runs for months stays as large as in its first hour.

The C library raises the size from which it asks the kernel for memory by itself, whenever such a piece is freed, up to
32 MiB: arrays then share the heap with what lives long, which they leave full of holes. With the size fixed, an array's
memory goes back to the kernel with the array. Arrow's own allocator keeps what it once had.

What is smaller still shares the heap, and the C library by itself gives back only the heap's end: one thing up there
that lives on keeps all the free pages below it resident. :func:`trim` gives those back.

numpy never gives small arrays back: it keeps the last few that were freed of each size. Batches of a line are of ever
other lengths, so that it took days to have had each size often enough, which looked like a leak of some kilobytes a
run. :func:`fill` has it keep all that it will ever keep from the start.
"""

from __future__ import annotations

import ctypes

import numpy as np
import pyarrow as pa

MMAP_THRESHOLD_BYTES = 64 * 1024
TRIM_THRESHOLD_BYTES = 128 * 1024
ARENAS = 1
"""Heaps that threads share, sixteen else on two processors, each of which keeps what its threads once needed at most.
Whoever needs memory holds the interpreter's lock nearly always, and so waits for nobody at one heap."""
NUMPY_KEEPS, NUMPY_KEEPS_BELOW_BYTES = 7, 1024
"""How many freed arrays of each size numpy keeps, and of which sizes (``NCACHE``, ``NBUCKETS`` of its ``alloc.c``)."""
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


def fill() -> None:
    """Have numpy keep as many small arrays as it ever will, 3.7 MB, so that it is not seen to grow for days."""
    [[np.empty(size, np.uint8) for _ in range(NUMPY_KEEPS)] for size in range(NUMPY_KEEPS_BELOW_BYTES)]


def trim() -> None:
    """Give free pages inside the heap back to the kernel, where the C library can (glibc since 2.8).

    It holds up whoever needs memory of the same part of the heap for some milliseconds: call it when nothing is
    measured, from a thread that may be late.
    """
    malloc_trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if malloc_trim is not None:
        malloc_trim(0)
