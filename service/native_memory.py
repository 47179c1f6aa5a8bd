"""Memory of native code is given back, so that a service that runs for months stays as large as in its first hour.

The C library raises the size from which it asks the kernel for memory by itself, whenever such a piece is freed, up to
32 MiB: arrays then share the heap with what lives long, which they leave full of holes. With the size fixed, an array's
memory goes back to the kernel with the array. Arrow's own allocator keeps what it once had.
"""

from __future__ import annotations

import ctypes

import pyarrow as pa

MMAP_THRESHOLD_BYTES = 64 * 1024
TRIM_THRESHOLD_BYTES = 128 * 1024
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # mallopt(3)


def give_back() -> bool:
    """Have freed arrays go back to the kernel. Return whether the C library can be told (glibc can)."""
    pa.set_memory_pool(pa.system_memory_pool())
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    return bool(mallopt(_M_MMAP_THRESHOLD, MMAP_THRESHOLD_BYTES) and mallopt(_M_TRIM_THRESHOLD, TRIM_THRESHOLD_BYTES))
