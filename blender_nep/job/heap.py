"""Keeps the C library from giving freed memory back to the system after every step of learning.

A step allocates and frees gradients of whole grids. By default, glibc gives the end of its heap back to the system when they
are freed. Then the system must clear 12 MB of pages again in every step. Without that, a step takes 6 to 8 % less
(docs/lab/speed.md).
"""

from __future__ import annotations

import ctypes
import platform
import sys

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Numbers of two parameters of mallopt, from malloc.h of glibc."""
KEPT = 256 << 20
"""Up to so many free bytes at the end of the main heap are kept. Heaps of other threads are smaller, and kept whole."""
MAPPED_FROM = 32 << 20
"""Allocations of at least so many bytes get pages of their own, which go back when they are freed. Older versions of glibc
allow no more."""


def keep_freed_memory() -> bool:
    """Tell glibc to keep freed memory for later allocations. False if the C library is another one, or if glibc refuses."""
    if sys.platform != "linux" or platform.libc_ver()[0] != "glibc":
        return False
    mallopt = ctypes.CDLL(None).mallopt
    return bool(mallopt(_MMAP_THRESHOLD, MAPPED_FROM)) and bool(mallopt(_TRIM_THRESHOLD, KEPT))
